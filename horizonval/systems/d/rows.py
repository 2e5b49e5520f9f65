"""Rows and tables of the four linear heads: printed readings beside ours, why they differ, the working range."""

from __future__ import annotations

import math

import numpy as np

from horizonval.estimation.methods.linear_heads import published_angles
from horizonval.systems.d import figures as figures
from horizonval.systems.d.published import (
    MOMENTS,
    PRINTED,
    QUANTUM_DEG,
    TABLES,
    TWO_QUANTA_DEG,
    Setting,
)
from horizonval.systems.result import Row, Table
from horizonval.systems.task_cache import Plain

SUB_PIXEL_LIMIT_DEG = 0.005


def _entries(readings: dict[str, Plain]) -> list[tuple[int, Setting, str, float | None, float | None, Plain]]:
    """Return (table, setting, axis, printed, ours, reading) of every figure of the tables."""
    return [
        (number, setting, axis, printed, readings[setting.key]["published"][axis], readings[setting.key])
        for number, settings in TABLES.items()
        for setting in settings
        for axis, printed in setting.read.items()
    ]


def exact_angle(reading: Plain, axis: str) -> float:
    """Return what the published formula makes of the exact crossings of the hard horizon [deg]."""
    pitch, roll = published_angles(np.array(reading["exact_px"], dtype=float), math.radians(0.1))
    return math.degrees(pitch if axis == "pitch" else roll)


def entry_rows(hard: dict[str, Plain]) -> list[Row]:
    """Return a row for every figure of the tables that was read, and one that says whether all printed ones were."""
    again = sum(printed is not None and ours is not None for _, _, _, printed, ours, _ in _entries(hard))
    rows = [
        Row(
            "printed readings of the five tables that were read again",
            PRINTED,
            again,
            f"of {PRINTED}",
            "A reading that a head refuses has no row below; this one counts them.",
            limit=PRINTED,
            at_least=True,
        )
    ]
    for number, setting, axis, printed, ours, reading in _entries(hard):
        if ours is None:
            continue
        exact = exact_angle(reading, axis)
        why = (
            f"The exact crossings give {_four(exact)} deg, rounding four of them to whole pixels adds "
            f"{_four(ours - exact)}; "
        )
        name = f"table {number}, {axis} read at {setting.key}"
        if printed is None:
            rows.append(Row(name, None, ours + 0.0, "deg", f"{why}the printed figure is lost."))
            continue
        why += _steps_apart(round((ours - printed) / QUANTUM_DEG))
        rows.append(Row(name, printed, ours + 0.0, "deg", why, limit=TWO_QUANTA_DEG, against=printed))
    return rows


def _steps_apart(steps: int) -> str:
    """Return in words how many whole pixels of one crossing lie between a reading and the printed one."""
    if steps == 0:
        return "the same step as printed."
    return f"{abs(steps)} step{'s' if abs(steps) > 1 else ''} of {QUANTUM_DEG:.4f} deg from the print."


def _four(value: float) -> str:
    """Return four decimals with a sign, but zero without one."""
    text = f"{value:+.4f}"
    return text if float(text) else "0"


def _errors(readings: dict[str, Plain], number: int, axis: str, method: str) -> np.ndarray:
    """Return reading minus truth [deg] of one table's settings; lost ones left out."""
    pairs = [(readings[s.key][method][axis], getattr(s, axis)) for s in TABLES[number]]
    return np.array([read - true for read, true in pairs if read is not None])


def moment_rows(hard: dict[str, Plain]) -> list[Row]:
    """Return mean and standard deviation of the errors of every table that has them printed."""
    expected = QUANTUM_DEG * math.sqrt(4 / 12)
    rows = []
    for (number, axis), (mean, deviation) in MOMENTS.items():
        errors = _errors(hard, number, axis, "published")
        n = len(errors)
        why = (
            f"Four roundings of +-1/2 pixel make a standard deviation of {expected:.4f} deg; the mean of {n} has one "
            f"of {expected / math.sqrt(n):.4f} deg."
        )
        name = f"table {number}, {axis} errors"
        rows.append(Row(f"{name}: mean", mean, float(errors.mean()), "deg", why))
        rows.append(Row(f"{name}: standard deviation", deviation, float(errors.std(ddof=1)), "deg", why))
    return rows


def cause_rows(hard: dict[str, Plain]) -> list[Row]:
    """Return what shows that whole pixels make the published errors."""
    entries = _entries(hard)
    printed = np.array([p for _, _, _, p, _, _ in entries if p is not None]) / QUANTUM_DEG
    ours = np.array([o for _, _, _, _, o, _ in entries if o is not None]) / QUANTUM_DEG
    off_print, off_ours = (np.abs(values - np.rint(values)) for values in (printed, ours))
    whole, exact, sub = figures.pixel_errors(hard)
    formula = [abs(exact_angle(r, axis) - getattr(s, axis)) for _, s, axis, _, _, r in entries]
    return [
        Row(
            "printed readings: largest distance from a whole multiple of 0.035355 deg",
            "0, to the four digits printed",
            float(off_print.max() * QUANTUM_DEG),
            "deg",
            "All printed figures are whole multiples, to their last digit.",
            limit=1e-4,
        ),
        Row(
            "our readings as published: largest distance from a whole multiple of 0.035355 deg",
            None,
            float(off_ours.max() * QUANTUM_DEG),
            "deg",
            "The difference of a linear interpolation is constant within a pixel, and its maximum falls on its start.",
            limit=1e-6,
        ),
        Row(
            "published crossing minus exact crossing: standard deviation",
            "0.289 for whole pixels",
            float((whole - exact).std()),
            "px",
            f"An even spread over a pixel has 1/sqrt(12) = 0.289 px; {len(exact)} crossings, "
            f"largest departure from their mean {np.abs(whole - exact - (whole - exact).mean()).max():.3f} px.",
            limit=0.05,
            against=1 / math.sqrt(12),
        ),
        Row(
            "area crossing minus exact crossing: largest",
            None,
            float(np.abs(sub - exact).max()),
            "px",
            "The same rows of the same frames: the light on them does know the fraction of the pixel.",
            limit=0.05,
        ),
        Row(
            "published formula on exact crossings: largest error",
            None,
            float(max(formula)),
            "deg",
            f"Terms of second order in roll and pitch that the formula leaves out: {max(formula) / QUANTUM_DEG:.2f} "
            "steps of the printed figures.",
        ),
    ]


def worst(readings: dict[str, Plain], method: str) -> float:
    """Return the largest error of roll or pitch [deg] of a method, among the readings that it gives."""
    found = [
        abs(reading[method][axis] - reading[axis])
        for reading in readings.values()
        for axis in ("roll", "pitch")
        if reading[method][axis] is not None
    ]
    return max(found)


def _lost(readings: dict[str, Plain]) -> list[str]:
    return [key for key, reading in readings.items() if reading["sub_pixel"]["status"] != "valid"]


def sub_pixel_rows(hard: dict[str, Plain], soft: dict[str, Plain], aim: Plain) -> list[Row]:
    """Return what the sub-pixel crossing makes of the same rows."""
    lost, lost_hard = _lost(soft), _lost(hard)
    yawed = [hard[s.key]["published"] for s in TABLES[4]]
    spread = max(abs(r[a] - yawed[0][a]) for r in yawed for a in ("roll", "pitch"))
    return [
        Row(
            "sub-pixel crossing and exact cone, all rows of the tables, no noise: worst error",
            None,
            worst(hard, "sub_pixel"),
            "deg",
            f"Worst of roll and pitch of {len(hard)} attitudes; what is left is the lens's fall-off across the window "
            f"and the converter's 12 bits. Whole pixels: {worst(hard, 'published'):.4f} deg.",
            limit=SUB_PIXEL_LIMIT_DEG,
        ),
        Row(
            "attitudes of the tables lost by the sub-pixel crossing, hard limb",
            None,
            float(len(lost_hard)),
            f"of {len(hard)}",
            f"Lost: {'; '.join(lost_hard)}." if lost_hard else "None is left out of the worst error above.",
            limit=0.0,
        ),
        Row(
            "the same through the infrared limb (14 to 16.3 um, the same air all round): worst error",
            None,
            worst(soft, "sub_pixel"),
            "deg",
            f"Half of the plateau lies {aim['height_km']:.1f} km high in all directions, which the cone takes up in "
            f"its radius. Whole pixels there: {worst(soft, 'published'):.4f} deg.",
            limit=SUB_PIXEL_LIMIT_DEG,
        ),
        Row(
            "attitudes of the tables lost in the infrared",
            None,
            float(len(lost)),
            "of " + str(len(soft)),
            (f"Lost: {'; '.join(lost)}: " if lost else "None is lost: ")
            + f"heads at {aim['aim_deg']:.2f} deg from the nadir, where the infrared limb is from 400 km. A limb needs "
            "its plateau and space beside it within the 16 deg.",
        ),
        Row(
            "spread of the readings over four yaw angles",
            0.0,
            spread,
            "deg",
            "Turning about the vertical changes nothing over a sphere.",
            limit=1e-9,
        ),
    ]


def range_rows(ends: dict[str, dict[str, Plain]]) -> list[Row]:
    """Return the ends of the working range."""
    rows = []
    for name, found in ends["tilt"].items():
        if found["tilt_deg"] is None:
            continue
        why = (
            "Bisected on frames without noise: the largest t with pitch -t and roll t at which all heads see the limb."
        )
        rows.append(Row(f"working range, {name}", None, found["tilt_deg"], "deg", why))
    for name, found in ends["altitude"].items():
        why = "Bisected on frames: level, hard limb, heads fixed at 70.22 deg; the heads' field of 16 deg decides."
        rows.append(Row(f"working range, level: {name}", None, found["altitude_km"], "km", why))
    return rows


def tables(hard: dict[str, Plain], soft: dict[str, Plain]) -> list[Table]:
    """Return the published tables with ours beside: hard limb, infrared limb, sub-pixel."""
    made = []
    for number, settings in TABLES.items():
        lines = []
        for s in settings:
            for axis, printed in s.read.items():
                h, i = hard[s.key], soft[s.key]
                values = (h["published"][axis], h["sub_pixel"][axis], i["published"][axis], i["sub_pixel"][axis])
                shown = tuple("lost" if v is None else _four(v) for v in values)
                lines.append((s.key, axis, getattr(s, axis), "lost" if printed is None else _four(printed), *shown))
        made.append(
            Table(
                f"Published table {number} [deg]",
                (
                    "setting [deg]",
                    "axis",
                    "true",
                    "published",
                    "ours as published, hard limb",
                    "sub-pixel, hard limb",
                    "ours as published, infrared limb",
                    "sub-pixel, infrared limb",
                ),
                tuple(lines),
                "No detector noise. Infrared: US standard air over the sphere, heads turned up to its limb.",
            )
        )
    return made


def range_table(ends: dict[str, dict[str, Plain]]) -> Table:
    """Return the ends of the working range as a table."""
    lines = [
        (name, "none" if found["tilt_deg"] is None else f"{found['tilt_deg']:.2f}")
        for name, found in ends["tilt"].items()
    ]
    lines += [(name, f"{found['altitude_km']:.0f} km") for name, found in ends["altitude"].items()]
    return Table(
        "Working range of the fixed heads, measured on frames",
        ("limb", "largest t of pitch -t and roll t [deg], or altitude"),
        tuple(lines),
        "Heads of 16 deg fixed where the limb is from 400 km.",
    )


def largest_departure(rows: tuple[Row, ...]) -> float:
    """Return the largest departure [deg] from a printed reading."""
    return max(abs(r.measured - (r.against or 0.0)) for r in rows if r.limit == TWO_QUANTA_DEG)
