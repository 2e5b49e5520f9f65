"""The figures of a report: deterministic SVG, one ``data:`` URI each."""

from __future__ import annotations

import base64
import io
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from horizonval.report.angle_unit import AngleUnit
from horizonval.report.formatting import count
from horizonval.report.load import CaseView
from horizonval.report.verdict import BROKEN, CRASHED, FAIR, MISSED, NONE, OTHER, REFUSED, verdict_of
from horizonval.scoring import limits
from horizonval.scoring.row import Row

ESTIMATOR_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
ESTIMATOR_MARKERS = ("o", "s", "^", "D", "P", "v", "*")

_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "horizonval",
    # Text stays text: smaller, and selectable.
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e2e2e2",
    "grid.linewidth": 0.6,
    "axes.axisbelow": True,
    "legend.frameon": False,
    "path.simplify": False,
}
FLOOR_ARCSEC = 0.36
"""Smaller errors, exact zeros among them, are drawn here: a log axis has no zero."""
_MOST_NAMES = 45

Draw = Callable[[Figure], None]


@contextmanager
def house_style() -> Iterator[None]:
    """Set the look of all figures; a user's own matplotlibrc does not show."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        yield


def figure_uri(draw: Draw, width_in: float, height_in: float) -> str:
    """Draw a figure and return it as ``data:`` URI; the same data give the same bytes."""
    with house_style():
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.BytesIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return "data:image/svg+xml;base64," + base64.b64encode(stream.getvalue()).decode("ascii")


def error_by_frame(views: Sequence[CaseView], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Nadir error of every frame on a log axis; refusals as marks in a strip on top."""

    def draw(figure: Figure) -> None:
        strip, axes = figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": [0.1 * len(estimators) + 0.06, 1], "hspace": 0.02}
        )
        offset = np.linspace(-0.2, 0.2, len(estimators)) if len(estimators) > 1 else np.zeros(1)
        used = set()
        for i, name in enumerate(estimators):
            x, y = [], []
            for j, view in enumerate(views):
                row = view.rows.get(name)
                verdict = verdict_of(row, broken=view.broken)
                if row is not None and row.nadir_error_arcsec is not None:
                    x.append(j + offset[i])
                    y.append(unit.of(max(row.nadir_error_arcsec, FLOOR_ARCSEC)))
                elif verdict is not NONE:
                    used.add(verdict)
                    hollow = "none" if verdict in (REFUSED, OTHER, FAIR) else verdict.colour
                    strip.scatter(
                        j, i, marker=verdict.marker, s=26, facecolors=hollow, edgecolors=verdict.colour, lw=1.1
                    )
            axes.scatter(x, y, label=f"{name} (n = {len(y)})", **_mark(i))
        strip.set(yticks=range(len(estimators)), yticklabels=[f"{name} refused" for name in estimators])
        strip.set_ylim(len(estimators) - 0.4, -0.6)
        strip.tick_params(bottom=False, labelbottom=False)
        strip.grid(axis="y", visible=False)
        for verdict in (v for v in (CRASHED, MISSED, OTHER, FAIR, REFUSED, BROKEN) if v in used):
            hollow = "none" if verdict in (REFUSED, OTHER, FAIR) else verdict.colour
            strip.scatter(
                [], [], marker=verdict.marker, s=26, facecolors=hollow, edgecolors=verdict.colour, label=verdict.label
            )
        if used:
            strip.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, fontsize=8.5, borderaxespad=0.2)
        _limit_line(axes, unit)
        axes.set_yscale("log")
        axes.set_ylabel(f"nadir error [{unit.name}]")
        axes.set_xlim(-0.7, len(views) - 0.3)
        if len(views) <= _MOST_NAMES:
            axes.set_xticks(range(len(views)), [_label(v, views) for v in views], rotation=55, ha="right", fontsize=8)
            axes.tick_params(axis="x", length=0)
        else:
            axes.set_xlabel("frame, in the suite's order")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)

    return draw


def error_by_sigma(rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Nadir error against the error each estimator claims: honest claims scatter about the diagonal."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        everything, exact = [], 0
        for i, name in enumerate(estimators):
            pairs = [
                (unit.of(sigma), unit.of(max(row.nadir_error_arcsec, FLOOR_ARCSEC)))
                for row in rows
                if row.estimator == name
                and (sigma := row.sigma_total_arcsec) is not None
                and row.nadir_error_arcsec is not None
            ]
            exact += sum(sigma <= 0 for sigma, _ in pairs)
            pairs = [pair for pair in pairs if pair[0] > 0]
            everything += [value for pair in pairs for value in pair]
            if pairs:
                axes.scatter(*zip(*pairs, strict=True), label=f"{name} (n = {len(pairs)})", **_mark(i))
        if everything:
            ends = np.array([min(everything) / 2, max(everything) * 2])
            axes.plot(ends, ends, color="#333333", lw=1, label="error = claim")
            axes.plot(ends, limits.SIGMA_LIMIT * ends, color="#333333", lw=1, ls=":", label="5 times the claim")
            axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
            axes.legend(loc="best", fontsize=8.5)
        else:
            _empty(axes, "no claim with an uncertainty")
        if exact:
            axes.set_title(f"{count(exact, 'claim')} of zero uncertainty not drawn", fontsize=8.5, loc="left")
        axes.set(xlabel=f"claimed nadir error, 1 sigma [{unit.name}]", ylabel=f"nadir error [{unit.name}]")

    return draw


def error_by_bound(rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Nadir error against what the limb of the frame allows: about the diagonal by a method that uses all of it."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        bounds: list[float] = []
        errors: list[float] = []
        for i, name in enumerate(estimators):
            pairs = [
                (unit.of(row.bound_arcsec), unit.of(max(row.nadir_error_arcsec, FLOOR_ARCSEC)), row.error_over_bound)
                for row in rows
                if row.estimator == name
                and row.bound_arcsec is not None
                and row.nadir_error_arcsec is not None
                and row.error_over_bound is not None
            ]
            if pairs:
                x, y, over = zip(*pairs, strict=True)
                middle = float(np.median(over))
                axes.scatter(x, y, label=f"{name} (n = {len(pairs)}, median {middle:.3g})", **_mark(i))
                bounds += x
                errors += y
        if not bounds:
            _empty(axes, "no claim on a frame with a bound")
        else:
            ends = np.array([min(bounds) / 1.5, max(bounds) * 1.5])
            for times, style in ((1.0, "-"), (10.0, "--"), (100.0, ":")):
                label = "error = bound" if times == 1.0 else f"{times:g} times the bound"
                axes.plot(ends, times * ends, color="#333333", lw=1, ls=style, label=label)
            reach = min(*errors, ends[0]) / 2, max(*errors, ends[1]) * 2
            axes.set(xscale="log", yscale="log", xlim=ends, ylim=reach)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8.5)
        axes.set(xlabel=f"bound of the frame [{unit.name}]", ylabel=f"nadir error [{unit.name}]")

    return draw


def roll_and_pitch(rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Roll against pitch error of every claim; a centre off zero is a bias."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        pairs = {
            name: [
                (unit.of(row.roll_error_arcsec), unit.of(row.pitch_error_arcsec))
                for row in rows
                if row.estimator == name and row.roll_error_arcsec is not None and row.pitch_error_arcsec is not None
            ]
            for name in estimators
        }
        size = [max(abs(roll), abs(pitch)) for found in pairs.values() for roll, pitch in found]
        if not size:
            _empty(axes, "no claim with roll and pitch")
        # Twice the 75th percentile: one wild claim must not squeeze the others into a dot.
        reach = max(unit.of(1.0), min(1.1 * max(size, default=1), 2 * float(np.percentile(size, 75)) if size else 1))
        beyond = sum(value > reach for value in size)
        for i, name in enumerate(estimators):
            if pairs[name]:
                axes.scatter(*zip(*pairs[name], strict=True), label=f"{name} (n = {len(pairs[name])})", **_mark(i))
        if size:
            axes.axhline(0, color="#333333", lw=0.8)
            axes.axvline(0, color="#333333", lw=0.8)
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        axes.set(xlabel=f"roll error [{unit.name}]", ylabel=f"pitch error [{unit.name}]")
        if size:
            # The axes' own lines run through it otherwise.
            axes.legend(loc="best", fontsize=8.5, frameon=True, facecolor="white", edgecolor="none", framealpha=0.9)
        if beyond:
            axes.set_title(f"{count(beyond, 'claim')} beyond the axes", fontsize=8.5, loc="left")

    return draw


def _mark(index: int) -> dict[str, Any]:
    # Hollow: what one estimator did must not hide what another did with the same frame.
    return {
        "marker": ESTIMATOR_MARKERS[index % len(ESTIMATOR_MARKERS)],
        "facecolors": "none",
        "edgecolors": ESTIMATOR_COLOURS[index % len(ESTIMATOR_COLOURS)],
        "s": 28 + 14 * (index % 3),
        "linewidths": 1.2,
        "zorder": 3,
    }


def _limit_line(axes: Axes, unit: AngleUnit) -> None:
    limit_arcsec = 3600 * math.degrees(limits.NADIR_ERROR_LIMIT_RAD)
    label = f"false claim beyond {unit.of(limit_arcsec):g}{unit.sign}"
    axes.axhline(unit.of(limit_arcsec), color="#b34700", lw=1.2, ls="--", label=label)


def _empty(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#555555")
    axes.set(xticks=[], yticks=[])


def _label(view: CaseView, views: Sequence[CaseView]) -> str:
    several = sum(other.case == view.case for other in views) > 1
    return f"{view.case} {view.band}" if several else view.case
