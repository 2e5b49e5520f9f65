"""What each thing costs the four linear heads: whole pixels, formula, noise, ellipsoid, air."""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.text import page_text

TEXT = page_text("D")
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
