"""Statistics of the altitude-free sensor's bank of frames: the error table and the trends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.systems.a.bank import ALTITUDES_KM, FIELDS_DEG, PIXELS
from horizonval.systems.a.solvers import DRAWS, POINTS
from horizonval.systems.result import Cell, Table
from horizonval.systems.text import page_text

TEXT = page_text("A")
METHODS = {
    "whole, newton": "whole pixels, Newton: as published",
    "whole, closed": "whole pixels, closed form",
    "limb, newton": "sub-pixel points, Newton",
    "limb, closed": "sub-pixel points, closed form",
}
QUANTITIES = ("roll_deg", "pitch_deg", "altitude_km")

Bank = Mapping[str, tuple[JsonObject, JsonObject]]
"""Item and result by name."""


def bank_of(items: Mapping[str, JsonObject], results: Mapping[str, JsonObject]) -> Bank:
    """Return items with their results."""
    return {name: (items[name], results[name]) for name in items}


def cells(bank: Bank) -> Iterator[tuple[float, float, int, list[tuple[JsonObject, JsonObject]]]]:
    """Yield altitude [km], field [deg], pixels and the frames of every cell of the grid that has any."""
    for altitude in ALTITUDES_KM:
        for fov in FIELDS_DEG:
            for pixels in PIXELS:
                key = (altitude, fov, pixels)
                frames = [f for f in bank.values() if (f[0]["altitude_km"], f[0]["fov_deg"], f[0]["pixels"]) == key]
                if frames:
                    yield altitude, fov, pixels, frames


def values(
    frames: Iterable[tuple[JsonObject, JsonObject]], method: str, quantity: str, light: str = "clean"
) -> list[float]:
    """Return a quantity of all frames that a method answered."""
    answers = [result[light][method] for _, result in frames if light in result]
    return [float(answer[quantity]) for answer in answers if "refused" not in answer]


def rms(numbers: Iterable[float]) -> float:
    """Return the root of the mean square; 0 of nothing."""
    array = np.array(list(numbers))
    return float(np.sqrt(np.mean(array**2))) if array.size else 0.0


def error_table(bank: Bank, method: str) -> Table:
    """Return the errors of one method in every cell: rms, median and largest of the absolute error."""
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
    return TEXT.table("errors", rows, method=METHODS[method])


def solver_table(solvers: Mapping[str, JsonObject]) -> Table:
    """Return Newton and closed form side by side, on noisy arcs."""
    names = ["rho_deg", "arc_deg", "noise_px", "newton_rms", "newton_bias", "closed_rms", "closed_bias"]
    names += ["predicted_closed_bias", "newton_steps"]
    lines = [[float(f"{condition[name]:.4g}") for name in names] for condition in solvers.values()]
    return TEXT.table("solvers", lines, draws=DRAWS, points=POINTS)


def sharp_frames(bank: Bank) -> list[tuple[JsonObject, JsonObject]]:
    """Return the frames of 1024 pixels over 60 deg."""
    return [frame for frame in bank.values() if (frame[0]["fov_deg"], frame[0]["pixels"]) == (60.0, 1024)]


def lowest_attitudes(bank: Bank) -> tuple[float, dict[float, int]]:
    """Return the lowest altitude [km], and how many attitudes have limb in view from there, by field [deg]."""
    lowest_km = min(item["altitude_km"] for item, _ in bank.values())
    attitudes = {
        (item["fov_deg"], item["roll_deg"], item["pitch_deg"])
        for item, _ in bank.values()
        if item["altitude_km"] == lowest_km
    }
    fields = sorted({fov_deg for fov_deg, _, _ in attitudes})
    return lowest_km, {fov_deg: sum(field == fov_deg for field, _, _ in attitudes) for fov_deg in fields}


def _short(value: float) -> float:
    return float(f"{value:.3g}")


def median_nadir(bank: Bank, method: str) -> dict[tuple[float, float, int], float]:
    """Return the median nadir error [arcsec] of every cell in which a method answered."""
    medians = {}
    for altitude, fov, pixels, frames in cells(bank):
        errors = values(frames, method, "nadir_arcsec")
        if errors:
            medians[altitude, fov, pixels] = float(np.median(errors))
    return medians


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
        answer = result["clean"][method]
        if "refused" not in answer:
            key = tuple(item[k] for k in ("altitude_km", "roll_deg", "pitch_deg", "pixels", "fov_deg"))
            by_key[key] = float(answer[quantity])
    return [by_key[(*key[:-1], wide)] / value for key, value in by_key.items()
            if key[-1] == narrow and (*key[:-1], wide) in by_key and value > 0.0]  # fmt: skip


def refused_share(bank: Bank, method: str) -> float:
    """Return the share of all frames without an answer."""
    return sum("refused" in result["clean"][method] for _, result in bank.values()) / len(bank)


def updates(bank: Bank, method: str, step: int) -> list[float]:
    """Return the size [rad] of a Newton update (the first is 1) on every frame; 0 where fewer were needed."""
    answers = [result["clean"].get(method, {"refused": ""}) for _, result in bank.values()]
    sequences = [answer["updates"] for answer in answers if "refused" not in answer]
    return [sequence[step - 1] if len(sequence) >= step else 0.0 for sequence in sequences]
