"""Pictures of every format and depth, and files that are none; the size is judged before a pixel is decoded."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import OpenEXR
import pytest

from horizonval.core import memory
from horizonval.core.errors import UserError
from horizonval.spec.camera import LARGEST_SIDE_PX, CameraSpec
from horizonval.store import exr
from horizonval.store.exr import write_frame, write_image
from horizonval.store.picture import parts_of, read_picture

SMALL = CameraSpec.model_validate({"camera": {"width": 64, "height": 64, "fov_deg": 60.0}})
GREY8 = np.arange(30 * 40, dtype=np.uint16).reshape(30, 40).astype(np.uint8)
GREY16 = (np.arange(30 * 40, dtype=np.uint32) * 50).reshape(30, 40).astype(np.uint16)


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


@pytest.mark.parametrize(
    "content",
    [b"", b"text\n" * 9, b"\x89PNG\r\n\x1a\n", b"\x76\x2f\x31\x01", b"II*\0\x08\0\0\0", b"\xff\xd8\xff"],
)
def test_no_picture(tmp_path, content, capfd):
    path = tmp_path / "a.png"
    path.write_bytes(content)
    with pytest.raises(UserError) as caught:
        read_picture(path)
    assert str(path) in str(caught.value)
    assert capfd.readouterr().err == "", "decoders must not talk to the user"


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp", "webp", "pgm", "exr"])
def test_a_truncated_picture_is_refused_in_a_line(tmp_path, suffix, capfd):
    path = tmp_path / f"a.{suffix}"
    pixels = np.random.default_rng(1).integers(0, 255, (60, 70), np.uint8)
    if suffix == "exr":
        OpenEXR.File({}, {"Y": pixels.astype(np.float32)}).write(str(path))
    else:
        cv2.imwrite(str(path), pixels)
    whole = path.read_bytes()
    for size in np.linspace(20, len(whole) - 1, 25).astype(int):
        path.write_bytes(whole[:size])
        with pytest.raises(UserError, match=str(path)):
            read_picture(path)
    assert capfd.readouterr().err == ""


def test_missing_and_folder(tmp_path):
    for path in (tmp_path / "none.png", tmp_path):
        with pytest.raises(UserError, match=str(path)):
            read_picture(path)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def empty_png(width: int, height: int) -> bytes:
    """Return a PNG image whose zeros take some 1000 times less than its pixels."""
    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(b"\0" * (width + 1)) for _ in range(height)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + _chunk(b"IDAT", rows) + _chunk(b"IEND", b"")


def empty_exr(width: int, height: int) -> bytes:
    """Return the header of an EXR image of one channel, and nothing after it."""
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channel = b"Y\0" + struct.pack("<iB3xii", 1, 0, 1, 1) + b"\0"
    attributes = (
        (b"channels", b"chlist", channel),
        (b"compression", b"compression", b"\3"),
        (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1.0)),
        (b"screenWindowCenter", b"v2f", struct.pack("<2f", 0.0, 0.0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
    )
    text = b"".join(name + b"\0" + kind + b"\0" + struct.pack("<i", len(v)) + v for name, kind, v in attributes)
    return b"\x76\x2f\x31\x01" + struct.pack("<i", 2) + text + b"\0"


@pytest.fixture
def undecoded(monkeypatch):
    """No decoder may be called."""

    def decode(*arguments: object) -> None:
        raise AssertionError("pixels were decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)
    monkeypatch.setattr("horizonval.store.exr._decode_pixels", decode)
    monkeypatch.setattr("horizonval.store.readers.exr._load", decode)


@pytest.mark.parametrize("make", [empty_png, empty_exr])
@pytest.mark.parametrize(
    ("size", "camera", "words"),
    [
        ((3000, 2000), (SMALL, "cam.toml"), "3000 x 2000 pixels, the camera 64 x 64"),
        ((LARGEST_SIDE_PX + 1, 2), (), "16385 x 2 pixels; expected at most 16384 x 16384"),
    ],
)
def test_an_image_of_a_wrong_size_is_not_decoded(tmp_path, undecoded, make, size, camera, words):
    path = tmp_path / "a.png"
    path.write_bytes(make(*size))
    with pytest.raises(UserError, match=words):
        read_picture(path, *camera)


def test_an_image_larger_than_memory_is_not_decoded(tmp_path, undecoded, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(empty_png(2000, 1000))
    monkeypatch.setattr(memory, "available_bytes", lambda: 90e6)
    with pytest.raises(UserError, match=r"2000 x 1000 pixels takes about 96 MB of memory; expected at most 90 MB"):
        read_picture(path)


PIXELS = {
    "png": (np.uint8, np.uint16),
    "tiff": (np.uint8, np.uint16, np.float32, np.float64),
    "jpg": (np.uint8,),
    "bmp": (np.uint8,),
    "webp": (np.uint8,),
}


@pytest.mark.parametrize(("suffix", "kind"), [(suffix, kind) for suffix, kinds in PIXELS.items() for kind in kinds])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_the_header_says_what_the_decoder_gives(tmp_path, suffix, kind, channels):
    path = tmp_path / f"a.{suffix}"
    pixels = np.full((37, 53, channels), [50, 80, 140, 0][:channels], kind)
    if channels == 4:
        pixels[..., 3] = np.iinfo(kind).max if np.dtype(kind).kind == "u" else 1.0
    assert cv2.imwrite(str(path), pixels)
    assert [(part.width, part.height) for part in parts_of(path)] == [(53, 37)]
    picture = read_picture(path)
    np.testing.assert_allclose(picture.grey, pixels[..., :3].mean(-1, dtype=float), atol=1)
    assert picture.full_scale == (np.iinfo(kind).max if np.dtype(kind).kind == "u" else None)


@pytest.mark.parametrize("reader", [exr.read_frame, read_picture, exr.read_image])
def test_an_exr_file_larger_than_memory_is_not_decoded(tmp_path, undecoded, reader):
    path = tmp_path / "a.exr"
    path.write_bytes(empty_exr(2**31 - 1, 2**31 - 1))
    with pytest.raises(UserError, match=r"not written by horizonval|damaged"):
        reader(path)
