"""Pictures of every format and depth, and files that are none."""

from __future__ import annotations

import contextlib

import cv2
import numpy as np
import OpenEXR
import pytest

from horizonval.commands.picture import read_picture
from horizonval.core.errors import UserError
from horizonval.store.exr import write_frame, write_image

GREY8 = np.arange(30 * 40, dtype=np.uint16).reshape(30, 40).astype(np.uint8)
GREY16 = (np.arange(30 * 40, dtype=np.uint32) * 50).reshape(30, 40).astype(np.uint16)


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("pixels", [GREY8, GREY16], ids=["8 bit", "16 bit"])
def test_integers_are_read_as_stored(tmp_path, suffix, pixels):
    path = tmp_path / f"a.{suffix}"
    cv2.imwrite(str(path), pixels)
    picture = read_picture(path)
    np.testing.assert_array_equal(picture.grey, pixels)
    assert picture.grey.dtype == np.float64
    assert picture.full_scale == np.iinfo(pixels.dtype).max
    assert picture.source is None


def test_float_tiff_has_no_full_scale(tmp_path):
    pixels = GREY8.astype(np.float32)
    pixels[3, 4] = np.nan
    cv2.imwrite(str(tmp_path / "a.tif"), pixels)
    picture = read_picture(tmp_path / "a.tif")
    np.testing.assert_array_equal(picture.grey, pixels)
    assert picture.full_scale is None


@pytest.mark.parametrize("channels", [3, 4])
def test_colour_becomes_grey(tmp_path, channels):
    pixels = np.full((30, 40, channels), 77, np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), pixels)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png").grey, np.full((30, 40), 77.0))


def test_jpeg(tmp_path):
    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((30, 40), 77, np.uint8))
    # A flat block survives the cosine transform up to rounding.
    np.testing.assert_allclose(read_picture(tmp_path / "a.jpg").grey, 77, atol=1)


def test_content_decides_not_the_name(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), GREY8)
    (tmp_path / "a.png").rename(tmp_path / "a.exr")
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr").grey, GREY8)


def test_our_own_files_bring_their_source(tmp_path, make_frame, make_image):
    frame, image = make_frame(), make_image()
    write_frame(tmp_path / "f.exr", frame)
    write_image(tmp_path / "i.png", image)
    read = read_picture(tmp_path / "f.exr")
    np.testing.assert_array_equal(read.grey, frame.radiance["vis"])
    assert (read.full_scale, read.source.truth) == (None, frame.truth)
    read = read_picture(tmp_path / "i.png")
    np.testing.assert_array_equal(read.grey, image.dn)
    assert (read.full_scale, read.source.truth) == (1023.0, image.truth)


def test_foreign_exr(tmp_path):
    pixels = np.linspace(0, 1, 1200, dtype=np.float32).reshape(30, 40)
    OpenEXR.File({}, {"Y": pixels}).write(str(tmp_path / "y.exr"))
    picture = read_picture(tmp_path / "y.exr")
    np.testing.assert_array_equal(picture.grey, pixels)
    assert (picture.full_scale, picture.source) == (None, None)


@pytest.mark.parametrize("content", [b"", b"x", b"hello, world\n" * 9, b"\x89PNG\r\n\x1a\n", b"\x76\x2f\x31\x01"])
def test_no_picture(tmp_path, content, capfd):
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        read_picture(path)
    assert str(path) in str(caught.value)
    assert capfd.readouterr().err == "", "decoders must not talk to the user"


def test_truncated_picture_is_one_line_or_a_picture(tmp_path, capfd):
    rng = np.random.default_rng(1)
    for suffix in ("png", "jpg", "tif"):
        whole = tmp_path / f"whole.{suffix}"
        cv2.imwrite(str(whole), rng.integers(0, 255, (200, 200), np.uint8))
        path = tmp_path / f"cut.{suffix}"
        path.write_bytes(whole.read_bytes()[:9000])
        # Decoders differ in what they make of half a picture; either answer is one a user can live with.
        with contextlib.suppress(UserError):
            assert read_picture(path).grey.shape == (200, 200)
    assert capfd.readouterr().err == ""


def test_missing_and_folder(tmp_path):
    for path in (tmp_path / "none.png", tmp_path):
        with pytest.raises(UserError, match=str(path)):
            read_picture(path)
