"""PNG, JPEG, BMP, WebP and portable anymaps: Pillow reads the head, OpenCV decodes the first picture.

Further pictures of a file (a preview in a JPEG, frames of an animation) are decoded by Pillow. PNG samples of 1, 2 and
4 bits are scaled to 0..255.
"""

from __future__ import annotations

import contextlib
import re
import warnings
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.store.exported import read_beside
from horizonval.store.quiet import silenced
from horizonval.store.readers.part import EXPECTED, MAX_FILE_BYTES, Part, Pixels, full_scale_of

READ = ("PNG", "JPEG", "MPO", "BMP", "WEBP", "PPM")
"""Formats, as Pillow names them."""
COLOURS = ("1", "L", "LA", "P", "PA", "I;16", "I;16B", "I", "RGB", "RGBA")
"""Pillow's modes of grey, palettes and RGB, with and without opacity."""

_BYTES = ("1", "L", "LA", "P", "PA", "RGB", "RGBA")
_ORIENTATION = 0x0112
_LEAST_FRAME_BYTES = 16
_ENDS = ((b"\xff\xd8\xff", b"\xff\xda", b"\xff\xd9"), (b"\x89PNG", b"IDAT", b"IEND"))
"""First bytes of a format, and what begins and ends its pixels."""
_HEAD_BYTES = 65536
_ANYMAP = re.compile(rb"P[2356]" + 3 * rb"(?:\s|#[^\n]*\n)+(\d+)")


def parts(path: Path) -> list[Part] | None:
    """Return the pictures of a file; None if no decoder knows it; ``UserError`` for a format that is not read."""
    head = files.read_bytes(path, largest=MAX_FILE_BYTES, expected=EXPECTED, first=_HEAD_BYTES)
    with _opened(path) as image:
        if image is None and head.startswith(_ENDS[0][0]):
            what = "is a JPEG file that is damaged or has not 8 bits a sample"
            raise UserError(what, where=str(path), expected=EXPECTED, fix="convert it to a PNG or TIFF file of 16 bits")
        if image is None:
            return None
        if image.format not in READ:
            what = f"is a file of the format {image.format}, which is not read"
            raise UserError(what, where=str(path), expected=EXPECTED, fix="convert it to PNG or TIFF")
        if image.mode not in COLOURS or (image.format == "PPM" and not _ANYMAP.match(head)):
            kinds = {"CMYK": "CMYK", "F": "floating-point numbers"}
            what = f"its pixels are {kinds.get(image.mode, f'in the colour space {image.mode}')}"
            raise UserError(what, where=str(path), expected="grey or RGB", fix="convert it to PNG or TIFF")
        orientation = int(image.getexif().get(_ORIENTATION, 1))
        # A frame takes some bytes of the file, whatever its head counts.
        frames = min(getattr(image, "n_frames", 1), 1 + path.stat().st_size // _LEAST_FRAME_BYTES)
        found = []
        for frame in range(frames):
            if frame and image.format == "MPO":
                image.seek(frame)
            kind = f"{image.format}, {image.mode}"
            width, height = image.size
            load = partial(_load, path, head, frame)
            found.append(Part(width, height, kind, load, orientation=orientation))
        return found


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open with Pillow; None if it knows no such format. A damaged head is a ``UserError``."""
    from PIL import Image, UnidentifiedImageError

    limit = Image.MAX_IMAGE_PIXELS
    # The library's own limit would hide the size, which our message states; nothing is decoded here.
    Image.MAX_IMAGE_PIXELS = None
    try:
        with warnings.catch_warnings(), files.open_file(path, expected=EXPECTED, largest=MAX_FILE_BYTES) as file:
            warnings.simplefilter("ignore")
            try:
                image = Image.open(file)
            except UnidentifiedImageError:
                image = None
            yield image
    except UserError:
        raise
    except Exception:
        # A damaged file comes out of the library as whatever went wrong inside.
        raise UserError("not an image that can be read", where=str(path), expected=EXPECTED) from None
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _load(path: Path, head: bytes, frame: int) -> Pixels | DetectorImage | RadianceFrame:
    with _opened(path) as image:
        if frame:
            image.seek(frame)
            if image.mode not in _BYTES:
                raise UserError(f"its frame {frame + 1} has more than 8 bits", where=str(path), expected="8 bits")
            return Pixels(np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB")), 255.0)
        has_opacity = image.has_transparency_data
        size = image.size
    pixels = _decoded(path)
    if pixels.shape[1::-1] != size:
        raise UserError("not an image that can be read", where=str(path), expected=EXPECTED)
    if pixels.ndim == 3 and pixels.shape[2] == 4 and not has_opacity:
        pixels = pixels[:, :, :3]
    if (source := read_beside(path, pixels)) is not None:
        return source
    if anymap := _ANYMAP.match(head):
        return Pixels(pixels, float(anymap[3]))
    return Pixels(pixels, full_scale_of(pixels.dtype))


def _decoded(path: Path) -> NDArray[Any]:
    import cv2

    data = files.read_bytes(path, largest=MAX_FILE_BYTES, expected=EXPECTED)
    # OpenCV fills what is missing with grey or black.
    if any(data.startswith(magic) and data.rfind(end) <= data.rfind(begin) for magic, begin, end in _ENDS):
        raise DamagedFileError("truncated: its pixels end before the image does", where=str(path))
    pixels: NDArray[Any] | None = None
    with silenced(), contextlib.suppress(cv2.error):
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None or pixels.size == 0:
        raise UserError("not an image that can be read", where=str(path), expected=EXPECTED)
    return pixels
