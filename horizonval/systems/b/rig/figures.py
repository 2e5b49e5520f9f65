"""The bench's pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.systems.b.rig.film import Film
from horizonval.systems.b.rig.frames import MAGNIFIER, SPAN, read_png
from horizonval.systems.b.rig.runs import BenchRun, RigResults

CLOSE_PX = 40
ALONE, LEFT, MARK = "#4477aa", "#bbbbbb", "#aa3322"


def view(shown: JsonObject) -> Figure:
    """Draw the camera's frame, and the limb under the magnifier, without blur, and behind the lens."""
    figure = Figure(figsize=(10.0, 5.6), layout="constrained")
    left, right = _side_by_side(figure.subfigures(1, 2, width_ratios=(1.15, 1.0)))
    frame = left.subplots()
    frame.imshow(read_png(shown["dn"]) / shown["full_scale"], cmap="gray", vmin=0.0, vmax=1.0)
    column, row = shown["limb"]
    corner = (column - CLOSE_PX / 2, row - CLOSE_PX / 2)
    frame.add_patch(Rectangle(corner, CLOSE_PX, CLOSE_PX, fill=False, color="white"))
    _named(frame, "camera's frame, tilt 10 deg", "column, px", "row, px")
    upper, lower = _side_by_side(right.subfigures(2, 1))
    magnifier = upper.subplots()
    magnified = SPAN * read_png(shown["magnified"]) / 65535.0
    half = 0.5 * magnified.shape[1] / MAGNIFIER
    place = (column - half, column + half, row + half, row - half)
    shade = magnifier.imshow(magnified, cmap="gray", extent=place, vmin=0.0)
    upper.colorbar(shade, ax=magnifier, label="radiance / white")
    _named(magnifier, f"panel, magnified {MAGNIFIER:g} times", "column, px", "row, px")
    for axes, name, title in zip(
        lower.subplots(1, 2), ("bare", "blurred"), ("no blur", "behind the lens"), strict=True
    ):
        cut = _cut(SPAN * read_png(shown[name]) / 65535.0, column, row)
        left_edge, top = column - CLOSE_PX // 2 - 0.5, row - CLOSE_PX // 2 - 0.5
        axes.imshow(cut, cmap="gray", extent=(left_edge, left_edge + CLOSE_PX, top + CLOSE_PX, top), vmin=0.0)
        _named(axes, f"pixels, {title}", "column, px", "")
    return figure


def errors(whole: BenchRun, perfect: BenchRun) -> Figure:
    """Draw the published error against tilt."""
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axes = figure.subplots()
    for number, row in enumerate(whole.error_deg):
        label = f"sixteen benches, RMS {whole.rms_deg:.2f} deg" if number == 0 else None
        axes.plot(whole.tilts_deg, row, color=ALONE, linewidth=0.9, marker=".", alpha=0.8, label=label)
    label = f"perfect bench, RMS {perfect.rms_deg:.3f} deg"
    axes.plot(perfect.tilts_deg, perfect.error_deg[0], color="black", linewidth=2.0, marker="o", label=label)
    axes.set_xlabel("tilt of the stage, deg")
    axes.set_ylabel("estimate minus accelerometer, deg")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, 1.14), ncols=2)
    return figure


def film(shown: Film) -> Figure:
    """Draw the film: tilts against time, and the published error."""
    figure = Figure(figsize=(8.0, 5.0), layout="constrained")
    tilts, error = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    tilts.plot(shown.times_s, shown.reference_deg, color="black", linewidth=1.2, label="accelerometer, last 64 samples")
    tilts.plot(shown.times_s, shown.estimated_deg, "o", color=ALONE, markersize=4, label="camera")
    tilts.set_ylabel("tilt, deg")
    tilts.legend(loc="upper left")
    for resting, colour, mark, label in ((True, ALONE, "o", "at rest"), (False, LEFT, "^", "in motion")):
        chosen = shown.resting == resting
        text = f"{label}: {shown.mean_deg(resting):+.2f} ± {shown.deviation_deg(resting):.2f} deg"
        error.plot(shown.times_s[chosen], shown.error_deg[chosen], mark, color=colour, markersize=4, label=text)
    error.axhline(0.0, color="black", linewidth=0.6)
    error.set_ylabel("estimate minus\naccelerometer, deg")
    error.set_xlabel("time, s")
    error.legend(loc="upper center", bbox_to_anchor=(0.5, 1.2), ncols=2)
    return figure


def ablation(results: RigResults, published_rig_deg: float, published_model_deg: float) -> Figure:
    """Draw the RMS with one imperfection alone, and what is left as they are switched off from the top."""
    figure = Figure(figsize=(9.0, 4.8), layout="constrained")
    alone, left = figure.subplots(1, 2, sharey=True, sharex=True)
    names = ("all together", *results.order)
    place = np.arange(len(names))
    single = [results.whole.rms_deg, *(results.alone[name].rms_deg for name in results.order)]
    remaining = [results.whole.rms_deg, *(results.after[name].rms_deg for name in results.order)]
    for axes, values, colour, title in (
        (alone, single, ALONE, "with this one alone"),
        (left, remaining, LEFT, "after switching off this one too"),
    ):
        bars = axes.barh(place, values, color=colour, edgecolor="black", linewidth=0.5)
        axes.bar_label(bars, fmt="%.3f", padding=3, fontsize=8)
        axes.axvline(published_model_deg, color=MARK, linestyle=":", linewidth=1.2)
        axes.axvline(published_rig_deg, color=MARK, linestyle="--", linewidth=1.2)
        axes.set_title(title)
        axes.set_xlabel("RMS of estimate minus accelerometer, deg")
    alone.set_yticks(place, names)
    alone.invert_yaxis()
    alone.set_xlim(0.0, 1.12 * max(*single, *remaining, published_rig_deg))
    left.text(published_rig_deg, 12.6, "published rig ", color=MARK, ha="right", va="center", fontsize=8)
    left.text(published_model_deg, 13.6, "  published model", color=MARK, ha="left", va="center", fontsize=8)
    return figure


def _side_by_side(parts: Any) -> list[Any]:
    """Return subfigures as a list: their type depends on their number, which a checker of types cannot see."""
    return list(parts)


def _cut(image: FloatArray, column: int, row: int) -> FloatArray:
    top, left = row - CLOSE_PX // 2, column - CLOSE_PX // 2
    return image[top : top + CLOSE_PX, left : left + CLOSE_PX]


def _named(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=9)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(False)
