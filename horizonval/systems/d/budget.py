"""What each thing costs the four linear heads: whole pixels, formula, noise, ellipsoid, air."""

from __future__ import annotations

import math

import numpy as np

from horizonval.systems.result import Row, Table
from horizonval.systems.task_cache import Plain

AXES = ("roll", "pitch")
CHECKED_DEG = "240"


def nadir_errors(readings: dict[str, Plain], method: str, key: str = "nadir_error") -> np.ndarray:
    """Return the nadir errors [deg] of readings that gave one."""
    return np.array([r[method][key] for r in readings.values() if r[method][key] is not None])


def noise_of(readings: dict[str, Plain], method: str) -> tuple[float, float, int]:
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
    hard: dict[str, Plain], soft: dict[str, Plain], orbit: dict[str, dict[str, Plain]]
) -> tuple[list[Row], Table]:
    """Return rows and the table of the error budget: nadir error, both methods."""
    real = {case: readings for case, readings in orbit.items() if case.startswith("oblate, ")}
    lines: list[tuple[str, str, str, str, str]] = []

    def line(what: str, readings: dict[str, Plain], note: str) -> None:
        whole, sub = nadir_errors(readings, "published"), nadir_errors(readings, "sub_pixel")
        cells = (f"{rms(whole):.4f} / {whole.max():.4f}", f"{rms(sub):.4f} / {sub.max():.4f}")
        lines.append((what, *cells, f"{len(sub)}", note))

    line("pixels, hard limb", hard, "sphere without air, no noise: all attitudes of the tables")
    line("pixels, infrared limb", soft, "the same air all round, no noise")
    for what, readings in (("noise, hard limb", hard), ("noise, infrared limb", soft)):
        values = [noise_of(readings, method) for method in ("published", "sub_pixel")]
        cells = tuple(f"{math.sqrt(2) * v[0]:.4f}" for v in values)
        lines.append((what, cells[0], cells[1], f"{values[1][2]}", "rms about the noiseless reading, both axes"))
    line("ellipsoid", orbit["oblate"], "WGS84 without air, level round the orbit, against the geocentric nadir")
    for case, readings in real.items():
        line(case, readings, "level round the orbit, by latitude and month, against the geocentric nadir")
    rows = [*_noise_rows(hard, soft), *_orbit_rows(orbit, real)]
    return rows, Table(
        "Error budget: nadir error, rms / worst [deg]",
        ("cause", "whole pixels and formula", "sub-pixel and cone", "readings", "frames"),
        tuple(lines),
        "Each line is measured on frames of its own; pixels cannot be switched off in any of them.",
    )


def _noise_rows(hard: dict[str, Plain], soft: dict[str, Plain]) -> list[Row]:
    rows = []
    for limb, readings in (("hard", hard), ("infrared", soft)):
        sigma, nees, draws = noise_of(readings, "sub_pixel")
        rows.append(
            Row(
                f"detector noise, sub-pixel, {limb} limb: standard deviation of roll and pitch",
                None,
                sigma,
                "deg",
                f"{draws} draws of the pyroelectric noise on {sum('noisy' in r for r in readings.values())} attitudes.",
            )
        )
        rows.append(
            Row(
                f"claimed covariance, sub-pixel, {limb} limb: mean normalised error squared over its 2 degrees",
                None,
                nees / 2.0,
                "",
                "1 for an honest covariance; it also claims what the locator may be off without noise.",
                limit=0.75,
                against=1.25,
            )
        )
    return rows


def _orbit_rows(orbit: dict[str, dict[str, Plain]], real: dict[str, dict[str, Plain]]) -> list[Row]:
    oblate = orbit["oblate"]
    geodetic = nadir_errors(oblate, "sub_pixel", "geodetic_error")
    rows = [
        Row(
            "ellipsoid: worst nadir error round the orbit, sub-pixel",
            None,
            float(nadir_errors(oblate, "sub_pixel").max()),
            "deg",
            f"A cone is fitted to the horizon of WGS84; its axis lies near the geodetic vertical (worst "
            f"{geodetic.max():.4f} deg from that), so most of it is known from the latitude.",
        )
    ]
    for case, readings in real.items():
        air = air_alone(readings, oblate)
        rows.append(
            Row(
                f"{case.removeprefix('oblate, ')} alone: worst nadir error round the orbit, sub-pixel",
                None,
                float(np.linalg.norm(air, axis=1).max()),
                "deg",
                f"Readings through air minus readings without, over the same ellipsoid; rms "
                f"{rms(np.linalg.norm(air, axis=1)):.4f} deg: the limb of CO2 is not equally high all round.",
            )
        )
        worst = nadir_errors(readings, "sub_pixel")
        rows.append(
            Row(
                f"{case}: worst nadir error round the orbit, sub-pixel",
                None,
                float(worst.max()),
                "deg",
                f"Against the geocentric nadir; {nadir_errors(readings, 'sub_pixel', 'geodetic_error').max():.4f} deg "
                f"against the geodetic one.",
            )
        )
        _, nees, draws = noise_of(readings, "sub_pixel")
        rows.append(
            Row(
                f"{case}: mean normalised error squared over its 2 degrees",
                None,
                nees / 2.0,
                "",
                f"{draws} draws. The claimed covariance is that of the noise alone: the excess over 1 is what "
                "ellipsoid and air add, which the method does not know of.",
            )
        )
    july = real["oblate, air of July"]
    alone = orbit["air of July"][CHECKED_DEG]
    differences = np.array([july[CHECKED_DEG]["sub_pixel"][a] - oblate[CHECKED_DEG]["sub_pixel"][a] for a in AXES])
    rendered = np.array([alone["sub_pixel"][a] for a in AXES])
    rows.append(
        Row(
            "air alone: frames over a sphere against the difference over the ellipsoid",
            None,
            float(np.linalg.norm(differences - rendered)),
            "deg",
            f"At {CHECKED_DEG} deg of argument of latitude in July: the two effects add up to this.",
        )
    )
    return rows


def air_alone(real: dict[str, Plain], oblate: dict[str, Plain]) -> np.ndarray:
    """Return roll and pitch [deg] that the air adds, shape (places, 2)."""
    return np.array(
        [[r["sub_pixel"][axis] - oblate[argument]["sub_pixel"][axis] for axis in AXES] for argument, r in real.items()]
    )
