"""Statistics of the altitude-free sensor's bank of frames: the error table and the trends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

import numpy as np

from horizonval.systems.a.bank import ALTITUDES_KM, FIELDS_DEG, PIXELS
from horizonval.systems.result import Cell, Table
from horizonval.systems.task_cache import Plain

METHODS = {
    "whole, newton": "whole pixels, Newton: as published",
    "whole, closed": "whole pixels, closed form",
    "limb, newton": "sub-pixel points, Newton",
    "limb, closed": "sub-pixel points, closed form",
}
QUANTITIES = {"roll_deg": "roll [deg]", "pitch_deg": "pitch [deg]", "altitude_km": "altitude [km]"}

Bank = Mapping[str, tuple[Plain, Plain]]
"""Item and result by name."""


def bank_of(items: Mapping[str, Plain], results: Mapping[str, Plain]) -> Bank:
    """Return items with their results."""
    return {name: (items[name], results[name]) for name in items}


def cells(bank: Bank) -> Iterator[tuple[float, float, int, list[tuple[Plain, Plain]]]]:
    """Yield altitude [km], field [deg], pixels and the frames of every cell of the grid that has any."""
    for altitude in ALTITUDES_KM:
        for fov in FIELDS_DEG:
            for pixels in PIXELS:
                key = (altitude, fov, pixels)
                frames = [f for f in bank.values() if (f[0]["altitude_km"], f[0]["fov_deg"], f[0]["pixels"]) == key]
                if frames:
                    yield altitude, fov, pixels, frames


def values(frames: Iterable[tuple[Plain, Plain]], method: str, quantity: str, light: str = "clean") -> list[float]:
    """Return a quantity of all frames that a method answered."""
    found = [result[light][method] for _, result in frames if light in result]
    return [float(one[quantity]) for one in found if "refused" not in one]


def rms(numbers: Iterable[float]) -> float:
    """Return the root of the mean square; 0 of nothing."""
    array = np.array(list(numbers))
    return float(np.sqrt(np.mean(array**2))) if array.size else 0.0


def error_table(bank: Bank, method: str) -> Table:
    """Return the errors of one method in every cell: rms, median and largest of the absolute error."""
    columns = ["altitude [km]", "field [deg]", "pixels", "frames", "refused", "points"]
    columns += [f"{name} {of}" for name in QUANTITIES.values() for of in ("rms", "median", "max")]
    rows: list[tuple[Cell, ...]] = []
    for altitude, fov, pixels, frames in cells(bank):
        points = values(frames, method, "points")
        row: list[Cell] = [altitude, fov, pixels, len(frames), _short(1.0 - len(points) / len(frames))]
        row.append(float(np.median(points)) if points else None)
        for quantity in QUANTITIES:
            absolute = np.abs(values(frames, method, quantity))
            if absolute.size:
                row += [_short(rms(absolute)), _short(float(np.median(absolute))), _short(float(absolute.max()))]
            else:
                row += [None, None, None]
        rows.append(tuple(row))
    return Table(
        title=f"Errors over the grid: {METHODS[method]}",
        columns=tuple(columns),
        rows=tuple(rows),
        caption="Noise-free frames. Refused: share of frames without an answer; the errors are those of all answers.",
    )


def _short(value: float) -> float:
    return float(f"{value:.3g}")


def median_nadir(bank: Bank, method: str) -> dict[tuple[float, float, int], float]:
    """Return the median nadir error [arcsec] of every cell in which a method answered."""
    found = {}
    for altitude, fov, pixels, frames in cells(bank):
        errors = values(frames, method, "nadir_arcsec")
        if errors:
            found[altitude, fov, pixels] = float(np.median(errors))
    return found


def steps_with_pixels(bank: Bank, method: str) -> list[float]:
    """Return by what factor the median error falls from each number of pixels to the next."""
    cell = median_nadir(bank, method)
    return [
        cell[altitude, fov, a] / cell[altitude, fov, b]
        for altitude in ALTITUDES_KM
        for fov in FIELDS_DEG
        for a, b in pairwise(PIXELS)
        if (altitude, fov, a) in cell and (altitude, fov, b) in cell
    ]


def ratios_of_field(bank: Bank, method: str, quantity: str, narrow: float, wide: float) -> list[float]:
    """Return a quantity's ratio, wide field over narrow, of every condition that both of them see and answer."""
    by_key: dict[tuple[float, ...], float] = {}
    for item, result in bank.values():
        one = result["clean"][method]
        if "refused" not in one:
            key = tuple(item[k] for k in ("altitude_km", "roll_deg", "pitch_deg", "pixels", "fov_deg"))
            by_key[key] = float(one[quantity])
    return [by_key[(*key[:-1], wide)] / value for key, value in by_key.items()
            if key[-1] == narrow and (*key[:-1], wide) in by_key and value > 0.0]  # fmt: skip


def refused_share(bank: Bank, method: str) -> float:
    """Return the share of all frames without an answer."""
    return sum("refused" in result["clean"][method] for _, result in bank.values()) / len(bank)


def updates(bank: Bank, method: str, step: int) -> list[float]:
    """Return the size [rad] of a Newton update (the first is 1) on every frame; 0 where fewer were needed."""
    found = []
    for _, result in bank.values():
        one = result["clean"].get(method, {"refused": ""})
        if "refused" not in one:
            found.append(one["updates"][step - 1] if len(one["updates"]) >= step else 0.0)
    return found
