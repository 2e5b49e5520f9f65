"""The pictures of the four linear heads' page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure as MplFigure
from scipy.optimize import brentq

from horizonval.core.json_types import JsonObject
from horizonval.geometry.frames import nadir_of_roll_pitch
from horizonval.systems.d.rows import StepScore, air_alone, pixel_errors
from horizonval.systems.d.steps import ALL, PRINTED, PUBLISHED, QUANTUM_DEG, TABLES

BLUE, ORANGE, GREEN, BLACK = "#0072b2", "#d55e00", "#009e73", "#000000"
HEADS = ("az45", "az135", "az225", "az315")
"""From left to right in the picture; kept results come in the order of their names."""
RADIUS_KM = PUBLISHED.number("earth_radius")
HALF_FIELD_DEG = 0.5 * PUBLISHED.number("elements") * PUBLISHED.number("element")


def draw_pictures(pictures: dict[str, JsonObject]) -> MplFigure:
    """The heads' pictures of 160 x 160 pixels, as published, with the row of the array and its coarse crossing."""
    figure = MplFigure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.subplots(len(pictures), 4, squeeze=False, sharex=True, sharey=True)
    for line, (limb, heads) in zip(axes, pictures.items(), strict=True):
        for ax, name in zip(line, HEADS, strict=True):
            head = heads[name]
            image = np.array(head["dn"])
            middle = len(image) // 2
            ax.imshow(image, cmap="gray", interpolation="nearest")
            ax.axhline(middle, color="white", lw=2.2)
            ax.axhline(middle, color=BLUE, lw=1.2, ls="--")
            ax.plot(head["published_px"], middle, "o", ms=8, mfc="none", mec="white", mew=3)
            ax.plot(head["published_px"], middle, "o", ms=8, mfc="none", mec=ORANGE, mew=1.6)
            ax.set_title(f"head {name}", fontsize=9)
            ax.set(xlim=(-0.5, 159.5), xticks=(0, 50, 100), yticks=(0, 50, 100, 150))
            ax.grid(visible=False)
        line[0].set_ylabel(f"{limb.replace(', ', chr(10))}\nrow [pixels]", fontsize=8)
    figure.supxlabel("column [pixels of 0.1°], outwards", fontsize=9)
    return figure


def draw_rows(pictures: dict[str, JsonObject]) -> MplFigure:
    """The rows of one head through both limbs."""
    figure = MplFigure(figsize=(8.0, 3.4), layout="constrained")
    ax = figure.subplots()
    for (limb, heads), colour, style, marker in zip(pictures.items(), (BLUE, ORANGE), "-:", "os", strict=True):
        head = heads["az45"]
        row = np.array(head["dn"])[80].astype(float)
        column = np.arange(len(row))
        ax.plot(column, row / row.max(), style, marker=marker, ms=3.5, color=colour, label=limb)
        ax.axvline(head["published_px"], color=colour, ls=style, lw=0.9)
    ax.set(xlim=(50, 110), xlabel="column [pixels of 0.1°], outwards", ylabel="signal / largest of the row")
    ax.legend(loc="upper right", frameon=False)
    return figure


def draw_steps(score: StepScore) -> MplFigure:
    """Counts on the printed step by chance, and those that were read."""
    figure = MplFigure(figsize=(8.0, 3.6), layout="constrained")
    ax = figure.subplots()
    counts = np.bincount(score.chance, minlength=PRINTED + 1) / len(score.chance)
    ax.bar(np.arange(len(counts)), 100.0 * counts, width=0.9, color="#c8c8c8", label="phases by chance")
    marks = [(reached, name) for name, (reached, _) in score.rendered.items()]
    marks += [(score.truth, "rounded truth"), (max(b.count for b in score.best.values()), "phases chosen for it")]
    styles = zip((BLUE, GREEN, ORANGE, BLACK, BLACK), ("-", "--", "-.", "-", ":"), strict=True)
    for (reached, name), (colour, style) in zip(marks, styles, strict=True):
        ax.axvline(reached, color=colour, ls=style, lw=1.6, label=f"{name}: {reached}")
    ax.set(xlabel=f"figures on the printed step, of {PRINTED}", ylabel="share of the draws [%]", xlim=(0, PRINTED + 1))
    ax.legend(frameon=False, fontsize=8, loc="upper left")
    return figure


def draw_quantisation(hard: dict[str, JsonObject]) -> MplFigure:
    """Error of a crossing against the fraction of the pixel, and the readings in steps."""
    whole, exact, sub = pixel_errors(hard)
    readings = [hard[s.key]["published"][a] for t in TABLES.values() for s in t for a in s.read]
    better = [hard[s.key]["sub_pixel"][a] for t in TABLES.values() for s in t for a in s.read]
    printed = [p for t in TABLES.values() for s in t for p in s.read.values() if p is not None]

    def fractions(values: Sequence[float | None]) -> np.ndarray:
        steps = np.array([v for v in values if v is not None]) / QUANTUM_DEG
        return steps - np.rint(steps)

    figure = MplFigure(figsize=(9.0, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    # The edge of pixel k lies at k + 1/2: there the published crossing jumps.
    fraction = exact + 0.5 - np.floor(exact + 0.5)
    shift = float(np.mean(whole - exact))
    left.plot(fraction, whole - exact - shift, "o", ms=4, color=BLUE, label="published: whole pixels")
    left.plot(fraction, sub - exact, "^", ms=4, color=ORANGE, label="by area")
    left.set(xlabel="place of the true crossing within its pixel", ylabel="crossing − true [pixels]")
    left.set(xlim=(0, 1), ylim=(-0.75, 0.75))
    left.legend(loc="lower left", frameon=False, fontsize=8)
    bins = np.linspace(-0.5125, 0.5125, 42)
    data = [fractions(printed), fractions(readings), fractions(better)]
    labels = ["printed", "ours as published", "ours, sub-pixel"]
    for values, label, colour, hatch in zip(data, labels, (BLACK, BLUE, ORANGE), ("", "///", ""), strict=True):
        right.hist(values, bins=bins, histtype="step", lw=1.5, color=colour, hatch=hatch, label=label)
    right.set(xlabel="distance from a whole step of 0.035355° [steps]", ylabel="readings")
    right.legend(loc="upper right", frameon=False, fontsize=8)
    return figure


def draw_errors(hard: dict[str, JsonObject], soft: dict[str, JsonObject]) -> MplFigure:
    """Errors of all settings, both methods, both limbs."""
    figure = MplFigure(figsize=(9.0, 4.6), layout="constrained")
    axes = figure.subplots(2, 1, sharex=True)
    place = np.arange(len(ALL))
    for ax, method, unit, label in (
        (axes[0], "published", 1.0, "whole pixels:\nerror [deg]"),
        (axes[1], "sub_pixel", 1e3, "sub-pixel:\nerror [0.001 deg]"),
    ):
        for readings, limb, colour in ((hard, "hard", BLUE), (soft, "infrared", ORANGE)):
            for axis, marker, shift in (("roll", "o", -0.15), ("pitch", "^", 0.15)):
                y = [
                    math.nan if readings[k][method][axis] is None else readings[k][method][axis] - readings[k][axis]
                    for k in ALL
                ]
                face = colour if limb == "hard" else "none"
                ax.plot(place + shift, np.array(y) * unit, marker, mfc=face, mec=colour, ms=5, label=f"{axis}, {limb}")
        ax.axhline(0, color=BLACK, lw=0.7)
        ax.set_ylabel(label)
        ax.grid(axis="x", color="#e2e2e2", lw=0.6)
    names = [f"{s.roll_deg:g}, {s.pitch_deg:g}, {s.yaw_deg:g}, {s.altitude_km:g}" for s in ALL.values()]
    axes[1].set_xticks(place, names, rotation=60, ha="right", fontsize=7)
    axes[1].set_xlabel("roll, pitch, yaw [deg], altitude [km]")
    axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8)
    return figure


def draw_orbit(orbit: dict[str, dict[str, JsonObject]]) -> MplFigure:
    """Roll and pitch errors round the orbit: ellipsoid, and what the air adds."""
    oblate = orbit["oblate"]
    argument = np.array([float(a) for a in oblate])
    figure = MplFigure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True, sharey=True)
    lines: list[tuple[str, np.ndarray, Any]] = [
        ("ellipsoid", np.array([[r["sub_pixel"][a] for a in ("roll", "pitch")] for r in oblate.values()]), "o-")
    ]
    for case, style in (("oblate, air of April", "^--"), ("oblate, air of July", "s:")):
        lines.append((case.removeprefix("oblate, "), air_alone(orbit[case], oblate), style))
    for k, (ax, axis) in enumerate(zip(axes, ("roll", "pitch"), strict=True)):
        for (label, values, style), colour in zip(lines, (BLACK, BLUE, ORANGE), strict=True):
            ax.plot(np.append(argument, 360), np.append(values[:, k], values[0, k]), style, color=colour, label=label)
        ax.axhline(0, color=BLACK, lw=0.6)
        ax.set(xlabel="argument of latitude [deg]", xticks=range(0, 361, 90), title=axis)
    axes[0].set_ylabel("error [deg]")
    axes[1].legend(frameon=False, fontsize=8)
    return figure


def widest_in_field(altitude_km: float, aim_deg: float, limb_km: float = 0.0) -> float:
    """Return the largest t [deg] with pitch -t, roll t at which the limb stays within the arrays of both heads.

    Exact, from the cone ``u . n = cos rho``: in the plane of a head with level direction m the limb is at the nadir
    angle ``atan2(n . m, n_z) + acos(cos rho / sqrt((n . m)^2 + n_z^2))``. NaN where it is outside with t = 0.
    """
    cos_rho = math.cos(math.asin((RADIUS_KM + limb_km) / (RADIUS_KM + altitude_km)))
    # Heads at 135 and 315 deg in a housing turned by 90 deg.
    level = [(math.cos(math.radians(a)), math.sin(math.radians(a))) for a in (225.0, 45.0)]

    def spare(tilt_deg: float) -> float:
        n = nadir_of_roll_pitch(math.radians(tilt_deg), -math.radians(tilt_deg))
        off = []
        for m in level:
            along = float(n[0] * m[0] + n[1] * m[1])
            angle = math.atan2(along, n[2]) + math.acos(min(cos_rho / math.hypot(along, float(n[2])), 1.0))
            off.append(abs(math.degrees(angle) - aim_deg))
        return HALF_FIELD_DEG - max(off)

    return float(brentq(spare, 0.0, 12.0)) if spare(0.0) > 0.0 else math.nan


def draw_range(ends: dict[str, dict[str, JsonObject]], aim: JsonObject) -> MplFigure:
    """Curve and measured ends of the working range."""
    figure = MplFigure(figsize=(7.0, 3.8), layout="constrained")
    ax = figure.subplots()
    altitude = np.linspace(100.0, 900.0, 801)
    for aim_deg, limb_km, colour, style, label in (
        (PUBLISHED.number("nadir_angle"), 0.0, BLUE, "-", "hard limb at the array's end"),
        (aim["aim_deg"], aim["height_km"], ORANGE, "--", "half plateau at the array's end, heads turned up"),
    ):
        ax.plot(altitude, [widest_in_field(h, aim_deg, limb_km) for h in altitude], style, color=colour, label=label)
    for limb, colour, marker in (("hard", BLUE, "o"), ("infrared", ORANGE, "s")):
        named = {k: v["tilt_deg"] for k, v in ends["tilt"].items() if k.startswith(f"{limb} ")}
        x = [float(k.split(" from ")[1].removesuffix(" km")) for k in named]
        y = [math.nan if t is None else t for t in named.values()]
        ax.plot(x, y, marker, color=colour, label=f"frames, {limb} limb")
    for end in ends["altitude"].values():
        ax.plot(end["altitude_km"], 0.0, "D", color=BLACK, clip_on=False, zorder=5)
    ax.plot([], [], "D", color=BLACK, label="frames, level: ends of altitude")
    ax.set(xlabel="altitude [km]", ylabel="largest t of pitch −t, roll t [deg]", xlim=(100, 900), ylim=(0, 6.5))
    ax.legend(frameon=False, fontsize=8, loc="upper right")
    return figure
