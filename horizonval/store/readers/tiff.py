"""TIFF pictures: tifffile reads the tags and decodes the samples; what they mean is decided here.

Every tag that changes the meaning of samples is applied or refused: the layout of planes, the value of black, palette,
opacity, format and number of bits, missing data. Pages of reduced size and masks are no pictures of their own.
Samples of 1, 2 and 4 bits are scaled to 0..255, as those of PNG.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import files
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.frame import DetectorImage, RadianceFrame
from horizonval.store.exported import read_beside
from horizonval.store.readers.part import EXPECTED, Opacity, Part, Pixels, full_scale_of, native

MAGIC = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

_PHOTOMETRIC, _ORIENTATION, _NO_DATA = 262, 274, 42113
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR = 0, 1, 2, 3, 6
_COLOURS = {_WHITE_IS_ZERO: 1, _BLACK_IS_ZERO: 1, _RGB: 3, _PALETTE: 1, _YCBCR: 3}
_JPEG = (6, 7)
_REDUCED, _MASK = 1, 4
_OPACITY: dict[int, Opacity] = {1: "premultiplied", 2: "straight"}
_MOST_SAMPLES = 4096
"""Samples of a pixel; a page of more is no image."""


def parts(path: Path) -> list[Part]:
    """Return the pages of a TIFF file; ``UserError`` if it is damaged or a kind of stack that is not read."""
    with _opened(path) as tiff:
        _refuse_stacks(tiff, path)
        found = []
        for place, page in _pages(tiff):
            found += _parts_of(page, place, path)
    return found


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    import tifffile

    logger = logging.getLogger("tifffile")
    before, logger.disabled = logger.disabled, True
    try:
        files.ensure_file(path, expected=EXPECTED)
        with tifffile.TiffFile(path) as tiff:
            yield tiff
    except UserError:
        raise
    except Exception as error:
        if "imagecodecs" in str(error):
            fix = 'run `pip install "horizonval[formats]"`, or save the picture without compression'
            raise UserError("its pixels are compressed, which needs imagecodecs", where=str(path), fix=fix) from None
        # A damaged file comes out of the library as whatever went wrong inside.
        raise DamagedFileError("not an image that can be read: a damaged TIFF file", where=str(path)) from None
    finally:
        logger.disabled = before


def _refuse_stacks(tiff: Any, path: Path) -> None:
    """Raise ``UserError`` if one page is followed by images without tags, or if the list of pages leaves the file."""
    layout, file = tiff.tiff, tiff.filehandle
    file.seek(tiff.pages[len(tiff.pages) - 1].offset)
    (tags,) = struct.unpack(layout.tagnoformat, file.read(layout.tagnosize))
    file.seek(tags * layout.tagsize, os.SEEK_CUR)
    if file.read(layout.offsetsize) != bytes(layout.offsetsize):
        raise DamagedFileError("truncated, or a damaged list of pages", where=str(path))
    count = int((tiff.imagej_metadata or {}).get("images", 1)) if tiff.is_imagej else 1
    truncated = tiff.is_shaped and any(m.get("truncated") for m in tiff.shaped_metadata)
    if count > len(tiff.pages) or truncated or tiff.is_stk or tiff.is_lsm:
        what = "is a stack of several images in one page, of a microscopy program"
        raise UserError(what, where=str(path), fix="save the wanted image as a TIFF of its own")


def _pages(tiff: Any) -> Iterator[tuple[tuple[int, int | None], Any]]:
    """Yield every page, and every page inside a page, with its place."""
    for number, page in enumerate(tiff.pages):
        page = page.aspage()
        yield (number, None), page
        for inner, sub in enumerate(page.pages or ()):
            yield (number, inner), sub.aspage()


def _parts_of(page: Any, place: tuple[int, int | None], path: Path) -> list[Part]:
    """Return a page as one part, or one for each sample if their meaning is not stated."""
    separate, depth, height, width, together = page.shaped
    samples = separate * together
    if not samples:
        raise DamagedFileError("holds no image: its pages have no pixels", where=str(path))
    if not (samples <= _MOST_SAMPLES and height > 0 and width > 0 and depth == 1):
        raise UserError(f"pixels of shape {tuple(page.shaped)}", where=str(path), expected="a flat image")
    photometric = page.tags.valueof(_PHOTOMETRIC)
    colours = _COLOURS.get(-1 if photometric is None else int(photometric), samples)
    # Some programs do not say that a fourth sample is opacity.
    unknown = samples - colours > 1 or (samples == 2 and colours == 1 and page.extrasamples not in ((1,), (2,)))
    kind = f"{page.dtype or 'unknown'}, {samples} sample{'s' if samples > 1 else ''} a pixel"
    main = not page.subfiletype & (_REDUCED | _MASK)
    orientation = int(page.tags.valueof(_ORIENTATION, 1))
    name = f"{place[0] + 1}" + ("" if place[1] is None else f".{place[1] + 1}")

    def part(sample: int | None) -> Part:
        named = name if sample is None else f"{name}:{sample + 1}"
        what = kind if sample is None else f"{page.dtype or 'unknown'}, one of {samples} samples a pixel"
        return Part(width, height, what, lambda: _load(path, place, sample), named, main, orientation)

    return [part(sample) for sample in range(samples)] if unknown else [part(None)]


def _load(path: Path, place: tuple[int, int | None], sample: int | None) -> Pixels | DetectorImage | RadianceFrame:
    with _opened(path) as tiff:
        page = tiff.pages[place[0]].aspage()
        if place[1] is not None:
            page = page.pages[place[1]].aspage()
        photometric = _photometric(page, path)
        _refuse_missing_data(page, tiff.filehandle.size, path)
        values = page.asarray(squeeze=False)[:, 0]
        values = np.moveaxis(values[..., 0], 0, -1) if values.shape[0] > 1 else values[0]
        if sample is not None:
            values = values[..., sample : sample + 1]
        pixels = _meant(native(values), page, photometric)
    ours = pixels.values.dtype == np.uint16 and pixels.values.ndim == 2
    return (read_beside(path, pixels.values) if ours else None) or pixels


def _photometric(page: Any, path: Path) -> int:
    """Return how samples become grey; ``UserError`` for what is neither grey nor colour."""
    photometric = page.tags.valueof(_PHOTOMETRIC)
    where, fix = str(path), "convert it to a grey TIFF of 8 or 16 bits"
    if photometric is None:
        what = "does not say whether 0 is black or white (PhotometricInterpretation is missing)"
        raise UserError(what, where=where, fix=fix)
    photometric = int(photometric)
    if photometric not in _COLOURS or (photometric == _YCBCR and int(page.compression) not in _JPEG):
        names = {5: "CMYK", 6: "YCbCr without JPEG", 32803: "a mosaic of a colour sensor", 34892: "a camera's raw file"}
        what = f"its pixels are {names.get(photometric, f'of PhotometricInterpretation {photometric}')}"
        raise UserError(what, where=where, expected="grey or RGB", fix=fix)
    bits, samples = page.bitspersample, page.samplesperpixel
    if page.dtype is None or np.dtype(page.dtype).kind not in "buif" or not isinstance(bits, int):
        what = f"samples of {bits} bits of SampleFormat {page.tags.valueof(339, 1)}"
        raise UserError(what, where=where, expected="whole or floating-point numbers", fix=fix)
    if samples < _COLOURS[photometric]:
        raise UserError(f"a pixel has {samples} samples of {_COLOURS[photometric]} colours", where=where, fix=fix)
    if photometric == _WHITE_IS_ZERO and np.dtype(page.dtype).kind not in "bu":
        raise UserError("0 is white in signed or floating-point numbers", where=where, expected="0 is black", fix=fix)
    return photometric


def _refuse_missing_data(page: Any, size: int, path: Path) -> None:
    """Raise unless every strip or tile lies inside the file; the decoder fills others with zeros."""
    segments = list(zip(page.dataoffsets, page.databytecounts, strict=True))
    if int(page.compression) == 1:
        separate, _, height, width, together = page.shaped
        least = separate * height * -(-width * together * page.bitspersample // 8)
        enough = sum(page.databytecounts) >= least
    else:
        enough = len(segments) == math.prod(page.chunked)
    if not enough or any(start <= 0 or count <= 0 or start + count > size for start, count in segments):
        raise DamagedFileError("truncated, or parts of its pixels are missing", where=str(path))


def _meant(values: NDArray[Any], page: Any, photometric: int) -> Pixels:
    """Return stored samples, shape (H, W, samples), as grey levels or colours."""
    kind, bits = values.dtype.kind, int(page.bitspersample)
    full_scale = full_scale_of(values.dtype) if kind != "b" else 1.0
    if kind in "bu" and bits <= 16:
        full_scale = 2.0**bits - 1.0
    values, missing = values.astype(np.uint8) if kind == "b" else values, _missing(values, page)
    if photometric == _PALETTE:
        colours = np.moveaxis(np.asarray(page.colormap), 0, -1)
        # Colours of 8 bits are in the palette of 16 times 257, times 256 or as they are.
        step = next((n for n in (257, 256) if not (colours % n).any()), 1)
        colours, full_scale = colours // step, 65535.0 if colours.max() > 255 and step == 1 else 255.0
        values = colours[values[..., 0]]
    elif photometric == _WHITE_IS_ZERO:
        white = np.iinfo(values.dtype).max if full_scale is None else int(full_scale)
        values[..., 0] = white - values[..., 0]
    if bits in (1, 2, 4) and photometric != _PALETTE and full_scale is not None:
        values, full_scale = values * np.uint8(255 // int(full_scale)), 255.0
    if missing is not None:
        values = np.where(missing, np.nan, values[..., 0])
    elif values.shape[-1] == 1:
        values = values[..., 0]
    return Pixels(values, full_scale, _OPACITY.get(int((page.extrasamples or (2,))[0]), "straight"))


def _missing(values: NDArray[Any], page: Any) -> NDArray[np.bool_] | None:
    """Return where a grey picture has no data by the tag of GDAL; None if nowhere."""
    text = page.tags.valueof(_NO_DATA)
    try:
        number = float(str(text).strip("\0 "))
    except ValueError:
        return None
    missing = values[..., 0] == number
    return missing if values.shape[-1] == 1 and missing.any() else None
