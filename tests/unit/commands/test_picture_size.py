"""The size of a picture is judged before a pixel is decoded."""

from __future__ import annotations

import struct
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from horizonval.commands.picture import read_picture
from horizonval.commands.picture_size import LARGEST_SIDE_PX, size_of
from horizonval.core import memory
from horizonval.core.errors import UserError
from horizonval.spec.camera import CameraSpec
from horizonval.store import exr

SMALL = CameraSpec.model_validate({"camera": {"width": 64, "height": 64, "fov_deg": 60.0}})


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


@pytest.mark.parametrize("make", [empty_png, empty_exr])
def test_an_image_of_another_size_than_the_camera_is_not_decoded(tmp_path, undecoded, make):
    path = tmp_path / "a.png"
    path.write_bytes(make(3000, 2000))
    with pytest.raises(UserError, match=r"3000 x 2000 pixels, the camera 64 x 64; expected equal sizes"):
        read_picture(path, SMALL, "cam.toml")


@pytest.mark.parametrize("make", [empty_png, empty_exr])
def test_an_image_larger_than_any_camera_is_not_decoded(tmp_path, undecoded, make):
    path = tmp_path / "a.png"
    path.write_bytes(make(LARGEST_SIDE_PX + 1, 2))
    with pytest.raises(UserError, match=r"16385 x 2 pixels; expected at most 16384 x 16384"):
        read_picture(path)


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
    pixels = (np.random.default_rng(0).random((37, 53, channels)) * 200).astype(kind)
    assert cv2.imwrite(str(path), pixels)
    assert size_of(path) == (53, 37)
    assert read_picture(path).grey.shape == (37, 53)


@pytest.mark.parametrize("content", [b"", b"II*\0", b"II*\0\x08\0\0\0", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"text"])
def test_a_header_without_a_size_is_refused(tmp_path, content):
    path = tmp_path / "a.tiff"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"not an image that can be read|the file is empty"):
        read_picture(path)


@pytest.mark.parametrize("reader", ["read_frame", "read_foreign_grey", "read_image"])
def test_an_exr_file_larger_than_memory_is_not_decoded(tmp_path, undecoded, monkeypatch, reader):
    path = tmp_path / "a.exr"
    path.write_bytes(empty_exr(2**31 - 1, 2**31 - 1))
    with pytest.raises(UserError, match=r"2147483647 x 2147483647 pixels|not written by horizonval"):
        getattr(exr, reader)(path)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no /dev/zero here")
def test_a_device_is_no_picture():
    start = time.monotonic()
    with pytest.raises(UserError, match="is a device"):
        read_picture(Path("/dev/zero"))
    assert time.monotonic() - start < 2.0
