"""Figures of the two cameras: maps over the attitudes, the orbit, the Sun in the frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure as MplFigure
from matplotlib.patches import Patch, Rectangle
from matplotlib.patheffects import withStroke

from horizonval.systems.b.pair.applicability import LIMIT_DEG, REGION_DEG, Map
from horizonval.systems.b.pair.orbit import COASTS, INFRARED, LINEAR, VISIBLE, Lap, errors_deg
from horizonval.systems.b.pair.sun import LIMB_ZENITH_DEG, ORDINARY, SHOWN_ZENITH_DEG, SunOutcome
from horizonval.systems.published import page_text

TEXT = page_text("B")
_NORM = LogNorm(0.003, 10.0, clip=True)
_COLOURS = "viridis_r"
_SENSORS = {VISIBLE: ("#d55e00", "o"), COASTS: ("#e6a117", "^"), INFRARED: ("#0072b2", "s"), LINEAR: ("#111111", "x")}


def maps(panels: Mapping[str, Map]) -> MplFigure:
    """Error over the attitudes, one panel per experiment; hatched where there is no answer, a line around 1 deg."""
    figure = MplFigure(figsize=(4.2 * len(panels) + 0.9, 5.0), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for panel, (title, one) in zip(axes, panels.items(), strict=True):
        _map(panel, one)
        panel.set_title(title, fontsize=10, pad=8)
    axes[0].set_ylabel("pitch [deg]")
    bar = figure.colorbar(ScalarMappable(_NORM, _COLOURS), ax=list(axes), label="error of the vertical [deg]")
    bar.set_ticks([0.01, 0.1, 1.0, 10.0], labels=["0.01", "0.1", "1", "10"])
    keys = [
        Patch(facecolor="white", edgecolor="#777777", hatch="////", label="no answer"),
        Patch(facecolor="none", edgecolor="#d55e00", lw=1.8, label="error above 1 deg"),
        Patch(facecolor="none", edgecolor="black", ls="--", lw=1.4, label="published region"),
    ]
    figure.legend(handles=keys, loc="outside lower center", ncols=3)
    return figure


def _map(axes: Axes, one: Map) -> None:
    axis = np.unique(one.pitch_deg[np.abs(one.pitch_deg) == np.abs(one.pitch_deg).max()])
    step = float(np.diff(np.unique(one.yaw_deg[one.pitch_deg == axis[-1]])).min())
    half = step / 2
    mappable = ScalarMappable(_NORM, _COLOURS)
    errors = one.error_deg()
    # the finer points lie on the corners of the coarse cells: smaller, on top
    on_grid = np.isclose(np.mod(one.pitch_deg + one.pitch_deg.max(), step), 0.0)
    for row in np.argsort(~on_grid, kind="stable"):
        size = half if on_grid[row] else half * 0.36
        error, left, low = errors[row], one.yaw_deg[row] - size, one.pitch_deg[row] - size
        if np.isnan(error):
            axes.add_patch(Rectangle((left, low), 2 * size, 2 * size, fc="white", ec="#999999", hatch="////", lw=0))
            continue
        wrong = error >= LIMIT_DEG
        edge = "#d55e00" if wrong else "white"
        colour = mappable.to_rgba(np.array(error))
        axes.add_patch(
            Rectangle((left, low), 2 * size, 2 * size, fc=colour, ec=edge, lw=1.8 if wrong else 0.4, zorder=3 + wrong)
        )
        if on_grid[row]:
            dark = float(np.dot(colour[:3], (0.3, 0.59, 0.11))) < 0.5
            text = f"{error:.2f}" if error < 10 else f"{error:.0f}"
            axes.text(
                one.yaw_deg[row],
                one.pitch_deg[row],
                text,
                ha="center",
                va="center",
                fontsize=6.5,
                color="white" if dark else "black",
                zorder=8,
                path_effects=[withStroke(linewidth=2.0, foreground=colour)],
            )
    box = REGION_DEG
    axes.add_patch(Rectangle((-box, -box), 2 * box, 2 * box, fill=False, ls="--", lw=1.4, ec="black", zorder=7))
    largest = float(np.abs(one.pitch_deg).max()) + half
    ticks = np.arange(-40, 41, 20)
    axes.set(xticks=ticks, yticks=ticks, aspect="equal", xlabel="yaw [deg]")
    axes.set(xlim=(-largest, largest), ylim=(-largest, largest))
    axes.grid(False)


def orbit(lap: Lap) -> MplFigure:
    """Errors round the orbit; the Earth's shadow is grey, marks at the lower edge are refusals."""
    figure = MplFigure(figsize=(9.2, 4.6), layout="constrained")
    axes = figure.subplots()
    argument = np.array(lap.argument_deg)
    half = float(argument[1] - argument[0]) / 2
    for u, lit in zip(argument, lap.lit, strict=True):
        if lit < 0.5:
            axes.axvspan(u - half, u + half, color="#cccccc", lw=0, zorder=0)
    lowest = 0.006
    for k, (sensor, found) in enumerate(lap.by_sensor.items()):
        colour, mark = _SENSORS[sensor]
        error = errors_deg(found)
        axes.plot(argument, np.maximum(error, lowest), mark, color=colour, ms=6, mfc="none", mew=1.5, label=sensor)
        missing = argument[np.isnan(error)]
        axes.plot(missing, np.full(len(missing), 0.0024 * 1.28**k), mark, color=colour, ms=4, alpha=0.8)
    axes.axhline(lowest * 0.93, color="#888888", lw=0.7)
    axes.text(2, 0.0021, "no answer", fontsize=8, va="bottom", color="#555555", backgroundcolor="white")
    axes.axhline(LIMIT_DEG, color="#555555", lw=0.9, ls="--")
    axes.set_yscale("log")
    axes.set(xlim=(-half, 360 - half), ylim=(0.0018, 120), xticks=np.arange(0, 360, 45))
    axes.set_yticks([0.01, 0.1, 1, 10, 100], labels=["0.01", "0.1", "1", "10", "100"])
    axes.set_xlabel("argument of latitude [deg] (grey: in the Earth's shadow)")
    axes.set_ylabel("error of the vertical [deg]")
    figure.legend(loc="outside lower center", ncols=4)
    return figure


def sun(found: SunOutcome) -> MplFigure:
    """Plot the forward camera's Sun at some heights, by lens and exposure, and the method's results.

    The last rows are the ordinary lens without the Sun's own light.
    """
    rows = [(lens, exposure, one.lit) for (lens, exposure), one in found.shown.items()]
    rows += [
        (lens, TEXT.phrase("without_light", exposure=exposure), one.dark)
        for (lens, exposure), one in found.shown.items()
        if lens == ORDINARY
    ]
    figure = MplFigure(figsize=(2.35 * len(SHOWN_ZENITH_DEG), 2.75 * len(rows)), layout="constrained")
    axes = figure.subplots(len(rows), len(SHOWN_ZENITH_DEG), squeeze=False)
    for row, (lens, light, views) in zip(axes, rows, strict=True):
        for panel, zenith, one in zip(row, SHOWN_ZENITH_DEG, views, strict=True):
            panel.imshow(np.sqrt(np.array(one["pictures"]["forward"]) / 255.0), cmap="gray", vmin=0, vmax=1)
            error = one["error_deg"].get("SIGHT")
            error_text = f"{error:.2f} deg" if error is not None else f"no answer: {one['status'].replace('_', ' ')}"
            panel.set_title(f"Sun {round(LIMB_ZENITH_DEG - zenith)} deg over the limb\n{error_text}", fontsize=8)
            panel.set(xticks=[], yticks=[])
        row[0].set_ylabel(f"{lens},\n{light}")
    return figure
