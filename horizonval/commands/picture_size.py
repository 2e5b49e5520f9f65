"""The size of a picture, from its header alone, and what is too large to be read.

A few kilobytes can stand for any number of pixels: their number is known, and judged, before one is decoded.
"""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

from horizonval.core import memory
from horizonval.core.errors import DamagedFileError, UserError

EXR_MAGIC = b"\x76\x2f\x31\x01"
FITS_MAGIC = b"SIMP"
TIFF_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

LARGEST_SIDE_PX = 16384
"""Of a camera file, and so of a picture."""

BYTES_PER_PIXEL = 48.0
"""Of a picture that is decoded, turned grey and given to an estimator: measured 36 to 37 of 8 bit grey (peak of
``estimate`` between 512 x 512 and 4096 x 4096 pixels, three methods), and up to 8 more for colour of 16 bit."""

EXPECTED = "an EXR, PNG, TIFF, JPEG or FITS image"


def size_of(path: Path) -> tuple[int, int]:
    """Return width and height of a picture in pixels.

    Raises
    ------
    UserError
        Not a picture, or a damaged header.
    """
    with path.open("rb") as file:
        magic = file.read(4)
    if magic == FITS_MAGIC:
        from horizonval.store.export import fits

        return fits.size_of(path)
    return _exr_size(path) if magic == EXR_MAGIC else _common_size(path, magic)


def refuse_too_large(width: int, height: int, path: Path) -> None:
    """Raise ``UserError`` for a picture larger than any camera's, or than memory holds."""
    if max(width, height) > LARGEST_SIDE_PX:
        raise UserError(
            f"{width} x {height} pixels",
            where=str(path),
            expected=f"at most {LARGEST_SIDE_PX} x {LARGEST_SIDE_PX} pixels, as of a camera",
        )
    memory.refuse_beyond(BYTES_PER_PIXEL * width * height, f"an image of {width} x {height} pixels", where=str(path))


def _exr_size(path: Path) -> tuple[int, int]:
    from horizonval.store import seal

    window = seal.read_header(path).attributes.get("dataWindow")
    if window is None or len(window.raw) != 16:
        raise DamagedFileError("the header has no data window", where=str(path))
    x_min, y_min, x_max, y_max = struct.unpack("<4i", window.raw)
    if x_max < x_min or y_max < y_min:
        raise DamagedFileError(f"the data window {x_min} {y_min} {x_max} {y_max} is empty", where=str(path))
    return x_max - x_min + 1, y_max - y_min + 1


def _common_size(path: Path, magic: bytes) -> tuple[int, int]:
    if not magic:
        raise UserError("the file is empty", where=str(path), expected=EXPECTED)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _tiff_size(path) if magic in TIFF_MAGIC else _size_by_pillow(path)
    except Exception:
        # A damaged header comes out of its parser as whatever went wrong inside.
        raise UserError("not an image that can be read", where=str(path), expected=EXPECTED) from None


def _size_by_pillow(path: Path) -> tuple[int, int]:
    from PIL import Image

    limit = Image.MAX_IMAGE_PIXELS
    # The library's own limit would hide the size, which is told in our words; it decodes nothing here.
    Image.MAX_IMAGE_PIXELS = None
    try:
        with Image.open(path) as picture:
            return picture.size
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _tiff_size(path: Path) -> tuple[int, int]:
    """Return the size of a TIFF image, of any kind of pixels: the library opens only some kinds of them."""
    from PIL import TiffImagePlugin

    with path.open("rb") as file:
        header = file.read(8)
        if header[2] == 43:
            header += file.read(8)
        directory = TiffImagePlugin.ImageFileDirectory_v2(header)
        file.seek(directory.next)
        directory.load(file)
    width, height = (int(directory[tag]) for tag in (TiffImagePlugin.IMAGEWIDTH, TiffImagePlugin.IMAGELENGTH))
    if width < 1 or height < 1:
        raise ValueError("no pixels")
    return width, height
