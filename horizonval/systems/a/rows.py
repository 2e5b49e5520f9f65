"""The rows of the altitude-free sensor: what the paper showed beside what this run measured."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.systems.a.bank import SET_UPS
from horizonval.systems.a.check import SAMPLES
from horizonval.systems.a.table import (
    TEXT,
    Bank,
    ratios_of_field,
    refused_share,
    rms,
    sharp_frames,
    steps_with_pixels,
    updates,
    values,
)
from horizonval.systems.published import published
from horizonval.systems.result import ComparisonRow

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

    whole, level, limb = (rms(errors(method)) for method in ("whole, newton", "level, newton", "limb, newton"))
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
            level=level,
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
