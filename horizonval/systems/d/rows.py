"""Rows and tables of the four linear heads: printed readings beside ours, why they differ, the working range."""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.linear_heads import published_angles
from horizonval.systems.d.settings import (
    MOMENTS,
    PUBLISHED,
    QUANTUM_DEG,
    TABLES,
    Setting,
)
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.text import page_text

TEXT = page_text("D")
SUB_PIXEL_LIMIT_DEG = 0.005
METHODS = ("published", "sub_pixel")


def _entries(readings: dict[str, JsonObject]) -> list[tuple[int, Setting, str, float | None, float | None, JsonObject]]:
    """Return (table, setting, axis, printed, ours, reading) of every figure of the tables."""
    return [
        (number, setting, axis, printed, readings[setting.key]["published"][axis], readings[setting.key])
        for number, settings in TABLES.items()
        for setting in settings
        for axis, printed in setting.read.items()
    ]


def exact_angle(reading: JsonObject, axis: str) -> float:
    """Return what the published formula makes of the exact crossings of the hard horizon [deg]."""
    element_rad = math.radians(PUBLISHED.number("element"))
    pitch, roll = published_angles(np.array(reading["exact_px"], dtype=float), element_rad)
    return math.degrees(pitch if axis == "pitch" else roll)


def pixel_errors(readings: dict[str, JsonObject]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return published, exact and sub-pixel crossings [px] of all heads and attitudes, shape (n,) each."""
    columns = [(r[k]) for k in ("published_px", "exact_px", "sub_pixel_px") for r in readings.values()]
    whole, exact, sub = np.array(columns, dtype=float).reshape(3, -1)
    return whole, exact, sub


def largest_departure(hard: dict[str, JsonObject]) -> float:
    """Return the largest departure [deg] of a reading from the printed one."""
    return max(abs(o - p) for _, _, _, p, o, _ in _entries(hard) if p is not None and o is not None)


def four_digits(value: float) -> str:
    """Return four decimals with a sign, but zero without one."""
    text = f"{value:+.4f}"
    return text if float(text) else "0"


def _errors(readings: dict[str, JsonObject], number: int, axis: str, method: str) -> np.ndarray:
    """Return reading minus truth [deg] of one table's settings; lost ones left out."""
    pairs = [(readings[s.key][method][axis], s.true_deg(axis)) for s in TABLES[number]]
    return np.array([read - true for read, true in pairs if read is not None])


def moment_rows(hard: dict[str, JsonObject]) -> list[ComparisonRow]:
    """Return mean and standard deviation of the errors of every table that has them printed."""
    expected = QUANTUM_DEG * math.sqrt(4 / 12)
    rows = []
    for (number, axis), (mean, deviation) in MOMENTS.items():
        errors = _errors(hard, number, axis, "published")
        n = len(errors)
        fields = {"table": number, "axis": axis, "n": n, "expected": expected, "expected_mean": expected / math.sqrt(n)}
        rows.append(TEXT.row("mean", float(errors.mean()), mean, **fields))
        rows.append(TEXT.row("deviation", float(errors.std(ddof=1)), deviation, **fields))
    return rows


def cause_rows(hard: dict[str, JsonObject]) -> list[ComparisonRow]:
    """Return what shows that whole pixels make the published errors."""
    entries = _entries(hard)
    printed = np.array([p for _, _, _, p, _, _ in entries if p is not None]) / QUANTUM_DEG
    ours = np.array([o for _, _, _, _, o, _ in entries if o is not None]) / QUANTUM_DEG
    off_print, off_ours = (np.abs(values - np.rint(values)) for values in (printed, ours))
    whole, exact, sub = pixel_errors(hard)
    largest = np.abs(whole - exact - (whole - exact).mean()).max()
    formula = float(max(abs(exact_angle(r, axis) - s.true_deg(axis)) for _, s, axis, _, _, r in entries))
    claims = PUBLISHED.figures
    return [
        TEXT.row(
            "printed_multiples", float(off_print.max() * QUANTUM_DEG), claims["quantum_multiples"].value, limit=1e-4
        ),
        TEXT.row("multiples", float(off_ours.max() * QUANTUM_DEG), limit=1e-6),
        TEXT.row(
            "whole_pixels",
            float((whole - exact).std()),
            claims["whole_pixels"].value,
            limit=0.05,
            against=1 / math.sqrt(12),
            crossings=len(exact),
            largest=largest,
        ),
        TEXT.row("area_crossing", float(np.abs(sub - exact).max()), limit=0.05),
        TEXT.row("formula", formula, steps=formula / QUANTUM_DEG),
    ]


def worst(readings: dict[str, JsonObject], method: str) -> float:
    """Return the largest error of roll or pitch [deg] of a method, among the readings that it gives."""
    return max(
        abs(reading[method][axis] - reading[axis])
        for reading in readings.values()
        for axis in ("roll", "pitch")
        if reading[method][axis] is not None
    )


def _lost(readings: dict[str, JsonObject], limb: str) -> tuple[int, str]:
    """Return how many attitudes the sub-pixel crossing loses, and which."""
    lost = [key for key, reading in readings.items() if reading["sub_pixel"]["status"] != "valid"]
    return len(lost), TEXT.phrase(f"{'' if lost else 'none_'}lost_{limb}", attitudes="; ".join(lost))


def sub_pixel_rows(hard: dict[str, JsonObject], soft: dict[str, JsonObject], aim: JsonObject) -> list[ComparisonRow]:
    """Return what the sub-pixel crossing makes of the same rows."""
    rows = []
    for limb, readings, limit in (("hard", hard, 0.0), ("infrared", soft, None)):
        lost, which = _lost(readings, limb)
        fields = {"attitudes": len(readings), "whole_pixels": worst(readings, "published"), **aim}
        rows.append(TEXT.row(f"sub_pixel_{limb}", worst(readings, "sub_pixel"), limit=SUB_PIXEL_LIMIT_DEG, **fields))
        rows.append(TEXT.row(f"lost_{limb}", float(lost), limit=limit, lost=which, **fields))
    yawed = [hard[s.key]["published"] for s in TABLES[4]]
    spread = max(abs(r[axis] - yawed[0][axis]) for r in yawed for axis in ("roll", "pitch"))
    return [*rows, TEXT.row("yaw_spread", spread, PUBLISHED.figures["yaw_spread"].value, limit=1e-9)]


def range_rows(ends: dict[str, dict[str, JsonObject]]) -> list[ComparisonRow]:
    """Return the ends of the working range."""
    tilts = {limb: end["tilt_deg"] for limb, end in ends["tilt"].items() if end["tilt_deg"] is not None}
    return [
        *(TEXT.row("tilt_range", tilt, limb=limb) for limb, tilt in tilts.items()),
        *(TEXT.row("altitude_range", end["altitude_km"], end=name) for name, end in ends["altitude"].items()),
    ]


def tables(hard: dict[str, JsonObject], soft: dict[str, JsonObject]) -> list[Table]:
    """Return the published tables with ours beside: hard limb, infrared limb, sub-pixel, and how many steps apart."""

    def cell(value: float | None) -> str:
        return "lost" if value is None else four_digits(value)

    def apart(ours: float | None, printed: float | None) -> str:
        return "" if ours is None or printed is None else f"{abs(round((ours - printed) / QUANTUM_DEG))}"

    def line(s: Setting, axis: str) -> list[str | float]:
        read = s.read[axis]
        hard_limb, infrared = ([readings[s.key][m][axis] for m in METHODS] for readings in (hard, soft))
        steps = apart(hard_limb[0], read), apart(infrared[0], read)
        return [s.key, axis, s.true_deg(axis), *map(cell, (read, *hard_limb, *infrared)), *steps]

    return [
        TEXT.table("published", [line(s, axis) for s in settings for axis in s.read], number=number)
        for number, settings in TABLES.items()
    ]


def range_table(ends: dict[str, dict[str, JsonObject]]) -> Table:
    """Return the ends of the working range as a table."""
    tilts = {limb: end["tilt_deg"] for limb, end in ends["tilt"].items()}
    lines = [(limb, "none" if tilt is None else f"{tilt:.2f}") for limb, tilt in tilts.items()]
    lines += [(name, f"{end['altitude_km']:.0f} km") for name, end in ends["altitude"].items()]
    return TEXT.table("range", lines)
