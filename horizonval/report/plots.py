"""The plots of all pages: one style, deterministic SVG for the middle of a page, and the first page's figures.

A plot is a function that draws into an empty matplotlib figure; :func:`figure` makes of it what a page shows. Colours
are those of Okabe and Ito (2008); markers, hatching and line styles keep every plot readable without them.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

from horizonval.report.load import CaseView
from horizonval.report.words import (
    BROKEN,
    CRASHED,
    FALSE_VALID,
    MISSED,
    NONE,
    VALID,
    VERDICTS,
    AngleUnit,
    VerdictMark,
    count,
    verdict_of,
)
from horizonval.scoring import limits
from horizonval.scoring.row import Row

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKERS = ("o", "s", "^", "D", "P", "v", "*")
LINE_STYLES = ("-", "--", ":", "-.")
INK, GREY, RED = "#333333", "#555555", "#b34700"
LIMIT: dict[str, Any] = {"color": RED, "lw": 1.1, "ls": "--"}
"""Style of the line at a limit."""
SMALL = 8.5
"""Size of the text of legends and titles [pt]."""
FLOOR_ARCSEC = 0.36
"""Smallest error on a logarithmic axis; smaller ones, and zeros, are drawn here."""

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
_MOST_NAMES = 45
"""Largest number of frames with names on an axis."""
_SHORT, _LONG = 2.0, 300.0
"""Ratios of the ends of a log axis below which all its ticks are labelled, and up to which those at 2 and 5 are."""

Draw = Callable[[Figure], None]

# ------------------------------------------------------------------------------------------------------------ helpers


@contextmanager
def house_style(style: Mapping[Any, Any] = _STYLE) -> Iterator[None]:
    """Apply the style of all figures, or another, regardless of a user's matplotlibrc."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(dict(style))
        yield


def svg(draw: Draw, width_in: float, height_in: float, name: str) -> str:
    """Draw a figure as SVG markup for a page, where links work; the same data give the same text.

    ``name`` must differ between the figures of a page: it makes their ids unique.
    """
    with house_style(), matplotlib.rc_context({"svg.hashsalt": name}):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def png(make: Callable[[], Figure], dpi: int) -> bytes:
    """Return a figure as the bytes of a PNG file; ``make`` makes it, in the style of all figures."""
    with house_style():
        made = make()
        for axes in made.axes:
            if axes.images:
                # Over a picture a grid would look like a part of it.
                axes.grid(visible=False, which="major")
        FigureCanvasAgg(made)
        stream = io.BytesIO()
        made.savefig(stream, format="png", dpi=dpi, metadata={"Software": None})
    return stream.getvalue()


def figure(
    title: str, text: str, draw: Draw, width_in: float, height_in: float, *, wide: bool = False, file: str = ""
) -> dict[str, Any]:
    """Return a figure as pages show it: ``title``, ``text`` below it, ``svg``, ``wide`` and ``file``.

    ``title``: unique on the page. ``wide``: over the whole width of the page. ``file``: relative path of the figure's
    file.
    """
    markup = svg(draw, width_in, height_in, file or title)
    return {"title": title, "text": text, "svg": markup, "wide": wide, "file": file}


def mark(index: int, *, hollow: bool = False) -> dict[str, Any]:
    """Return the style of an estimator's marks; ``hollow`` marks do not hide each other."""
    look = {"marker": MARKERS[index % len(MARKERS)], "zorder": 3}
    colour = COLOURS[index % len(COLOURS)]
    if hollow:
        size = 28 + 14 * (index % 3)
        return {**look, "facecolors": "none", "edgecolors": colour, "s": size, "linewidths": 1.2}
    return {**look, "color": colour, "s": 20, "edgecolors": "white", "linewidths": 0.5}


def line(index: int) -> dict[str, Any]:
    """Return the style of an estimator's line."""
    return {"color": COLOURS[index % len(COLOURS)], "ls": LINE_STYLES[index % len(LINE_STYLES)]}


def verdict_look(verdict: VerdictMark) -> dict[str, Any]:
    """Return the style of a verdict's marks; important ones are filled."""
    face = verdict.colour if verdict in (VALID, FALSE_VALID, MISSED, CRASHED, BROKEN) else "none"
    return {"marker": verdict.marker, "s": 24, "facecolors": face, "edgecolors": verdict.colour, "linewidths": 1.0}


def verdict_strip(axes: Axes, estimators: Sequence[str]) -> None:
    """Turn axes into a strip of verdicts, a line for each estimator."""
    axes.set(yticks=range(len(estimators)), yticklabels=list(estimators))
    axes.set_ylim(len(estimators) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


def plain_ticks(*axes: Axis) -> None:
    """Label log axes with plain numbers, between the powers of ten at 2 and 5; a short axis at all its ticks."""

    def between(axis: Axis, x: float, _: object) -> str:
        low, high = sorted(axis.get_view_interval())
        shown = high < _SHORT * low or (high < _LONG * low and f"{x:.3e}"[:5] in ("2.000", "5.000"))
        # 20000, as 100000 next to it, not 2e+04.
        return f"{float(f'{x:.3g}'):g}" if shown else ""

    for axis in axes:
        axis.set_major_formatter(lambda x, _: f"{x:g}")
        axis.set_minor_formatter(partial(between, axis))


def limit_line(axes: Axes, unit: AngleUnit) -> None:
    """Draw the error beyond which a claim is false, whatever its uncertainty."""
    limit = unit.of(3600 * float(np.degrees(limits.NADIR_ERROR_LIMIT_RAD)))
    axes.axhline(limit, **LIMIT, label=f"false claim beyond {limit:g}{unit.sign}")


def legend_above(figure: Figure, axes: Axes, columns: int = 2) -> None:
    """Put the legend of some axes above all of them."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=columns, fontsize=SMALL)


def empty(axes: Axes, text: str) -> None:
    """State in axes why they are empty."""
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color=GREY)
    axes.set(xticks=[], yticks=[])


# ------------------------------------------------------------------------------------------ figures of the first page


def error_by_frame(views: Sequence[CaseView], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Nadir error of every frame on a log axis; refusals as marks in a strip on top."""

    def draw(figure: Figure) -> None:
        ratios = [0.1 * len(estimators) + 0.06, 1]
        strip, axes = figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": ratios, "hspace": 0.02})
        offset = np.linspace(-0.2, 0.2, len(estimators)) if len(estimators) > 1 else np.zeros(1)
        used = set()
        for i, name in enumerate(estimators):
            x, y = [], []
            for j, view in enumerate(views):
                row = view.rows.get(name)
                verdict = verdict_of(row, broken=view.broken)
                if row is not None and row.nadir_error_arcsec is not None:
                    x.append(j + offset[i])
                    y.append(unit.of(_floored(row)))
                elif verdict is not NONE:
                    used.add(verdict)
                    strip.scatter(j, i, **verdict_look(verdict))
            axes.scatter(x, y, label=f"{name} (n = {len(y)})", **mark(i, hollow=True))
        verdict_strip(strip, [f"{name} refused" for name in estimators])
        strip.tick_params(bottom=False, labelbottom=False)
        for verdict in (v for v in VERDICTS if v in used):
            strip.scatter([], [], label=verdict.label, **verdict_look(verdict))
        if used:
            strip.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, fontsize=SMALL, borderaxespad=0.2)
        limit_line(axes, unit)
        axes.set(yscale="log", ylabel=f"nadir error [{unit.name}]", xlim=(-0.7, len(views) - 0.3))
        plain_ticks(axes.yaxis)
        if len(views) <= _MOST_NAMES:
            bands = Counter(view.case for view in views)
            names = [f"{v.case} {v.band}" if bands[v.case] > 1 else v.case for v in views]
            axes.set_xticks(range(len(views)), names, rotation=55, ha="right", fontsize=8)
            axes.tick_params(axis="x", length=0)
        else:
            axes.set_xlabel("frame, in the suite's order")
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)

    return draw


def error_by_sigma(rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Nadir error against the claimed error: honest claims scatter about the diagonal."""
    pairs = _pairs(rows, estimators, unit, lambda row: row.sigma_total_arcsec)
    # A log axis has no zero.
    exact = sum(sigma <= 0 for found in pairs.values() for sigma, _ in found)
    pairs = {name: [pair for pair in found if pair[0] > 0] for name, found in pairs.items()}
    values = [value for found in pairs.values() for pair in found for value in pair]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _scatter(axes, pairs)
        if values:
            ends = np.array([min(values) / 2, max(values) * 2])
            axes.plot(ends, ends, color=INK, lw=1, label="error = claim")
            axes.plot(ends, limits.SIGMA_LIMIT * ends, color=INK, lw=1, ls=":", label="5 times the claim")
            axes.set(xscale="log", yscale="log", xlim=ends, ylim=ends)
            plain_ticks(axes.xaxis, axes.yaxis)
            axes.legend(loc="best", fontsize=SMALL)
        else:
            empty(axes, "no claim with an uncertainty")
        if exact:
            axes.set_title(f"{count(exact, 'claim')} of zero uncertainty not drawn", fontsize=SMALL, loc="left")
        axes.set(xlabel=f"claimed nadir error, 1 sigma [{unit.name}]", ylabel=f"nadir error [{unit.name}]")

    return draw


def error_by_bound(rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Nadir error against the bound of the frame's limb: efficient methods scatter about the diagonal."""
    pairs = _pairs(rows, estimators, unit, lambda row: row.bound_arcsec)
    over = {
        name: [row.error_over_bound for row in rows if row.estimator == name and row.error_over_bound is not None]
        for name in estimators
    }

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        _scatter(axes, pairs, {name: f", median {np.median(found):.3g}" for name, found in over.items() if found})
        if any(pairs.values()):
            bounds, errors = zip(*(pair for found in pairs.values() for pair in found), strict=True)
            ends = np.array([min(bounds) / 1.5, max(bounds) * 1.5])
            for times, style in ((1.0, "-"), (10.0, "--"), (100.0, ":")):
                label = "error = bound" if times == 1.0 else f"{times:g} times the bound"
                axes.plot(ends, times * ends, color=INK, lw=1, ls=style, label=label)
            reach = min(*errors, ends[0]) / 2, max(*errors, ends[1]) * 2
            axes.set(xscale="log", yscale="log", xlim=ends, ylim=reach)
            plain_ticks(axes.xaxis, axes.yaxis)
            figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=SMALL)
        else:
            empty(axes, "no claim on a frame with a bound")
        axes.set(xlabel=f"bound of the frame [{unit.name}]", ylabel=f"nadir error [{unit.name}]")

    return draw


def roll_and_pitch(rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit) -> Draw:
    """Roll against pitch error of every claim; a centre off zero is a bias."""
    pairs = {
        name: [
            (unit.of(row.roll_error_arcsec), unit.of(row.pitch_error_arcsec))
            for row in rows
            if row.estimator == name and row.roll_error_arcsec is not None and row.pitch_error_arcsec is not None
        ]
        for name in estimators
    }
    size = [max(abs(roll), abs(pitch)) for found in pairs.values() for roll, pitch in found]

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        axes.set(xlabel=f"roll error [{unit.name}]", ylabel=f"pitch error [{unit.name}]")
        if not size:
            empty(axes, "no claim with roll and pitch")
            return
        _scatter(axes, pairs)
        axes.axhline(0, color=INK, lw=0.8)
        axes.axvline(0, color=INK, lw=0.8)
        # Twice the 75th percentile: one wild claim must not squeeze the others into a dot.
        reach = max(unit.of(1.0), min(1.1 * max(size), 2 * float(np.percentile(size, 75))))
        axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
        # Without a face the axes' lines would run through the legend.
        axes.legend(loc="best", fontsize=SMALL, frameon=True, facecolor="white", edgecolor="none", framealpha=0.9)
        if beyond := sum(value > reach for value in size):
            axes.set_title(f"{count(beyond, 'claim')} beyond the axes", fontsize=SMALL, loc="left")

    return draw


def _pairs(
    rows: Sequence[Row], estimators: Sequence[str], unit: AngleUnit, x_of: Callable[[Row], float | None]
) -> dict[str, list[tuple[float, float]]]:
    """Return a value in arcsec and the nadir error of every claim with both, by estimator."""
    return {
        name: [
            (unit.of(x), unit.of(_floored(row)))
            for row in rows
            if row.estimator == name and (x := x_of(row)) is not None and row.nadir_error_arcsec is not None
        ]
        for name in estimators
    }


def _floored(row: Row) -> float:
    return max(row.nadir_error_arcsec or 0.0, FLOOR_ARCSEC)


def _scatter(
    axes: Axes, pairs: Mapping[str, Sequence[tuple[float, float]]], more: Mapping[str, str] | None = None
) -> None:
    for i, (name, found) in enumerate(pairs.items()):
        if found:
            label = f"{name} (n = {len(found)}{(more or {}).get(name, '')})"
            axes.scatter(*zip(*found, strict=True), label=label, **mark(i, hollow=True))
