"""Read any picture an estimator may be given: EXR, PNG, TIFF, JPEG, FITS; 8 or 16 bit or float; ours with its truth.

A few kilobytes can encode any number of pixels, so that their number is read from the header and checked first.
"""

from __future__ import annotations

import contextlib
import os
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files, memory
from horizonval.core.errors import UserError
from horizonval.estimation.limb.picture import to_grey
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.spec.camera import LARGEST_SIDE_PX, CameraSpec
from horizonval.store.header import read_header

MAX_FILE_BYTES = 4 * 1024**3
EXR_MAGIC = b"\x76\x2f\x31\x01"
FITS_MAGIC = b"SIMP"
TIFF_MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

BYTES_PER_PIXEL = 48.0
"""Memory of decoding, converting and estimating: 37 measured for 8 bit grey, up to 8 more for colour of 16 bit."""

EXPECTED = "an EXR, PNG, TIFF, JPEG or FITS image"


@dataclass(frozen=True)
class GreyImage:
    """A grey image, shape (H, W), float64.

    ``full_scale`` is the largest value of the file's integers, None for floating point; ``source`` the whole content of
    a file of ours or of one exported from it.
    """

    grey: NDArray[np.float64]
    full_scale: float | None
    source: DetectorImage | RadianceFrame | None


def read_picture(path: Path, camera: CameraSpec | None = None, camera_file: str = "") -> GreyImage:
    """Read a picture; the content decides the format. The header's size is checked before decoding.

    ``camera``: whose size the picture must have; ``camera_file``: for messages. Raises ``UserError``: missing,
    unreadable, of another size than the camera's, or larger than any camera or than memory.
    """
    magic = files.read_bytes(path, largest=MAX_FILE_BYTES, expected=EXPECTED, first=4)
    width, height = size_of(path)
    if camera is not None:
        refuse_other_size(width, height, camera, str(path), camera_file)
    refuse_too_large(width, height, path)
    if magic == EXR_MAGIC:
        return _read_exr(path)
    return _read_fits(path) if magic == FITS_MAGIC else _read_common(path)


def refuse_other_size(width: int, height: int, camera: CameraSpec, where: str, camera_file: str = "") -> None:
    """Raise ``UserError`` where an image has not the size of the camera that is said to have taken it."""
    if (width, height) != (camera.camera.width, camera.camera.height):
        raise UserError(
            f"the image is {width} x {height} pixels, the camera {camera.camera.width} x {camera.camera.height}",
            where=f"{where}, {camera_file}" if camera_file else where,
            expected="equal sizes",
        )


def picture_of_array(pixels: NDArray[Any]) -> GreyImage:
    """Return pixels, shape (H, W) or (H, W, channels), as a picture; the type of integers tells the full scale."""
    full_scale = float(np.iinfo(pixels.dtype).max) if pixels.dtype.kind in "ui" else None
    return GreyImage(to_grey(pixels), full_scale, None)


def picture_of_source(source: DetectorImage | RadianceFrame) -> GreyImage:
    """Return a detector image, or the first band of a frame, as a picture."""
    if isinstance(source, DetectorImage):
        return GreyImage(source.dn.astype(np.float64), float(source.full_scale), source)
    return GreyImage(next(iter(source.radiance.values())).astype(np.float64), None, source)


def _read_exr(path: Path) -> GreyImage:
    from horizonval.store import exr

    match exr.kind(path):
        case "image":
            return picture_of_source(exr.read_image(path))
        case "frame":
            return picture_of_source(exr.read_frame(path))
        case _:
            return GreyImage(exr.read_foreign_grey(path), None, None)


def _read_fits(path: Path) -> GreyImage:
    from horizonval.store.fits import read_fits

    pixels, full_scale, source = read_fits(path)
    return GreyImage(to_grey(pixels), full_scale, None) if source is None else picture_of_source(source)


def _read_common(path: Path) -> GreyImage:
    import cv2

    from horizonval.store.exported import read_beside

    data = np.frombuffer(files.read_bytes(path, largest=MAX_FILE_BYTES, expected=EXPECTED), dtype=np.uint8)
    pixels: NDArray[Any] | None = None
    if data.size:
        try:
            with _quiet():
                pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        except cv2.error as e:
            raise UserError("not an image that can be read", where=str(path), expected=EXPECTED) from e
    if pixels is None or pixels.size == 0:
        what = "not an image that can be read" if data.size else "the file is empty"
        raise UserError(what, where=str(path), expected=EXPECTED)
    source = read_beside(path, pixels)
    return picture_of_array(pixels) if source is None else picture_of_source(source)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Discard what the decoders write to standard error; the user gets our one line instead."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as sink:
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def size_of(path: Path) -> tuple[int, int]:
    """Return width and height of a picture [px]; ``UserError`` if it is no picture or its header is damaged."""
    with path.open("rb") as file:
        magic = file.read(4)
    if magic == FITS_MAGIC:
        from horizonval.store import fits

        return fits.size_of(path)
    if magic == EXR_MAGIC:
        return read_header(path).size(path)
    return _common_size(path, magic)


def refuse_too_large(width: int, height: int, path: Path) -> None:
    """Raise ``UserError`` for a picture larger than any camera's, or than memory holds."""
    if max(width, height) > LARGEST_SIDE_PX:
        raise UserError(
            f"{width} x {height} pixels",
            where=str(path),
            expected=f"at most {LARGEST_SIDE_PX} x {LARGEST_SIDE_PX} pixels, as of a camera",
        )
    memory.refuse_beyond(BYTES_PER_PIXEL * width * height, f"an image of {width} x {height} pixels", where=str(path))


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
    # The library's own limit would hide the size, which our message states; nothing is decoded here.
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
