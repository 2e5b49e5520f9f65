"""Rows and tables of the four linear heads.

Printed readings and ours with the reasons of their differences; how many printed figures our readings share, and what
chance would share; the error budget by whole pixels, formula, noise, ellipsoid and air; the working range.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.linear_heads import published_angles
from horizonval.systems.d.steps import (
    COLUMNS,
    MOMENTS,
    PHASES,
    PRINTED,
    PUBLISHED,
    QUANTUM_DEG,
    TABLES,
    TRUE_DEG,
    BestPhases,
    HeadVariant,
    Setting,
    alike_phases,
    best_phases,
    chance,
    count,
    cross_axis,
    lost_elsewhere,
    odd_columns,
    rendered_steps,
    same_step,
    variants,
)
from horizonval.systems.published import page_text
from horizonval.systems.result import ComparisonRow, Table

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


PLAIN = HeadVariant(perspective=False)
FLAT = HeadVariant(perspective=True)


@dataclass(frozen=True)
class StepScore:
    """Figures on the printed step.

    ``rendered``: by the frames' name, with the untilted axis; ``truth``: of rounded truth; ``chance``: counts of evenly
    spread phases, for equiangular pixels; ``best``: fitted phases by projection; ``variants``: counts of all phases.
    """

    rendered: dict[str, tuple[int, int]]
    truth: int
    chance: np.ndarray
    best: dict[HeadVariant, BestPhases]
    variants: dict[HeadVariant, list[int]]

    def by_chance(self, reached: int) -> float:
        """Return the share of phases that do as well."""
        return float((self.chance >= reached).mean())


def score_steps(readings: dict[str, dict[str, JsonObject]], rng: np.random.Generator) -> StepScore:
    """Count; ``readings`` are those of all settings, by the name of the frames."""
    crossings = variants()
    across = cross_axis()

    def both(steps: FloatArray) -> tuple[int, int]:
        return count(steps), int((same_step(steps) & across).sum())

    return StepScore(
        rendered={name: both(rendered_steps(one)) for name, one in readings.items()},
        truth=count(TRUE_DEG / QUANTUM_DEG),
        chance=chance(crossings[PLAIN], rng),
        best={one: best_phases(crossings[one]) for one in (PLAIN, FLAT)},
        variants={one: alike_phases(x) for one, x in crossings.items()},
    )


def step_rows(score: StepScore) -> list[ComparisonRow]:
    """Return what is on the printed step, against what needs no sensor and against chance."""
    across = int(cross_axis().sum())
    distinct = len({(s.roll_deg, s.pitch_deg, s.altitude_km) for s in COLUMNS})
    rows = [
        TEXT.row(
            "same_step",
            reached,
            PRINTED,
            limit=score.truth,
            at_least=True,
            frames=name,
            printed=PRINTED,
            truth=score.truth,
            chance=score.by_chance(reached),
        )
        for name, (reached, _) in score.rendered.items()
    ]
    rows.append(TEXT.row("truth_step", score.truth, PRINTED, printed=PRINTED, distinct=distinct))
    mean, top = float(score.chance.mean()), int(score.chance.max())
    rows.append(TEXT.row("chance_step", mean, PRINTED, printed=PRINTED, top=top, truth=score.by_chance(score.truth)))
    for one, best in score.best.items():
        projection = TEXT.phrase("flat" if one.perspective else "equal_angle")
        fields: dict[str, Any] = {"ways": best.ways, "tried": PHASES**4, "right": best.across, "across": across}
        rows.append(TEXT.row("best_step", best.count, PRINTED, printed=PRINTED, projection=projection, **fields))
    for name, (_, right) in score.rendered.items():
        rows.append(TEXT.row("across", right, across, across=across, frames=name))
    moved = lost_elsewhere()
    rows.append(
        TEXT.row("odd", len(odd_columns()), columns=len(COLUMNS), odd="; ".join(odd_columns()), lost="; ".join(moved))
    )
    return rows


def variant_table(score: StepScore) -> Table:
    """Return the counts of every variant: pixels centred on the axis as here, and over all phases."""
    lines = []
    for one, counts in score.variants.items():
        projection = TEXT.phrase("flat" if one.perspective else "equal_angle")
        ends = f"{min(counts)} to {max(counts)}"
        lines.append((projection, f"{one.row_px:g}", f"{one.limb_km:g}", counts[PHASES // 2], ends))
    return TEXT.table("variants", lines, phases=PHASES, printed=PRINTED)


AXES = ("roll", "pitch")
CHECKED_DEG = "240"


def nadir_errors(readings: dict[str, JsonObject], method: str, key: str = "nadir_error") -> np.ndarray:
    """Return the nadir errors [deg] of readings that gave one."""
    return np.array([r[method][key] for r in readings.values() if r[method][key] is not None])


def noise_of(readings: dict[str, JsonObject], method: str) -> tuple[float, float, int]:
    """Return the standard deviation of roll and pitch [deg] about the noiseless reading, mean NEES, number of draws."""
    apart, nees = [], []
    for reading in readings.values():
        for draw in reading.get("noisy", []):
            if draw[method]["nees"] is None:
                continue
            apart += [draw[method][axis] - reading[method][axis] for axis in AXES]
            nees.append(draw[method]["nees"])
    return math.sqrt(float(np.mean(np.square(apart)))), float(np.mean(nees)), len(nees)


def rms(errors: np.ndarray) -> float:
    """Return the root mean square."""
    return math.sqrt(float(np.mean(np.square(errors))))


def budget(
    hard: dict[str, JsonObject], soft: dict[str, JsonObject], orbit: dict[str, dict[str, JsonObject]]
) -> tuple[list[ComparisonRow], Table]:
    """Return rows and the table of the error budget: nadir error, both methods."""
    real = {case: readings for case, readings in orbit.items() if case.startswith("oblate, ")}
    lines: list[tuple[str, ...]] = []

    def line(cause: str, readings: dict[str, JsonObject], frames: str) -> None:
        whole, sub = nadir_errors(readings, "published"), nadir_errors(readings, "sub_pixel")
        cells = (f"{rms(whole):.4f} / {whole.max():.4f}", f"{rms(sub):.4f} / {sub.max():.4f}")
        lines.append((cause, *cells, f"{len(sub)}", TEXT.phrase(frames)))

    line("pixels, hard limb", hard, "hard_frames")
    line("pixels, infrared limb", soft, "infrared_frames")
    for cause, readings in (("noise, hard limb", hard), ("noise, infrared limb", soft)):
        (whole, _, _), (sub, _, draws) = (noise_of(readings, method) for method in ("published", "sub_pixel"))
        cells = (f"{math.sqrt(2) * whole:.4f}", f"{math.sqrt(2) * sub:.4f}")
        lines.append((cause, *cells, f"{draws}", TEXT.phrase("noise_frames")))
    line("ellipsoid", orbit["oblate"], "ellipsoid_frames")
    for case, readings in real.items():
        line(case, readings, "air_frames")
    return [*_noise_rows(hard, soft), *_orbit_rows(orbit, real)], TEXT.table("budget", lines)


def _noise_rows(hard: dict[str, JsonObject], soft: dict[str, JsonObject]) -> list[ComparisonRow]:
    rows = []
    for limb, readings in (("hard", hard), ("infrared", soft)):
        sigma, nees, draws = noise_of(readings, "sub_pixel")
        attitudes = sum("noisy" in reading for reading in readings.values())
        rows.append(TEXT.row("noise", sigma, limb=limb, draws=draws, attitudes=attitudes))
        rows.append(TEXT.row("covariance", nees / 2.0, limit=0.75, against=1.25, limb=limb))
    return rows


def _orbit_rows(orbit: dict[str, dict[str, JsonObject]], real: dict[str, dict[str, JsonObject]]) -> list[ComparisonRow]:
    oblate = orbit["oblate"]
    geodetic_deg = nadir_errors(oblate, "sub_pixel", "geodetic_error").max()
    rows = [TEXT.row("ellipsoid", float(nadir_errors(oblate, "sub_pixel").max()), geodetic_deg=geodetic_deg)]
    for case, readings in real.items():
        air = np.linalg.norm(air_alone(readings, oblate), axis=1)
        rows.append(TEXT.row("air", float(air.max()), air=case.removeprefix("oblate, "), rms_deg=rms(air)))
        worst = float(nadir_errors(readings, "sub_pixel").max())
        geodetic_deg = nadir_errors(readings, "sub_pixel", "geodetic_error").max()
        rows.append(TEXT.row("ellipsoid_and_air", worst, case=case, geodetic_deg=geodetic_deg))
        _, nees, draws = noise_of(readings, "sub_pixel")
        rows.append(TEXT.row("covariance_orbit", nees / 2.0, case=case, draws=draws))
    july, alone = (orbit[case][CHECKED_DEG]["sub_pixel"] for case in ("oblate, air of July", "air of July"))
    without = oblate[CHECKED_DEG]["sub_pixel"]
    differences = np.array([july[axis] - without[axis] for axis in AXES])
    rendered = np.array([alone[axis] for axis in AXES])
    rows.append(TEXT.row("additive", float(np.linalg.norm(differences - rendered)), argument=CHECKED_DEG))
    return rows


def air_alone(real: dict[str, JsonObject], oblate: dict[str, JsonObject]) -> np.ndarray:
    """Return roll and pitch [deg] that the air adds, shape (places, 2)."""
    return np.array(
        [[r["sub_pixel"][axis] - oblate[argument]["sub_pixel"][axis] for axis in AXES] for argument, r in real.items()]
    )
