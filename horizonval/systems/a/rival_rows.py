"""Rows and table of the methods beside the altitude-free one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.systems.a.rivals import ALTITUDE_OFF, FIELD_DEG, PIXELS
from horizonval.systems.a.table import TEXT, rms
from horizonval.systems.result import Cell, ComparisonRow, Table

NAMES = (
    "altitude_free",
    "known_altitude",
    "known_altitude_off",
    "straight_line",
    "straight_line_off",
    "two_sensors",
)


def errors(compared: Mapping[str, JsonObject], method: str) -> dict[str, float]:
    """Return a method's nadir errors [arcsec] by frame, of the frames that all methods answer."""
    common = {name: one for name, one in compared.items() if all(m in one for m in NAMES)}
    return {name: float(one[method]["arcsec"]) for name, one in common.items()}


def rate(compared: Mapping[str, JsonObject], method: str) -> float:
    """Return frames per second of a method with its search for pixels, median over the frames of 400 pixels."""
    cameras = 2 if method == "two_sensors" else 1
    timed = [one for name, one in compared.items() if method in one and f"{PIXELS} px" in name]
    return float(np.median([1.0 / (cameras * one["search_s"] + one[method]["seconds"]) for one in timed]))


def ratio(compared: Mapping[str, JsonObject], method: str) -> float:
    """Return the altitude-free error over a rival's, geometric mean over the frames."""
    free, other = (np.array(list(errors(compared, m).values())) for m in ("altitude_free", method))
    return float(np.exp(np.mean(np.log(free / other))))


def rival_rows(compared: Mapping[str, JsonObject]) -> list[ComparisonRow]:
    """Return the altitude-free error over that of every rival, on the same pixels."""
    free = np.array(list(errors(compared, "altitude_free").values()))
    rows = []
    for method in NAMES[1:]:
        other = np.array(list(errors(compared, method).values()))
        fields: dict[str, Any] = {"method": TEXT.phrase(method, off=ALTITUDE_OFF), "frames": len(other)}
        better = float(np.mean(free < other))
        rows.append(TEXT.row("rival", ratio(compared, method), better=better, rms=rms(other), **fields))
    return rows


def rival_table(compared: Mapping[str, JsonObject]) -> Table:
    """Return errors and frame rates of all methods."""
    lines: list[tuple[Cell, ...]] = []
    for method in NAMES:
        by_frame = errors(compared, method)
        found = np.array(list(by_frame.values()))
        published = rms(value for name, value in by_frame.items() if name.startswith("set-up"))
        spread = (rms(found), float(np.median(found)), float(found.max()), published)
        cells = (float(f"{value:.3g}") for value in spread)
        lines.append((TEXT.phrase(method, off=ALTITUDE_OFF), *cells, float(f"{rate(compared, method):.3g}")))
    return TEXT.table("rivals", lines, frames=len(errors(compared, NAMES[0])), pixels=PIXELS, field_deg=FIELD_DEG)
