"""Statistics of the altitude-free sensor's bank of frames: error table, trends, and rows of published and measured."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.systems.a.bank import ALTITUDES_KM, DRAWS, FIELDS_DEG, PIXELS, POINTS, SAMPLES, SET_UPS
from horizonval.systems.published import page_text, published
from horizonval.systems.result import Cell, ComparisonRow, Table

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


PUBLISHED = {key: figure.value for key, figure in published("A").figures.items()}
UPDATE_LIMIT_RAD = 1e-6
NADIR_LIMIT_ARCSEC = 5.0
CURVE_LIMIT_PX = 1e-3
"""Edges of our frames against the exact horizon: a thousandth of a pixel is far below every error in the tables."""


def off_axis_deg() -> float:
    """Return the angle between the boresight and the nadir in the published set-ups."""
    roll, pitch = (math.radians(SET_UPS[0][axis]) for axis in ("roll_deg", "pitch_deg"))
    return math.degrees(math.acos(math.cos(roll) * math.cos(pitch)))


def set_up_rows(shown: Mapping[str, JsonObject]) -> list[ComparisonRow]:
    """Return the errors of the published method on the published set-ups, and how many of these it answers."""
    answers = {name: result["clean"]["whole, newton"] for name, result in shown.items()}
    answers = {name: answer for name, answer in answers.items() if "refused" not in answer}
    count = len(shown)
    rows = [TEXT.row("set_ups", len(answers), count, limit=count, at_least=True, set_ups=count)]
    for name, answer in answers.items():
        for key in ("roll_deg", "pitch_deg", "altitude_km"):
            quantity, unit = key.split("_")
            fields = {"points": answer["points"], "point_rms": answer["point_rms_arcsec"]}
            rows.append(TEXT.row("set_up", answer[key], quantity=quantity, set_up=name, unit=unit, **fields))
    return rows


def check_rows(checks: Mapping[str, JsonObject]) -> list[ComparisonRow]:
    """Return how far the image generator's edges lie from two authorities."""
    edges = [check["edges"] for check in checks.values()]
    worst = max(check["curve_max_px"] for check in checks.values())
    stock = rms(check["stock_rms_px"] for check in checks.values())
    mean = float(np.average([check["stock_mean_px"] for check in checks.values()], weights=edges))
    return [
        TEXT.row("curve", worst, limit=CURVE_LIMIT_PX, edges=sum(edges)),
        TEXT.row("stock_sphere", stock, PUBLISHED["cross_check"], limit=0.02, samples=SAMPLES, mean=mean),
    ]


def convergence_rows(shown: Mapping[str, JsonObject], bank: Bank) -> list[ComparisonRow]:
    """Return the size of the fourth Newton update from both starts."""
    zero = [result["clean"]["whole, newton"].get("updates", []) for result in shown.values()]
    three = [result["clean"]["three-point start"]["updates"] for result in shown.values()]
    sub_pixel = updates(bank, "limb, newton", 4)
    on_grid = np.array(updates(bank, "three-point start", 4))

    def row(key: str, update_rad: float, **fields: Any) -> ComparisonRow:
        return TEXT.row(key, update_rad, PUBLISHED["fourth_update"], limit=UPDATE_LIMIT_RAD, **fields)

    return [
        row(
            "update_sub_pixel",
            max(sub_pixel),
            third=max(updates(bank, "limb, newton", 3)),
            frames=len(sub_pixel),
        ),
        row("update_three", _largest(three, 4)),
        row(
            "update_three_grid",
            float(np.percentile(on_grid, 95)),
            slow=float(np.mean(on_grid > UPDATE_LIMIT_RAD)),
        ),
        row("update_zero", _largest(zero, 4), off_axis=off_axis_deg(), fifth=_largest(zero, 5)),
    ]


def _largest(sequences: list[list[float]], step: int) -> float:
    """Return the largest update of a step (the first is 1); 0 where every iteration ended before."""
    return max((sequence[step - 1] for sequence in sequences if len(sequence) >= step), default=0.0)


def accuracy_rows(bank: Bank) -> list[ComparisonRow]:
    """Return the nadir's error at 1024 pixels over 60 deg, and what the claimed covariances are worth."""
    sharp = sharp_frames(bank)

    def errors(method: str, light: str = "clean") -> list[float]:
        return values(sharp, method, "nadir_arcsec", light)

    whole, limb = (rms(errors(method)) for method in ("whole, newton", "limb, newton"))
    whole_noisy, limb_noisy = (errors(method, "noisy") for method in ("whole, newton", "limb, newton"))
    nees = values(bank.values(), "whole, newton", "nees")
    noisy_nees = values(sharp, "limb, newton", "nees", "noisy")
    camera = "1024 px, 60 deg"
    return [
        TEXT.row(
            "sub_pixel",
            limb,
            limit=NADIR_LIMIT_ARCSEC,
            camera=camera,
            frames=len(sharp),
            pixel=60 * 3600 / 1024,
        ),
        TEXT.row("whole", whole, camera=camera, factor=whole / limb),
        TEXT.row("sub_pixel_noisy", rms(limb_noisy), camera=camera, median=np.median(limb_noisy)),
        TEXT.row(
            "whole_noisy",
            rms(whole_noisy),
            camera=camera,
            factor=rms(whole_noisy) / whole,
            median=np.median(whole_noisy),
            median_clean=np.median(errors("whole, newton")),
        ),
        TEXT.row("covariance_whole", float(np.median(nees)), limit=0.7, against=1.386, mean=np.mean(nees)),
        TEXT.row("covariance_sub_pixel", float(np.median(noisy_nees)), limit=0.7, against=1.386, camera=camera),
    ]


def trend_rows(bank: Bank) -> list[ComparisonRow]:
    """Return how errors go with pixels and with field."""
    falls = steps_with_pixels(bank, "whole, newton")
    points = ratios_of_field(bank, "whole, newton", "point_rms_arcsec", 40.0, 80.0)
    whole = ratios_of_field(bank, "whole, newton", "nadir_arcsec", 40.0, 80.0)
    sub_pixel = ratios_of_field(bank, "limb, newton", "nadir_arcsec", 40.0, 80.0)
    factor = float(np.exp(np.mean(np.log(falls))))
    share = np.mean(np.array(falls) > 1)
    weighs = TEXT.phrase("pixels_weigh" if np.median(whole) >= 1.0 else "arc_weighs")
    return [
        TEXT.row(
            "pixels",
            factor,
            PUBLISHED["error_with_pixels"],
            limit=1.0,
            at_least=True,
            share=share,
            steps=len(falls),
        ),
        TEXT.row("field_points", float(np.median(points)), conditions=len(points)),
        TEXT.row("field_whole", float(np.median(whole)), weighs=weighs),
        TEXT.row(
            "field_sub_pixel",
            float(np.median(sub_pixel)),
            conditions=len(sub_pixel),
        ),
        TEXT.row(
            "refused",
            refused_share(bank, "whole, newton"),
            frames=len(bank),
            sub_pixel=refused_share(bank, "limb, newton"),
        ),
    ]


def closed_form_rows(bank: Bank, solvers: Mapping[str, JsonObject]) -> list[ComparisonRow]:
    """Return what the closed form wins and loses against Newton's method."""
    newton, closed = (rms(values(bank.values(), m, "nadir_arcsec")) for m in ("limb, newton", "limb, closed"))
    whole_newton, whole_closed = (
        np.median(values(bank.values(), m, "nadir_arcsec")) for m in ("whole, newton", "whole, closed")
    )
    worst = max(solvers.values(), key=lambda condition: float(condition["closed_rms"] / condition["newton_rms"]))
    plane_arcsec = max(condition["plane_difference"] for condition in solvers.values())
    steps = max(condition["newton_steps"] for condition in solvers.values())
    return [
        TEXT.row("closed_sub_pixel", closed / newton),
        TEXT.row("closed_whole", float(whole_closed / whole_newton)),
        TEXT.row("closed_worst", worst["closed_rms"] / worst["newton_rms"], **worst),
        TEXT.row("plane", plane_arcsec, limit=1e-3, steps=steps),
    ]
