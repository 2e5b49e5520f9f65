"""Heads of FITS files, checked before astropy sees them, which trusts their sizes: a negative axis is read for ever."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import BinaryIO

from horizonval.core.errors import DamagedFileError
from horizonval.spec.camera import LARGEST_SIDE_PX

_BLOCK, _CARD = 2880, 80
_MOST_HEAD_BLOCKS = 4096
_BITS = (8, 16, 32, 64, -32, -64)


def refuse_impossible_sizes(file: BinaryIO, path: Path) -> None:
    """Raise ``UserError`` unless every head of a FITS file ends and its data lie inside the file."""
    position, size = 0, file.seek(0, os.SEEK_END)
    while position < size:
        file.seek(position)
        cards, end = _head(file, path)
        if position and not cards.get("XTENSION"):
            break  # What follows the last unit belongs to nobody.
        position += end + _data_bytes(cards, path, size - position - end)
    file.seek(0)


def _head(file: BinaryIO, path: Path) -> tuple[dict[str, str], int]:
    """Return the values of a head's cards as text, and how many bytes the head takes."""
    cards: dict[str, str] = {}
    for number in range(_MOST_HEAD_BLOCKS):
        block = file.read(_BLOCK)
        lines = [block[start : start + _CARD] for start in range(0, len(block), _CARD)]
        if number == 0 and lines[:1] and lines[0][:6] not in (b"SIMPLE", b"XTENSI"):
            return {}, len(block)
        for line in lines:
            if line.rstrip() == b"END":
                return cards, (number + 1) * _BLOCK
            if line[8:10] == b"= ":
                value = line[10:].decode("latin-1").partition("/")[0].strip()
                cards.setdefault(line[:8].decode("latin-1").strip(), value)
        if len(block) < _BLOCK:
            break
    raise DamagedFileError("a FITS head without an end: truncated or damaged", where=str(path))


def _data_bytes(cards: dict[str, str], path: Path, left: int) -> int:
    """Return the bytes of the data that a head announces, in whole blocks; ``UserError`` for impossible sizes."""

    def number(key: str, default: int | None = None) -> int:
        text = cards.get(key, "" if default is None else str(default))
        if not re.fullmatch(r"[+-]?\d{1,18}", text):
            raise DamagedFileError(f"{key} is no whole number", where=str(path))
        return int(text)

    bits, axes = number("BITPIX"), number("NAXIS")
    if bits not in _BITS or not 0 <= axes <= 999:
        raise DamagedFileError(f"BITPIX = {bits} and NAXIS = {axes}: no FITS image", where=str(path))
    sizes = {f"NAXIS{n}": number(f"NAXIS{n}") for n in range(1, axes + 1)}
    packed = cards.get("ZIMAGE") == "T"
    inner = {f"ZNAXIS{n}": number(f"ZNAXIS{n}") for n in range(1, (number("ZNAXIS") if packed else 0) + 1)}
    tiles = {f"ZTILE{n}": number(f"ZTILE{n}", 1) for n in range(1, len(inner) + 1)}
    for key, value in (sizes | inner | tiles | {"PCOUNT": number("PCOUNT", 0)}).items():
        if value < 0:
            raise DamagedFileError(f"{key} = {value} is negative", where=str(path))
    for n, (key, value) in enumerate(inner.items(), 1):
        if value > LARGEST_SIDE_PX or tiles[f"ZTILE{n}"] > LARGEST_SIDE_PX:
            what = f"{key} = {value} in tiles of {tiles[f'ZTILE{n}']}"
            raise DamagedFileError(what, where=str(path), expected=f"at most {LARGEST_SIDE_PX} pixels")
    lengths = list(sizes.values())
    if cards.get("GROUPS") == "T" and lengths and lengths[0] == 0:
        lengths = lengths[1:]
    elements = number("GCOUNT", 1) * (number("PCOUNT", 0) + math.prod(lengths)) if lengths else 0
    announced = abs(bits) // 8 * elements
    if announced > max(left, 0):
        what = f"truncated, or a wrong head: it announces {announced} bytes of data, {max(left, 0)} follow"
        raise DamagedFileError(what, where=str(path))
    return -(-announced // _BLOCK) * _BLOCK
