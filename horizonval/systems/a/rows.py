"""The rows of the altitude-free sensor: what the paper showed beside what this run measured."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from horizonval.systems.a.bank import SET_UP_PITCH_DEG, SET_UP_ROLL_DEG
from horizonval.systems.a.check import SAMPLES
from horizonval.systems.a.table import (
    Bank,
    ratios_of_field,
    refused_share,
    rms,
    steps_with_pixels,
    updates,
    values,
)
from horizonval.systems.result import ComparisonRow
from horizonval.systems.task_cache import Plain

SET_UP_OFF_AXIS_DEG = math.degrees(
    math.acos(math.cos(math.radians(SET_UP_ROLL_DEG)) * math.cos(math.radians(SET_UP_PITCH_DEG)))
)
"""Angle between the boresight and the nadir in the published set-ups."""
UPDATE_LIMIT_RAD = 1e-6
NADIR_LIMIT_ARCSEC = 5.0
CURVE_LIMIT_PX = 1e-3
"""Edges of our frames against the exact horizon: a thousandth of a pixel is far below every error in the tables."""


def set_up_rows(shown: Mapping[str, Plain]) -> list[ComparisonRow]:
    """Return the errors of the published method on the published set-ups, and how many of these it answers."""
    answered = sum("refused" not in result["clean"]["whole, newton"] for result in shown.values())
    rows = [
        ComparisonRow(
            "published set-ups that the published method answers",
            len(shown),
            answered,
            f"of {len(shown)}",
            "A set-up that is refused has no rows below; this one counts them.",
            limit=len(shown),
            at_least=True,
        )
    ]
    for name, result in shown.items():
        one = result["clean"]["whole, newton"]
        if "refused" in one:
            continue
        why = (
            f"The paper's figure did not survive; ours is what {one['points']} whole pixels leave, each of them off by "
            f"{one['point_rms_arcsec']:.0f} arcsec rms."
        )
        for quantity, unit in (("roll_deg", "deg"), ("pitch_deg", "deg"), ("altitude_km", "km")):
            rows.append(ComparisonRow(f"{quantity.split('_')[0]} error, {name}", None, one[quantity], unit, why))
    return rows


def check_rows(checks: Mapping[str, Plain]) -> list[ComparisonRow]:
    """Return how far the image generator's edges lie from two authorities."""
    edges = sum(one["edges"] for one in checks.values())
    worst = max(one["curve_max_px"] for one in checks.values())
    stock = rms(one["stock_rms_px"] for one in checks.values())
    mean = float(
        np.average([o["stock_mean_px"] for o in checks.values()], weights=[o["edges"] for o in checks.values()])
    )
    return [
        ComparisonRow(
            "image generator against the exact horizon, largest departure",
            None,
            worst,
            "px",
            f"The paper checks its pictures by eye against a CAD program; here {edges} edges of five "
            "frames are compared "
            "with the projected horizon, computed without the renderer.",
            limit=CURVE_LIMIT_PX,
        ),
        ComparisonRow(
            "image generator against a stock renderer's sphere, rms",
            "alike by eye",
            stock,
            "px",
            f"The stock sphere is sampled {SAMPLES} times a pixel and its edges scatter by that; their "
            "mean departure is "
            f"{mean:.1e} px.",
            limit=0.02,
        ),
    ]


def convergence_rows(shown: Mapping[str, Plain], bank: Bank) -> list[ComparisonRow]:
    """Return the size of the fourth Newton update from both starts."""
    zero = [one["clean"]["whole, newton"] for one in shown.values()]
    worst_zero = max((one["updates"][3] for one in zero if len(one.get("updates", [])) > 3), default=0.0)
    fifth = max((one["updates"][4] for one in zero if len(one.get("updates", [])) > 4), default=0.0)
    from_three = [one["clean"]["three-point start"]["updates"] for one in shown.values()]
    worst_three = max((found[3] for found in from_three if len(found) > 3), default=0.0)
    limb, third = updates(bank, "limb, newton", 4), max(updates(bank, "limb, newton", 3))
    three = np.array(updates(bank, "three-point start", 4))
    return [
        ComparisonRow(
            "fourth Newton update, sub-pixel points, largest of the whole grid",
            "very small",
            max(limb),
            "rad",
            f"Started from the cone through three of the points; the third update is {third:.0e} rad "
            "at most, and where "
            f"it is below 1e-10 the iteration has ended and the fourth counts as nothing ({len(limb)} frames).",
            limit=UPDATE_LIMIT_RAD,
        ),
        ComparisonRow(
            "fourth Newton update, whole pixels, start from three of them, largest of the set-ups",
            "very small",
            worst_three,
            "rad",
            "The paper gives no start; three pixels are the fewest that make one, and the iteration "
            "is done in four steps.",
            limit=UPDATE_LIMIT_RAD,
        ),
        ComparisonRow(
            "fourth Newton update, whole pixels, start from three of them, 95th percentile of the grid",
            "very small",
            float(np.percentile(three, 95)),
            "rad",
            "Whole pixels leave residuals, with which the convergence is linear and slow where few "
            "of them lie on a short "
            f"arc; {np.mean(three > UPDATE_LIMIT_RAD):.1%} of the frames need more than four steps.",
            limit=UPDATE_LIMIT_RAD,
        ),
        ComparisonRow(
            "fourth Newton update, whole pixels, start at roll = pitch = 0, largest of the set-ups",
            "very small",
            worst_zero,
            "rad",
            f"{SET_UP_OFF_AXIS_DEG:.0f} deg from the solution the first step finds tangents in place of angles; the "
            "fifth update "
            f"is {fifth:.0e} "
            "rad. The paper's start is not known.",
            limit=UPDATE_LIMIT_RAD,
        ),
    ]


def accuracy_rows(bank: Bank) -> list[ComparisonRow]:
    """Return the nadir's error at 1024 pixels over 60 deg, and what the claimed covariances are worth."""
    sharp = [f for f in bank.values() if (f[0]["fov_deg"], f[0]["pixels"]) == (60.0, 1024)]
    by_method = {m: rms(values(sharp, m, "nadir_arcsec")) for m in ("whole, newton", "level, newton", "limb, newton")}
    noisy = {m: rms(values(sharp, m, "nadir_arcsec", "noisy")) for m in ("whole, newton", "limb, newton")}
    nees = values(bank.values(), "whole, newton", "nees")
    noisy_nees = values(sharp, "limb, newton", "nees", "noisy")
    where = "1024 px, 60 deg"
    return [
        ComparisonRow(
            f"nadir error, {where}, noise-free, sub-pixel points, rms",
            None,
            by_method["limb, newton"],
            "arcsec",
            f"{len(sharp)} attitudes and altitudes; a pixel is {60 * 3600 / 1024:.0f} arcsec. Points from the area "
            f"under the profile alone give {by_method['level, newton']:.1f}: the ground brightens with the square root "
            "of the distance from the limb, and that is allowed for here.",
            limit=NADIR_LIMIT_ARCSEC,
        ),
        ComparisonRow(
            f"nadir error, {where}, noise-free, whole pixels, rms",
            None,
            by_method["whole, newton"],
            "arcsec",
            f"Rounding to pixels costs a factor of {by_method['whole, newton'] / by_method['limb, newton']:.0f}.",
        ),
        ComparisonRow(
            f"nadir error, {where}, shipped lens and detector, sub-pixel points, rms",
            None,
            noisy["limb, newton"],
            "arcsec",
            f"Lens, noise and ten bits; most of it comes from short arcs: the median is "
            f"{np.median(values(sharp, 'limb, newton', 'nadir_arcsec', 'noisy')):.1f}.",
        ),
        ComparisonRow(
            f"nadir error, {where}, shipped lens and detector, whole pixels, rms",
            None,
            noisy["whole, newton"],
            "arcsec",
            f"{noisy['whole, newton'] / by_method['whole, newton']:.1f} times that of noise-free "
            "frames; a few short arcs "
            "decide both: the medians are "
            f"{np.median(values(sharp, 'whole, newton', 'nadir_arcsec', 'noisy')):.0f} and "
            f"{np.median(values(sharp, 'whole, newton', 'nadir_arcsec')):.0f}.",
        ),
        ComparisonRow(
            "squared error over claimed variance, whole pixels, median of the grid",
            None,
            float(np.median(nees)),
            "",
            "1.386 if the claim is right and the errors Gaussian (two degrees of freedom); mean "
            f"{np.mean(nees):.1f} for 2.",
            limit=0.7,
            against=1.386,
        ),
        ComparisonRow(
            f"squared error over claimed variance, {where}, noisy, sub-pixel points, median",
            None,
            float(np.median(noisy_nees)),
            "",
            "The claim holds a hundredth of a pixel of slow errors beside the noise: the lens's blur "
            "of the shaded limb, "
            "which neighbouring points share and residuals hardly show.",
            limit=1.386,
            against=1.386,
        ),
    ]


def trend_rows(bank: Bank) -> list[ComparisonRow]:
    """Return how errors go with pixels and with field."""
    falls = steps_with_pixels(bank, "whole, newton")
    points = ratios_of_field(bank, "whole, newton", "point_rms_arcsec", 40.0, 80.0)
    nadir = ratios_of_field(bank, "whole, newton", "nadir_arcsec", 40.0, 80.0)
    sharp = ratios_of_field(bank, "limb, newton", "nadir_arcsec", 40.0, 80.0)
    factor = float(np.exp(np.mean(np.log(falls))))
    return [
        ComparisonRow(
            "fall of the median nadir error from one number of pixels to the next, whole pixels, mean factor",
            "falls",
            factor,
            "",
            f"It falls in {np.mean(np.array(falls) > 1):.0%} of {len(falls)} steps, each a doubling but for the last.",
            limit=1.0,
            at_least=True,
        ),
        ComparisonRow(
            "error of a whole-pixel point, field of 80 over 40 deg at the same pixels, median factor",
            "grows",
            float(np.median(points)),
            "",
            f"{len(points)} conditions that both fields see; a pixel at the centre grows by 2.3, at the rim by less.",
            limit=1.0,
            at_least=True,
        ),
        ComparisonRow(
            "nadir error, field of 80 over 40 deg at the same pixels, whole pixels, median factor",
            "grows",
            float(np.median(nadir)),
            "",
            "The paper compares pictures of one attitude; over the grid the wider field has coarser "
            "pixels and sees a longer "
            "arc; " + ("the pixels weigh more." if np.median(nadir) >= 1.0 else "the arc weighs more."),
        ),
        ComparisonRow(
            "nadir error, field of 80 over 40 deg at the same pixels, sub-pixel points, median factor",
            "grows",
            float(np.median(sharp)),
            "",
            f"Without rounding what is left is a share of a pixel, and the pixels grow; {len(sharp)} conditions.",
            limit=1.0,
            at_least=True,
        ),
        ComparisonRow(
            "frames refused, whole pixels and Newton",
            None,
            refused_share(bank, "whole, newton"),
            "share",
            f"Of {len(bank)} frames; sub-pixel points with their search for the limb refuse "
            f"{refused_share(bank, 'limb, newton'):.1%}, short arcs of few pixels.",
        ),
    ]


def closed_form_rows(bank: Bank, solvers: Mapping[str, Plain]) -> list[ComparisonRow]:
    """Return what the closed form wins and loses against Newton's method."""
    both = {m: rms(values(bank.values(), m, "nadir_arcsec")) for m in ("limb, newton", "limb, closed")}
    medians = {m: np.median(values(bank.values(), m, "nadir_arcsec")) for m in ("whole, newton", "whole, closed")}
    plane = max(one["plane_difference"] for one in solvers.values())
    worst = max(solvers.values(), key=lambda one: float(one["closed_rms"] / one["newton_rms"]))
    steps = max(one["newton_steps"] for one in solvers.values())
    return [
        ComparisonRow(
            "nadir error, closed form over Newton, sub-pixel points of the whole grid, ratio of rms",
            None,
            both["limb, closed"] / both["limb, newton"],
            "",
            "On points this good the attenuation of the linear form is far below the error of the points: no start and "
            "no steps for the same answer.",
        ),
        ComparisonRow(
            "nadir error, closed form over Newton, whole pixels of the whole grid, ratio of medians",
            None,
            float(medians["whole, closed"] / medians["whole, newton"]),
            "",
            "The rounding's scatter enters squared, and short arcs amplify it: the linear form sees a smaller Earth.",
        ),
        ComparisonRow(
            "largest factor by which the closed form loses on noisy arcs, ratio of rms",
            None,
            worst["closed_rms"] / worst["newton_rms"],
            "",
            f"At an angular radius of {worst['rho_deg']:g} deg and {worst['arc_deg']:g} deg of arc, where its bias, "
            f"{worst['closed_bias']:.0f} arcsec, was foretold as {worst['foretold_closed_bias']:.0f}; Newton's is "
            "cos^2 rho of that.",
        ),
        ComparisonRow(
            "largest angle between Newton's nadir and the orthogonal plane's",
            None,
            plane,
            "arcsec",
            "Both minimise the sum of (u.n - cos rho)^2: the plane by one singular value decomposition, "
            "Newton in up to "
            f"{steps:.0f} least-squares problems.",
            limit=1e-3,
        ),
    ]
