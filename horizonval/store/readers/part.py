"""What every reader of pictures returns: the parts of a file by their heads, and the decoded pixels of one of them.

A reader decodes nothing before a part is chosen and its size judged, because a few kilobytes can encode any number of
pixels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import UserError, excerpt
from horizonval.frame import DetectorImage, RadianceFrame

EXPECTED = "an EXR, PNG, TIFF, JPEG, FITS or NumPy image, or a table of numbers"
MAX_FILE_BYTES = 4 * 1024**3
LISTED = 8
"""Parts that a message lists by name; further ones are counted."""

Source: TypeAlias = DetectorImage | RadianceFrame
Opacity = Literal["straight", "premultiplied"]


@dataclass(frozen=True)
class Pixels:
    """Decoded pixels, shape (H, W) or (H, W, channels).

    ``full_scale`` is the largest value that the file's integers can have, None if unknown. ``opacity`` describes the
    second of two or the fourth of four channels.
    """

    values: NDArray[Any]
    full_scale: float | None = None
    opacity: Opacity = "straight"


@dataclass(frozen=True)
class Part:
    """One picture in a file: size [px], kind of pixels in words, and the function that decodes them.

    The function returns the whole content of a file of ours.

    ``main`` is False for what accompanies a picture (a thumbnail, a mask), ``is_light`` for a depth and the like.
    ``orientation`` is that of the EXIF and TIFF tag. ``note`` is an assumption of the reader that the user must see.
    """

    width: int
    height: int
    kind: str
    load: Callable[[], Pixels | Source]
    name: str = ""
    main: bool = True
    orientation: int = 1
    note: str = ""
    is_light: bool = True


def chosen(parts: Sequence[Part], wanted: str | None, path: Path) -> Part:
    """Return the part of a name or a number (from 1); without one the only picture of the file.

    Raises ``UserError``, with the list of parts: no picture, several, or no such part.
    """
    if not parts:
        raise UserError("holds no image", where=str(path), expected=EXPECTED)
    count = Counter(part.name for part in parts)
    # A name that several parts have tells nothing; their numbers do.
    named = {part.name if count[part.name] == 1 and part.name else str(n): part for n, part in enumerate(parts, 1)}
    if wanted is None:
        found = {name: part for name, part in named.items() if part.main} or named
        if len(found) > 1 or not all(part.is_light for part in found.values()):
            what = f"holds {len(found)} pictures: " if len(found) > 1 else "holds no light but "
            raise UserError(f"{what}{_listed(found)}", where=str(path), fix="choose one with --part")
        return next(iter(found.values()))
    if wanted in named:
        return named[wanted]
    if wanted.isdecimal() and 1 <= int(wanted[:9]) <= len(parts):
        return parts[int(wanted) - 1]
    raise UserError(f"no part {excerpt(wanted)!r}", where=str(path), expected=f"--part with one of {_listed(named)}")


def _listed(parts: dict[str, Part]) -> str:
    first = [f"{excerpt(name)} ({p.width} x {p.height}, {p.kind})" for name, p in list(parts.items())[:LISTED]]
    more = len(parts) - LISTED
    return ", ".join(first) + (f" and {more} more" if more > 0 else "")


def of_bands(width: int, height: int, bands: Sequence[str], load: Callable[[], Source]) -> list[Part]:
    """Return the bands of a frame, or the one of an image, of this package; the first is the picture."""

    def only(band: str) -> Source:
        source = load()
        if isinstance(source, RadianceFrame):
            return replace(source, radiance={band: source.radiance[band]})
        return source

    note = f"of the bands {', '.join(bands)} the first is used; --part takes another" if len(bands) > 1 else ""
    return [
        Part(width, height, "a band of horizonval", partial(only, band), band, band == bands[0], note=note)
        for band in bands
    ]


def turned(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return pixels as a viewer shows them that applies an orientation of EXIF or TIFF, 1 to 8."""
    if orientation >= 5:
        values = np.swapaxes(values, 0, 1)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return np.ascontiguousarray(values)


def native(values: Any) -> NDArray[Any]:
    """Return a contiguous array in the machine's order of bytes."""
    array = np.asarray(values)
    return np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("="))


def full_scale_of(dtype: np.dtype[Any]) -> float | None:
    """Return the largest number of an integer type of up to 16 bits; wider ones hold numbers of unknown scale."""
    return float(np.iinfo(dtype).max) if dtype.kind in "ui" and dtype.itemsize <= 2 else None
