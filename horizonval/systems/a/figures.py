"""Pictures of the altitude-free sensor: the set-ups, the convergence, the trends, Newton beside the closed form."""

from __future__ import annotations

import base64
from collections.abc import Mapping

import cv2
import numpy as np
from matplotlib.figure import Figure as MplFigure

from horizonval.core.json_types import JsonObject
from horizonval.systems.a.bank import ALTITUDES_KM, FIELDS_DEG
from horizonval.systems.a.rows import Bank, median_nadir

UNKNOWNS = (("roll", "#0072b2", "o"), ("pitch", "#d55e00", "s"), ("angular radius", "#009e73", "^"))
STARTS = {"zero": "start: roll = pitch = 0, rho = 45 deg", "three": "start: the cone through three pixels"}
FIELD_STYLES = (("#0072b2", "o", "-"), ("#d55e00", "s", "--"), ("#009e73", "^", ":"))
ROUNDING_RAD = 1e-16


def draw_set_ups(set_ups: Mapping[str, JsonObject]) -> MplFigure:
    """The rendered set-ups with the pixels that Canny marked."""
    figure = MplFigure(figsize=(10.5, 6.6), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    for axes, (name, result) in zip(panels, set_ups.items(), strict=False):
        data = np.frombuffer(base64.b64decode(result["picture"]), np.uint8)
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))
        axes.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        points = np.array(result["clean"]["pixels"])
        size = 5.0 if len(image) < 100 else 1.0
        axes.plot(points[:, 0], points[:, 1], "s", color="#ff7f0e", ms=size, mew=0)
        axes.set_title(f"{name}: {len(points)} edge pixels", fontsize=9)
        axes.set(xlabel="column [px]", ylabel="row [px]")
    for axes in panels[len(set_ups) :]:
        axes.axis("off")
    return figure


def draw_convergence(result: JsonObject) -> MplFigure:
    """Summed error of the equations, and each unknown's distance from its final value, against the step."""
    figure = MplFigure(figsize=(10.5, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    for name, line, marker in (("zero", "-", "o"), ("three", "--", "s")):
        summed = result["clean"]["iterates"][name]["summed"]
        left.semilogy(range(len(summed)), summed, line, marker=marker, color="#333333", ms=4, label=STARTS[name])
    left.set(xlabel="step", ylabel="sum of |F| over all pixels")
    left.set_ylim(top=2e3)
    left.legend(fontsize=8, loc="upper right")
    for axes, name in ((middle, "zero"), (right, "three")):
        steps = np.array(result["clean"]["iterates"][name]["steps"])
        off = np.maximum(np.abs(steps[:-1] - steps[-1]), ROUNDING_RAD)
        for k, (unknown, colour, marker) in enumerate(UNKNOWNS):
            axes.semilogy(range(len(off)), off[:, k], marker=marker, color=colour, ms=5, label=unknown)
        axes.axhline(1e-6, color="#888888", lw=0.9, ls=":")
        axes.annotate("1e-6 rad", (5.3, 1e-6), (2, 3), textcoords="offset points", fontsize=8, color="#555555")
        axes.set(xlabel="step", ylabel="distance from the solution [rad]", ylim=(1e-17, 30))
        axes.set_title(STARTS[name], fontsize=9)
        axes.legend(fontsize=8, loc="lower left")
    for axes in (left, middle, right):
        axes.set_xticks(range(8))
        axes.grid(alpha=0.3)
    return figure


def draw_errors(bank: Bank) -> MplFigure:
    """Median nadir error against the number of pixels, one panel per altitude, a line per field."""
    figure = MplFigure(figsize=(10.5, 3.9), layout="constrained")
    panels = figure.subplots(1, len(ALTITUDES_KM), sharey=True)
    whole, limb = (median_nadir(bank, method) for method in ("whole, newton", "limb, newton"))
    for axes, altitude in zip(panels, ALTITUDES_KM, strict=True):
        for fov, (colour, marker, line) in zip(FIELDS_DEG, FIELD_STYLES, strict=True):
            for cell, filled, points in ((whole, "none", "whole pixels"), (limb, colour, "sub-pixel")):
                at = sorted((n, value) for (a, f, n), value in cell.items() if (a, f) == (altitude, fov))
                axes.loglog(
                    *np.array(at).reshape(-1, 2).T,
                    line,
                    marker=marker,
                    color=colour,
                    mfc=filled,
                    ms=5,
                    lw=1.2,
                    label=f"{fov:g} deg, {points}",
                )
        axes.set_title(f"{altitude:g} km", fontsize=10)
        axes.set(xlabel="pixels a side", xticks=(50, 100, 200, 400, 1024))
        axes.set_xticklabels(["50", "100", "200", "400", "1024"], fontsize=8)
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("median nadir error [arcsec]")
    figure.legend(*panels[-1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure


def draw_solvers(comparisons: Mapping[str, JsonObject]) -> MplFigure:
    """The nadir's error and bias of Newton and closed form against the arc, one panel per angular radius."""
    figure = MplFigure(figsize=(10.5, 4.0), layout="constrained")
    radii = (31.0, 62.7, 80.0, 88.0)
    panels = figure.subplots(1, len(radii), sharey=True)
    for axes, rho in zip(panels, radii, strict=True):
        shown = sorted(
            (one for one in comparisons.values() if (one["rho_deg"], one["noise_px"]) == (rho, 0.1)),
            key=lambda one: float(one["arc_deg"]),
        )
        arc = [one["arc_deg"] for one in shown]
        for name, label, colour, marker, line in (
            ("newton_rms", "Newton (= orthogonal plane), rms", "#0072b2", "o", "-"),
            ("closed_rms", "closed form, rms", "#d55e00", "s", "--"),
        ):
            axes.loglog(arc, [one[name] for one in shown], line, marker=marker, color=colour, ms=5, label=label)
        short = [one for one in shown if one["arc_deg"] < 360]
        predicted = [one["predicted_closed_bias"] for one in short]
        axes.loglog(arc[: len(short)], predicted, ":", color="#555555", label="closed form, bias foretold")
        axes.set_title(f"rho = {rho:g} deg", fontsize=10)
        axes.set(xlabel="arc in view [deg]", xticks=arc, ylim=(0.3, 1e4))
        axes.set_xticklabels([f"{a:g}" for a in arc])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("nadir error [arcsec]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=8)
    return figure
