"""Figures of campaigns: many frames along an orbit, over a grid, or round the Sun.

Every mark of a frame links to that frame. Colours and marks of verdicts are those of the report; a strip's glyphs, the
hatching of thin cells and the line styles keep every figure readable in grey.
"""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.report.figures.plots import ESTIMATOR_COLOURS, ESTIMATOR_MARKERS, FLOOR_ARCSEC, Draw, house_style
from horizonval.report.verdict import FALSE_VALID, MISSED, VALID, VerdictMark, verdict_of
from horizonval.scoring import limits
from horizonval.scoring.row import Row

Link = Callable[[Row], str | None]

THIN_CELL = 3
"""A cell of a map with fewer frames than this is hatched: its number is no statistics."""
LINE_STYLES = ("-", "--", ":", "-.")
MOST_WORDY_CELLS = 60
"""Maps of more cells have no numbers in them."""
TAIL = 20
"""So many of the largest errors of an estimator are marked in the figure of its tail."""
LIMIT_DEG = math.degrees(limits.NADIR_ERROR_LIMIT_RAD)
PAIR_COLOURS = {"roll": "#0072b2", "pitch": "#d55e00"}


@dataclass(frozen=True)
class Span:
    """A stretch of time with a name: an eclipse, the Sun in the frame."""

    label: str
    start: float
    end: float


SPAN_LOOKS: dict[str, dict[str, Any]] = {
    "eclipse": {"color": "#555555", "alpha": 0.25},
    "Sun in the frame": {"color": "#e69f00", "alpha": 0.35},
    "terminator in view": {"facecolor": "none", "edgecolor": "#0072b2", "hatch": "////", "alpha": 0.75, "lw": 0},
}
LIMIT_LOOK: dict[str, Any] = {"color": "#b34700", "lw": 1.1, "ls": "--"}
SIGMA_LOOK: dict[str, Any] = {"marker": "_", "s": 60, "color": "#333333", "lw": 1.3}
STRIP_IN, PANEL_IN, EMPTY_IN = 0.2, 1.05, 0.25
LEAST_SHOWN_DEG = 1e-3
"""Smaller errors are drawn here in timelines: 4 arcsec, far below what any of these cameras can do."""
OTHER_SPAN: dict[str, Any] = {"color": "#999999", "alpha": 0.2}


def inline_svg(draw: Draw, width_in: float, height_in: float, salt: str) -> str:
    """Draw a figure as SVG markup for the middle of a page, where links work; the same data give the same text.

    ``salt`` must differ between the figures of a page: it keeps their ids apart.
    """
    with house_style(), matplotlib.rc_context({"svg.hashsalt": salt}):
        figure = Figure(figsize=(width_in, height_in), layout="constrained")
        FigureCanvasSVG(figure)
        draw(figure)
        stream = io.StringIO()
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    return text[text.index("<svg") :]


def timeline(
    rows: Sequence[Row], estimators: Sequence[str], minutes: Mapping[str, float], spans: Sequence[Span], link: Link
) -> Draw:
    """Outcome strip and error with three claimed sigma of every estimator along the time of a flight.

    Parameters
    ----------
    rows : sequence of Row
        Of one camera and band.
    minutes : mapping
        Time of every case [min].
    spans : sequence of Span
        Drawn behind everything.
    link : callable
        The address of a row's frame.
    """

    def draw(figure: Figure) -> None:
        heights = [STRIP_IN, *(PANEL_IN if answered(rows, name) else EMPTY_IN for name in estimators)]
        heights[0] *= len(estimators)
        strip, *panels = figure.subplots(1 + len(estimators), 1, sharex=True, gridspec_kw={"height_ratios": heights})
        for axes in (strip, *panels):
            _shade(axes, spans)
        ends = _error_ends(rows)
        for i, name in enumerate(estimators):
            rows_of_estimator = sorted(
                (row for row in rows if row.estimator == name), key=lambda row: minutes[row.case]
            )
            _strip_line(strip, [minutes[row.case] for row in rows_of_estimator], rows_of_estimator, i, link)
            claims = [row for row in rows_of_estimator if row.nadir_error_arcsec is not None]
            _error_panel(panels[i], [minutes[row.case] for row in claims], claims, ends, i, link)
            panels[i].set_title(
                f"{name}, {len(claims)} claims of {len(rows_of_estimator)} frames", loc="left", fontsize=9.5
            )
        _strip_names(strip, estimators)
        panels[-1].set_xlabel("time from the first frame [min]")
        handles = _verdict_handles(strip, rows) + _span_handles(strip, spans) + _error_handles(panels[0])
        figure.legend(handles=handles, loc="outside upper left", ncols=4, fontsize=8.5)

    return draw


def _shade(axes: Axes, spans: Sequence[Span]) -> None:
    for span in spans:
        axes.axvspan(span.start, span.end, zorder=0, **{"lw": 0, **SPAN_LOOKS.get(span.label, OTHER_SPAN)})


def _strip_line(axes: Axes, x: Sequence[float] | FloatArray, rows: Sequence[Row], line: int, link: Link) -> None:
    by_verdict: dict[VerdictMark, list[int]] = {}
    for k, row in enumerate(rows):
        by_verdict.setdefault(verdict_of(row), []).append(k)
    for verdict, which in by_verdict.items():
        marks = axes.scatter(
            [x[k] for k in which], [line] * len(which), marker=verdict.marker, s=24, zorder=3, **_fill(verdict)
        )
        marks.set_urls([link(rows[k]) for k in which])


def _strip_names(axes: Axes, estimators: Sequence[str]) -> None:
    axes.set(yticks=range(len(estimators)), yticklabels=list(estimators))
    axes.set_ylim(len(estimators) - 0.4, -0.6)
    axes.grid(axis="y", visible=False)


def curves_height_in(estimators: Sequence[str]) -> float:
    """Return a height at which curves over an axis are drawn well."""
    return 5.2 + (0.25 + STRIP_IN) * len(estimators)


def _fill(verdict: VerdictMark) -> dict[str, Any]:
    solid = verdict in (VALID, FALSE_VALID, MISSED)
    return {"facecolors": verdict.colour if solid else "none", "edgecolors": verdict.colour, "linewidths": 1.0}


def _error_panel(
    axes: Axes, x: Sequence[float], claims: Sequence[Row], ends: tuple[float, float], index: int, link: Link
) -> None:
    if not claims:
        axes.text(0.5, 0.5, "no answer", transform=axes.transAxes, ha="center", va="center", color="#555555")
        axes.set(yticks=[])
        return
    axes.set(yscale="log", ylim=ends, ylabel="error [deg]")
    _plain_ticks(axes.yaxis)
    axes.axhline(LIMIT_DEG, **LIMIT_LOOK)
    sigma = [max(3.0 * _claimed_deg(row), ends[0]) for row in claims]
    axes.scatter(x, sigma, **SIGMA_LOOK)
    marks = axes.scatter(x, [_error_deg(row) for row in claims], **_mark(index))
    marks.set_urls([link(row) for row in claims])


def _error_ends(rows: Sequence[Row]) -> tuple[float, float]:
    """Return the ends of the axis that all panels share, so that they can be compared."""
    errors = [_error_deg(row) for row in rows if row.nadir_error_arcsec is not None]
    return max(min([*errors, LIMIT_DEG]) / 2, LEAST_SHOWN_DEG), 2 * max([*errors, LIMIT_DEG])


def _claimed_deg(row: Row) -> float:
    return (row.sigma_total_arcsec or 0.0) / 3600.0


def _error_deg(row: Row) -> float:
    return max((row.nadir_error_arcsec or 0.0) / 3600.0, LEAST_SHOWN_DEG)


def _shown_arcsec(row: Row) -> float:
    return max(row.nadir_error_arcsec or 0.0, FLOOR_ARCSEC)


def answered(rows: Sequence[Row], estimator: str) -> bool:
    """Whether an estimator made any claim."""
    return any(row.estimator == estimator and row.nadir_error_arcsec is not None for row in rows)


def timeline_height_in(rows: Sequence[Row], estimators: Sequence[str]) -> float:
    """Return a height at which a timeline is drawn well."""
    panels = sum(PANEL_IN if answered(rows, name) else EMPTY_IN for name in estimators)
    return 1.3 + STRIP_IN * len(estimators) + panels + 0.3 * len(estimators)


def _error_handles(axes: Axes) -> list[Any]:
    return [
        axes.scatter([], [], **(_mark(0) | {"color": "#555555"}), label="error (mark of the method)"),
        axes.scatter([], [], **SIGMA_LOOK, label="3 sigma claimed"),
        axes.plot([], [], **LIMIT_LOOK, label=f"false claim beyond {LIMIT_DEG:g}°")[0],
    ]


def _verdict_handles(axes: Axes, rows: Sequence[Row]) -> list[Any]:
    shown = dict.fromkeys(verdict_of(row) for row in rows)
    return [axes.scatter([], [], marker=v.marker, s=24, label=v.label, **_fill(v)) for v in shown]


def _span_handles(axes: Axes, spans: Sequence[Span]) -> list[Any]:
    from matplotlib.patches import Patch

    names = dict.fromkeys(span.label for span in spans)
    return [Patch(label=name, **SPAN_LOOKS.get(name, OTHER_SPAN)) for name in names]


def heat_map(
    rows: Sequence[Row], x_of: Mapping[str, float], y_of: Mapping[str, float], labels: tuple[str, str]
) -> Draw:
    """Median nadir error over a grid of two axes, on a log colour scale; what is not there is said in the cell.

    Cells without an answer are empty and crossed, cells with fewer than :data:`THIN_CELL` frames hatched, and the
    outline is where the error passes the limit of a false claim.

    Parameters
    ----------
    rows : sequence of Row
        Of one estimator, camera and band.
    x_of, y_of : mapping
        Axis values of every case.
    labels : tuple of str
    """

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        xs = np.array(sorted({x_of[row.case] for row in rows}))
        ys = np.array(sorted({y_of[row.case] for row in rows}))
        median, answers, frames, false = _cells(rows, x_of, y_of, xs, ys)
        known = median[np.isfinite(median)]
        if known.size:
            low = min(float(known.min()), LIMIT_DEG / 10)
            norm = LogNorm(low, max(float(known.max()), LIMIT_DEG))
            mesh = axes.pcolormesh(_edges(xs), _edges(ys), np.ma.masked_invalid(median), cmap="viridis_r", norm=norm)
            bar = figure.colorbar(mesh, ax=axes)
            bar.set_label("median nadir error [deg]")
            bar.ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            _plain_ticks(bar.ax.yaxis)
            bar.ax.axhline(LIMIT_DEG, color="#b34700", lw=1.5)
        for i, j in np.argwhere(np.ones_like(median, dtype=bool)):
            if frames[i, j] == 0:
                continue
            if frames[i, j] < THIN_CELL:
                _hatch(axes, _edges(xs)[j : j + 2], _edges(ys)[i : i + 2])
            if answers[i, j] == 0:
                axes.text(xs[j], ys[i], "×", ha="center", va="center", color="#333333", fontsize=9)
            elif median.size <= MOST_WORDY_CELLS:
                _cell_text(axes, xs[j], ys[i], (median[i, j], answers[i, j], frames[i, j], false[i, j]))
        if min(median.shape) > 1 and np.isfinite(median).any():
            beyond = np.where(np.isfinite(median), median, np.inf) > LIMIT_DEG
            _outline(axes, beyond, _edges(xs), _edges(ys))
        axes.set(xlabel=labels[0], ylabel=labels[1])
        axes.grid(visible=False)
        least = int(frames[frames > 0].min()) if frames.any() else 0
        words = ["× no answer", "2/3 answered" if median.size <= MOST_WORDY_CELLS else "", "✖ false claims"]
        thin = f"\nhatched: fewer than {THIN_CELL} frames" if least < THIN_CELL else ""
        head = ", ".join([f"n = {int(frames.sum())}", *filter(None, words)])
        axes.set_title(head + thin, loc="left", fontsize=8.5)

    return draw


def _cells(
    rows: Sequence[Row], x_of: Mapping[str, float], y_of: Mapping[str, float], xs: FloatArray, ys: FloatArray
) -> tuple[FloatArray, NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    found: dict[tuple[int, int], list[float]] = {}
    frames = np.zeros((len(ys), len(xs)), dtype=np.int64)
    false = np.zeros_like(frames)
    for row in rows:
        at = int(np.searchsorted(ys, y_of[row.case])), int(np.searchsorted(xs, x_of[row.case]))
        frames[at] += 1
        false[at] += row.false_valid
        if row.nadir_error_arcsec is not None:
            found.setdefault(at, []).append(_shown_arcsec(row) / 3600.0)
    median = np.full(frames.shape, np.nan)
    answers = np.zeros_like(frames)
    for at, errors in found.items():
        median[at], answers[at] = float(np.median(errors)), len(errors)
    return median, answers, frames, false


def _cell_text(axes: Axes, x: float, y: float, cell: tuple[float, int, int, int]) -> None:
    """Write a cell's median error, how many were answered if not all were, and how many claims are false."""
    median, answers, frames, false = cell
    lines = [f"{median:.2g}"]
    if answers < frames:
        lines.append(f"{answers}/{frames}")
    if false:
        lines.append(f"✖{false}")
    text = axes.text(x, y, "\n".join(lines), ha="center", va="center", color="#111111", fontsize=7.5, linespacing=1.0)
    text.set_bbox({"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "boxstyle": "round,pad=0.15"})


def _edges(values: FloatArray) -> FloatArray:
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])


def _hatch(axes: Axes, x: FloatArray, y: FloatArray) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(
        Rectangle((x[0], y[0]), x[1] - x[0], y[1] - y[0], fill=False, hatch="///", edgecolor="#00000066", lw=0)
    )


def _outline(axes: Axes, beyond: NDArray[np.bool_], x: FloatArray, y: FloatArray) -> None:
    """Draw the border between cells within and beyond the limit."""
    for i, j in np.argwhere(beyond[:, 1:] != beyond[:, :-1]):
        axes.plot([x[j + 1]] * 2, y[i : i + 2], color="#b34700", lw=1.6)
    for i, j in np.argwhere(beyond[1:] != beyond[:-1]):
        axes.plot(x[j : j + 2], [y[i + 1]] * 2, color="#b34700", lw=1.6)


def sweep(rows: Sequence[Row], estimators: Sequence[str], x_of: Mapping[str, float], label: str, link: Link) -> Draw:
    """Outcome strip, share of frames answered rightly, and the errors, over one axis."""
    return _curves(rows, estimators, x_of, label, dict.fromkeys(estimators, ""), {}, link)


def exclusion_curves(
    rows: Sequence[Row],
    estimators: Sequence[str],
    angle_deg: Mapping[str, float],
    exclusion_deg: Mapping[str, float | None],
    link: Link,
) -> Draw:
    """Outcome strip, share of frames answered rightly, and the errors, over the Sun's distance from the boresight."""
    words = {
        name: ", exclusion angle " + ("none found" if edge is None else f"{edge:.3g}°")
        for name, edge in exclusion_deg.items()
    }
    edges = {name: edge for name, edge in exclusion_deg.items() if edge is not None}
    return _curves(rows, estimators, angle_deg, "Sun's distance from the boresight [deg]", words, edges, link)


def _curves(
    rows: Sequence[Row],
    estimators: Sequence[str],
    x_of: Mapping[str, float],
    label: str,
    words: Mapping[str, str],
    edges: Mapping[str, float],
    link: Link,
) -> Draw:
    def draw(figure: Figure) -> None:
        heights = [STRIP_IN * len(estimators), 1.4, 1.8]
        strip, above, below = figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": heights})
        for i, name in enumerate(estimators):
            rows_of_estimator = sorted((row for row in rows if row.estimator == name), key=lambda row: x_of[row.case])
            x = np.array([x_of[row.case] for row in rows_of_estimator])
            _strip_line(strip, x, rows_of_estimator, i, link)
            right = np.array([row.is_right for row in rows_of_estimator], dtype=float)
            at = np.unique(x)
            look = {
                "color": ESTIMATOR_COLOURS[i % len(ESTIMATOR_COLOURS)],
                "ls": LINE_STYLES[i % len(LINE_STYLES)],
            }
            above.plot(
                at,
                [100 * right[x == value].mean() for value in at],
                marker=ESTIMATOR_MARKERS[i % len(ESTIMATOR_MARKERS)],
                ms=3.5,
                label=f"{name}{words.get(name, '')} (n = {len(rows_of_estimator)})",
                **look,
            )
            if name in edges:
                above.axvline(edges[name], lw=1.0, **look)
            claimed = [k for k, row in enumerate(rows_of_estimator) if row.nadir_error_arcsec is not None]
            errors = [_shown_arcsec(rows_of_estimator[k]) / 3600 for k in claimed]
            marks = below.scatter(x[claimed], errors, **_mark(i))
            marks.set_urls([link(rows_of_estimator[k]) for k in claimed])
        _strip_names(strip, estimators)
        above.set(ylabel="right answers [%]", ylim=(-4, 104))
        below.axhline(LIMIT_DEG, color="#b34700", lw=1.1, ls="--")
        below.set(yscale="log", ylabel="nadir error [deg]", xlabel=label)
        _plain_ticks(below.yaxis)
        # Names with an angle behind them are long: in two columns they would run out of the figure.
        columns = 2 if max((len(name) + len(words.get(name, "")) for name in estimators), default=0) < 32 else 1
        figure.legend(*above.get_legend_handles_labels(), loc="outside upper left", ncols=columns, fontsize=8.5)
        figure.legend(handles=_verdict_handles(strip, rows), loc="outside lower left", ncols=3, fontsize=8.5)

    return draw


def error_distribution(rows: Sequence[Row], estimators: Sequence[str], link: Link) -> Draw:
    """Share of claims with a larger nadir error, both axes logarithmic: tails are what matters.

    The largest errors of every estimator, :data:`TAIL` of them, are marks that link to their frames.
    """

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for i, name in enumerate(estimators):
            rows_of_estimator = sorted(
                (row for row in rows if row.estimator == name and row.nadir_error_arcsec is not None),
                key=lambda row: row.nadir_error_arcsec or 0.0,
            )
            if not rows_of_estimator:
                continue
            errors = np.array([_shown_arcsec(row) / 3600 for row in rows_of_estimator])
            share = 100 * (1.0 - np.arange(len(errors)) / len(errors))
            look: dict[str, Any] = {
                "color": ESTIMATOR_COLOURS[i % len(ESTIMATOR_COLOURS)],
                "ls": LINE_STYLES[i % len(LINE_STYLES)],
            }
            axes.step(errors, share, where="post", **look)
            marks = axes.scatter(errors[-TAIL:], share[-TAIL:], **_mark(i))
            marks.set_urls([link(row) for row in rows_of_estimator[-TAIL:]])
            axes.plot(
                [],
                [],
                marker=ESTIMATOR_MARKERS[i % len(ESTIMATOR_MARKERS)],
                ms=4.5,
                **look,
                label=_n(name, rows_of_estimator),
            )
        axes.axvline(LIMIT_DEG, color="#b34700", lw=1.1, ls="--", label=f"false claim beyond {LIMIT_DEG:g}°")
        axes.set(xscale="log", yscale="log", xlabel="nadir error [deg]", ylabel="claims with at least this error [%]")
        _plain_ticks(axes.xaxis)
        _plain_ticks(axes.yaxis)
        figure.legend(*axes.get_legend_handles_labels(), loc="outside upper left", ncols=2, fontsize=8.5)

    return draw


def bias_and_noise(groups: Sequence[Mapping[str, Any]]) -> Draw:
    """Mean (bias) and standard deviation (noise) of roll and pitch errors side by side, with 95 % bars on the mean.

    ``groups`` are those of :func:`horizonval.scoring.summary.summarise`: a line for every estimator and camera.
    """

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True)
        means: list[float] = []
        for i, group in enumerate(groups):
            for key, shift, marker in (("roll", -0.14, "o"), ("pitch", 0.14, "s")):
                found = group[f"{key}_error_arcsec"]
                if found["n"] < 2:
                    continue
                mean, spread = found["mean"] / 3600, found["std"] / 3600
                colour = PAIR_COLOURS[key]
                half = 1.96 * spread / math.sqrt(found["n"])
                means.append(mean)
                left.errorbar(mean, i + shift, xerr=half, fmt=marker, ms=5, color=colour, capsize=3)
                right.plot(max(spread, FLOOR_ARCSEC / 3600), i + shift, marker, ms=5, color=colour)
        left.axvline(0.0, color="#333333", lw=0.8)
        # One wild method must not squeeze the others into a line: linear to a tenth of a degree, then logarithmic.
        left.set_xscale("symlog", linthresh=0.1)
        left.set_xticks(_symlog_ticks(max((abs(mean) for mean in means), default=0.1)))
        _plain_ticks(left.xaxis)
        names = [f"{g['estimator']}\n{g['camera']} (n = {g['roll_error_arcsec']['n']})" for g in groups]
        left.set(xlabel="bias [deg]", yticks=range(len(groups)), yticklabels=names)
        left.tick_params(axis="y", labelsize=8)
        left.set_ylim(len(groups) - 0.5, -0.5)
        right.set(xlabel="standard deviation [deg]", xscale="log")
        _plain_ticks(right.xaxis)
        handles = [
            left.plot([], [], m, color=PAIR_COLOURS[k], ls="", label=k)[0] for k, m in (("roll", "o"), ("pitch", "s"))
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=2, fontsize=8.5)

    return draw


def _symlog_ticks(largest: float) -> list[float]:
    beyond = [value for value in (1.0, 10.0, 100.0) if value <= 1.2 * largest]
    return [*(-value for value in beyond[::-1]), -0.1, 0.0, 0.1, *beyond]


def _n(name: str, rows: Sequence[Row]) -> str:
    return f"{name} (n = {len(rows)})"


def _plain_ticks(axis: Axis) -> None:
    """Write 0.1 and 100, not powers of ten."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _mark(index: int) -> dict[str, Any]:
    return {
        "marker": ESTIMATOR_MARKERS[index % len(ESTIMATOR_MARKERS)],
        "color": ESTIMATOR_COLOURS[index % len(ESTIMATOR_COLOURS)],
        "s": 20,
        "edgecolors": "white",
        "linewidths": 0.5,
        "zorder": 3,
    }
