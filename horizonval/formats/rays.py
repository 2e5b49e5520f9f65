"""Tables of rays: read strictly, and written back with the radiance, every other column unchanged."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from horizonval.core import atomic, files, memory
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt, nearest

OBSERVER = ("obs_x_km", "obs_y_km", "obs_z_km")
DIRECTION = ("dir_x", "dir_y", "dir_z")
SUN = ("sun_x", "sun_y", "sun_z")

LARGEST_NUMBER = 1e12
"""Kilometres, or any unit of a direction, whose length does not matter."""

MAX_FILE_BYTES = 1024**3
MEMORY_PER_BYTE = 48.0
"""Of a table in memory and of the march along its rays, for each byte of its file. Measured 19 for the fields of a
table of six digits, and 0.9 kB for the march along a ray, which has 18 bytes at least."""


@dataclass(frozen=True)
class RayFile:
    """Rays, shape (n, 3) each, and the table they came from with every field as it was written."""

    header: list[str]
    rows: list[list[str]]
    observer_m: FloatArray
    direction: FloatArray
    sun: FloatArray


def read_rays(path: Path) -> RayFile:
    """Read a table of rays; UserError names file, line and column of the first mistake."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected="a CSV file of rays")
    memory.refuse_beyond(MEMORY_PER_BYTE * len(text), "a table of that size", where=str(path), fix="split it")
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        lines = [(reader.line_num, row) for row in reader if row]
    except csv.Error as e:
        raise UserError(f"not a CSV file: {e}", where=str(path), expected="comma-separated text") from e
    if not lines:
        raise UserError("the file is empty", where=str(path), expected="a line of column names")
    header = [name.strip() for name in lines[0][1]]
    if not set(header) & {*OBSERVER, *DIRECTION, *SUN}:
        # It is something else, of which a message must not show a line.
        raise UserError(
            "not a table of rays", where=str(path), expected=f"the columns {', '.join((*OBSERVER, *DIRECTION, *SUN))}"
        )
    for name in (*OBSERVER, *DIRECTION, *SUN):
        if header.count(name) != 1:
            problem = "missing" if name not in header else "there more than once"
            others = [h for h in header if h not in (*OBSERVER, *DIRECTION, *SUN)]
            similar = nearest(name, others)[:3]
            raise UserError(
                f"column {name} is {problem}",
                where=f"{path}: line {lines[0][0]}",
                expected=f"the columns {', '.join((*OBSERVER, *DIRECTION, *SUN))}",
                fix=f"the file has {', '.join(excerpt(h) for h in similar)}" if similar else "",
            )
    for number, row in lines[1:]:
        if len(row) != len(header):
            raise UserError(
                f"{len(row)} fields", where=f"{path}: line {number}", expected=f"{len(header)}, as in the first line"
            )
    observer_km, direction, sun = (_vectors(path, header, lines[1:], names) for names in (OBSERVER, DIRECTION, SUN))
    for vectors, names in ((direction, DIRECTION), (sun, SUN)):
        zero = np.flatnonzero(~vectors.any(axis=1))
        if zero.size:
            raise UserError(
                "a vector of length 0 is no direction",
                where=f"{path}: line {lines[1 + zero[0]][0]}: {', '.join(names)}",
                expected="a direction; its length does not matter",
            )
    return RayFile(lines[0][1], [row for _, row in lines[1:]], observer_km * 1e3, direction, sun)


def check_above_ground(table: RayFile, radius_m: float, path: Path) -> None:
    """Raise ``UserError`` for the first observer inside the planet; a part in 1e9 is left to rounding."""
    below = np.flatnonzero(np.linalg.norm(table.observer_m, axis=1) < radius_m * (1 - 1e-9))
    if below.size:
        raise UserError(
            f"the observer of ray {below[0] + 1} is below the ground",
            where=f"{path}: {', '.join(OBSERVER)}",
            expected=f"a distance of at least {radius_m / 1e3:g} km from the planet's centre",
        )


def write_radiance(path: Path, table: RayFile, radiance: dict[str, FloatArray]) -> None:
    """Write the table with one more column per band, whole or not at all; UserError where a column exists already."""
    added = {f"radiance_{band}": values for band, values in radiance.items()}
    for name in added:
        if name in table.header:
            raise UserError(f"the table has a column {name} already", where=str(path), fix="rename that column")
    with atomic.replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*table.header, *added])
        for i, row in enumerate(table.rows):
            writer.writerow([*row, *(repr(float(values[i])) for values in added.values())])


def _vectors(path: Path, header: list[str], lines: list[tuple[int, list[str]]], names: tuple[str, ...]) -> FloatArray:
    out = np.empty((len(lines), 3))
    for j, name in enumerate(names):
        column = header.index(name)
        for i, (number, row) in enumerate(lines):
            try:
                value = float(row[column])
            except ValueError:
                value = math.nan
            if not abs(value) <= LARGEST_NUMBER:
                raise UserError(
                    f'found "{excerpt(row[column])}"',
                    where=f"{path}: line {number}, column {name}",
                    expected=f"a number from -{LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}",
                )
            out[i, j] = value
    return out
