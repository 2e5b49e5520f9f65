"""FITS pictures of other programs, read by astropy.

Scaled, unsigned and missing values are applied, and images that fpack packed are unpacked. A mosaic of a colour sensor
is refused. Without ``ROWORDER`` the first row is the lowest, as viewers draw it.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core import memory
from horizonval.core.errors import UserError, excerpt
from horizonval.store import fits
from horizonval.store.readers.part import Part, Pixels, full_scale_of, native, of_bands

MAGIC = b"SIMPLE"

_MOSAIC = ("BAYERPAT", "COLORTYP", "CFATYPE", "CFA-PAT")
_PATTERN = re.compile(r"[RGBCMYW]{4,36}|X-?TRANS.*", re.IGNORECASE)
_MOSAIC_ADVICE = (
    "decode its colours first, or average its cells of 2 x 2 pixels with a camera file of half width, height, fx and "
    "fy, cx and cy less 0.5 and halved"
)


def parts(path: Path) -> list[Part]:
    """Return the images of a FITS file, and the planes of its cubes; errors as :func:`horizonval.store.fits.opened`."""
    with fits.opened(path) as units:
        found: list[Part] = []
        for number, unit in enumerate(units):
            if unit.is_image and len(unit.shape) >= 2 and 0 not in unit.shape:
                found += _parts_of(unit, number, path)
        if found and fits.is_own(units):
            first = found[0]
            return of_bands(first.width, first.height, fits.bands_of(units), lambda: fits.read_own(path))
        return found


def _parts_of(unit: Any, number: int, path: Path) -> list[Part]:
    *planes, height, width = unit.shape
    name = unit.name if unit.name not in ("", "PRIMARY", "COMPRESSED_IMAGE") else str(number)
    kind = f"FITS, BITPIX {unit.header.get('BITPIX')}"
    upwards = str(unit.header.get("ROWORDER", "")).strip().upper()
    note = "" if upwards in ("TOP-DOWN", "BOTTOM-UP") else "no ROWORDER: the first row is taken for the lowest"
    count = math.prod(planes)

    def part(plane: int | None) -> Part:
        named, what = (name, kind) if plane is None else (f"{name}:{plane + 1}", f"{kind}, a plane of {count}")
        return Part(width, height, what, lambda: _load(path, number, plane), named, note=note)

    is_colour = planes == [3] and "RGB" in str(unit.header.get("CTYPE3", "")).upper()
    return [part(None)] if count == 1 or is_colour else [part(plane) for plane in range(count)]


def _load(path: Path, number: int, plane: int | None) -> Pixels:
    with fits.opened(path) as units:
        unit = units[number]
        for key in _MOSAIC:
            pattern = str(unit.header.get(key, "")).strip()
            if _PATTERN.fullmatch(pattern):
                what = f"is a mosaic of a colour sensor ({key} = {excerpt(pattern)})"
                raise UserError(what, where=str(path), expected="a grey or colour image", fix=_MOSAIC_ADVICE)
        memory.refuse_beyond(16.0 * math.prod(unit.shape), "the image and its planes", where=str(path))
        values = native(unit.data)
        saturate, top_down = unit.header.get("SATURATE"), str(unit.header.get("ROWORDER", "")).strip().upper()
    height, width = values.shape[-2:]
    values = values.reshape(-1, height, width)
    values = np.moveaxis(values, 0, -1) if plane is None and len(values) == 3 else values[plane or 0]
    if top_down != "TOP-DOWN":
        values = np.ascontiguousarray(values[::-1])
    return Pixels(values, _full_scale(saturate, values))


def _full_scale(saturate: object, values: NDArray[Any]) -> float | None:
    if isinstance(saturate, int | float) and not isinstance(saturate, bool) and saturate > 0:
        return float(saturate)
    return full_scale_of(values.dtype)
