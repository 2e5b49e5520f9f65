"""The page of a campaign: the suite's figures, rates with their intervals, and the worst frames.

It uses the run's folder alone. Every mark of a frame links to the frame's card on the first page.
"""

from __future__ import annotations

import itertools
import math
import re
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from typing import Any
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry import clock
from horizonval.report import plots
from horizonval.report.load import ReportRun
from horizonval.report.plots import FLOOR_ARCSEC, GREY, INK, LIMIT, MARKERS, RED, SMALL, Draw, line, mark, plain_ticks
from horizonval.report.words import (
    DASH,
    DEG,
    FALSE_VALID,
    MISSED,
    VerdictMark,
    confusion_tables,
    count,
    interval,
    key_words,
    limit_words,
    number,
    outcome,
    share,
    verdict_of,
)
from horizonval.scoring import limits
from horizonval.scoring.expected import exclusion_angle_deg
from horizonval.scoring.row import Row
from horizonval.scoring.summary import rates, summarise

PAGE = "campaign.html"
FIGURES = "figures"
"""Subfolder for figures as files."""
WORST = 6
"""Number of named frames of each kind."""
GUARDED = "guarded-"

Link = Callable[[Row], str | None]
"""Address of a row's frame; None if the first page does not show it."""


def is_due(run: ReportRun) -> bool:
    """Whether a run has this page: the suite has figures, or several noise samples, or both."""
    return bool(run.figures) or _has_draws(run)


def _has_draws(run: ReportRun) -> bool:
    return any(row.noise_draws is not None for row in run.rows)


def headline(run: ReportRun) -> str:
    """Return the campaign in one sentence."""
    rows = run.judged_rows
    false = sum(verdict_of(row) is FALSE_VALID for row in rows)
    figures = f"{count(len(run.figures), 'figure')}; " if run.figures else ""
    return f"{figures}{false} of {sum(row.is_claim for row in rows)} claims are false."


def page_of(run: ReportRun) -> JsonObject:
    """Return the content of the template."""
    rows, link, names = run.judged_rows, links_of(run), run.judged_estimators
    groups = summarise(rows, likelihood=run.likelihood)["groups"]
    tails = plots.figure(
        "Tails", "Share of claims with at least this error; the largest are marks that lead to their frames.",
        error_distribution(rows, names, link), 6.2, 4.8,
    )  # fmt: skip
    # One claim has no spread.
    spread = [group for group in groups if group["roll_error_arcsec"]["n"] > 1]
    bias = [
        plots.figure(
            "Bias and noise", "Mean of roll and pitch errors with its 95 % interval, and their standard deviation.",
            bias_and_noise(spread), 7.4, 1.1 + 0.42 * len(spread),
        )
    ]  # fmt: skip
    guarded = [row for row in rows if row.estimator.startswith(GUARDED)]
    bare = [row for row in rows if not row.estimator.startswith(GUARDED)]
    pooled = [(name, own) for name, own in (("all bare methods", bare), ("all guarded methods", guarded)) if own]
    return {
        "headline": headline(run),
        "sections": [_section(run, plan, index, link) for index, plan in enumerate(run.figures)],
        "confusions": confusion_tables(rows, names, run.likelihood),
        "rates": [
            *({"estimator": name, "camera": "", "n": len(own), **rates(own, run.likelihood)} for name, own in pooled),
            *groups,
        ],
        "groups": groups,
        "figures": [tails, *(bias if spread else ())],
        "worst": _worst(rows, link),
        "drawn": _has_draws(run),
        "limits": limit_words(DEG),
    }


def links_of(run: ReportRun) -> Link:
    """Return the function that gives the address of a row's frame."""
    shown = {name for view in run.views if view.shown for name in (view.case, view.scene)}
    return lambda row: f"index.html#{quote(row.case)}" if row.case in shown else None


def _section(run: ReportRun, plan: JsonObject, index: int, link: Link) -> JsonObject:
    rows = [row for row in run.judged_rows if row.case in plan["cases"]]
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.camera, row.band), []).append(row)
    figures = []
    for (camera, band), own in sorted(groups.items()):
        names = [name for name in run.judged_estimators if any(row.estimator == name for row in own)]
        for estimator, drawn, width, height in _drawings(plan, own, names, link):
            stem = "-".join(filter(None, [str(index + 1), plan["kind"], camera, band, estimator]))
            file = f"{FIGURES}/{re.sub(r'[^A-Za-z0-9._-]+', '-', stem)}.svg"
            title = ", ".join(filter(None, [camera, band, estimator]))
            figures.append(plots.figure(title, "", drawn, width, height, wide=plan["kind"] != "map", file=file))
    return {"title": plan["title"], "kind": plan["kind"], "figures": figures, "n": len({row.case for row in rows})}


def _drawings(
    plan: JsonObject, rows: Sequence[Row], names: Sequence[str], link: Link
) -> list[tuple[str, Draw, float, float]]:
    """Return estimator ("" for all together), drawing function, and width and height [in] of each drawing."""
    first = {case: values[0] for case, values in plan["cases"].items() if values}
    curves_in = 5.2 + (0.25 + STRIP_IN) * len(names)
    match plan["kind"]:
        case "timeline":
            minutes = _minutes(rows)
            drawn = timeline(rows, names, minutes, _spans(rows, minutes), link)
            panels = sum(PANEL_IN if _claims(rows, name) else EMPTY_IN for name in names)
            return [("", drawn, 10.0, 1.3 + (0.3 + STRIP_IN) * len(names) + panels)]
        case "map":
            second = {case: values[1] for case, values in plan["cases"].items()}
            labels = (key_words(plan["x"]), key_words(plan["y"]))
            return [
                (name, heat_map([r for r in rows if r.estimator == name], first, second, labels), 5.4, 4.2)
                for name in names
            ]
        case "sweep":
            return [("", curves(rows, names, first, key_words(plan["x"]), link), 9.0, curves_in)]
        case _:
            angles = {row.case: row.sun_boresight_deg for row in rows if row.sun_boresight_deg is not None}
            rows = [row for row in rows if row.case in angles]
            found = {
                name: exclusion_angle_deg([angles[r.case] for r in own], [r.is_right for r in own])
                for name in names
                if (own := [row for row in rows if row.estimator == name])
            }
            label = "Sun's distance from the boresight [deg]"
            return [("", curves(rows, names, angles, label, link, found), 9.0, curves_in)]


def _minutes(rows: Sequence[Row]) -> dict[str, float]:
    times = {row.case: datetime.fromisoformat(row.epoch_utc) for row in rows if row.epoch_utc}
    start = min(times.values())
    return {case: clock.elapsed_s(start, time) / 60.0 for case, time in times.items()}


def _spans(rows: Sequence[Row], minutes: Mapping[str, float]) -> list[tuple[str, float, float]]:
    """Return name, start and end of eclipses, Sun in frame and terminator in view; ends are midway between frames."""
    by_case = {row.case: row for row in rows}
    order = sorted(by_case, key=lambda case: minutes[case])
    times = [minutes[case] for case in order]
    edges = [times[0], *((a + b) / 2 for a, b in pairwise(times)), times[-1]]
    tests: dict[str, Callable[[Row], bool]] = {
        "eclipse": lambda row: row.sun_visible_fraction == 0.0,
        "Sun in the frame": lambda row: bool(row.sun_in_frame),
        "terminator in view": lambda row: row.lit_fraction is not None and 0.0 < row.lit_fraction < 1.0,
    }
    spans = []
    for label, test in tests.items():
        for holds, group in itertools.groupby(range(len(order)), [test(by_case[case]) for case in order].__getitem__):
            if holds:
                which = list(group)
                spans.append((label, edges[which[0]], edges[which[-1] + 1]))
    return spans


def _bound(rate: float) -> str:
    """Return an upper bound in per cent, rounded up."""
    digits = 1 if rate >= 0.01 else 3
    return f"{math.ceil(100 * rate * 10**digits - 1e-9) / 10**digits:.{digits}f} %"


def _bias(found: Mapping[str, Any]) -> str:
    """Return a bias in words, to a thousandth of a degree."""
    return DASH if found["mean"] is None else f"{DEG.of(found['mean']):+.3f}".replace("-", "\N{MINUS SIGN}")


def _consistency(found: Mapping[str, Any]) -> dict[str, str]:
    """Return a mean normalised error squared, per degree of freedom, in words."""
    if not found["n"]:
        return {"mean": DASH, "interval": "", "glyph": ""}
    dof = found["expected"]
    mean = found["mean"] / dof
    glyph = "" if 0.5 <= mean <= 2.0 else ("\N{UPWARDS ARROW}" if mean > 1.0 else "\N{DOWNWARDS ARROW}")
    words = number(mean)
    if found.get("standard_error") is not None:
        words += f" ± {number(found['standard_error'] / dof, 2)}"
    return {"mean": words, "interval": interval([value / dof for value in found["interval"]]), "glyph": glyph}


FILTERS: dict[str, Callable[..., Any]] = {
    "share": share,
    "bound": _bound,
    "bias": _bias,
    "consistency": _consistency,
    "degrees": DEG.number,
}
"""Filters of the page's template."""


def _worst(rows: Sequence[Row], link: Link) -> list[JsonObject]:
    """Return the worst frames of each kind: false claims by error, and refused usable frames."""
    false = sorted(
        (row for row in rows if verdict_of(row) is FALSE_VALID), key=lambda row: -(row.nadir_error_arcsec or 0)
    )
    missed = sorted((row for row in rows if verdict_of(row) is MISSED), key=lambda row: -(row.lit_fraction or 0))

    def text(row: Row) -> str:
        if row.false_valid:
            return f"{DEG.text(row.nadir_error_arcsec)} off"
        return f"{outcome(row.status)}: {row.reason or ''}"

    return [
        {
            "kind": kind.label,
            "glyph": kind.glyph,
            "total": len(found),
            "lines": [
                {"case": row.case, "estimator": row.estimator, "link": link(row), "text": text(row)}
                for row in found[:WORST]
            ],
        }
        for kind, found in ((FALSE_VALID, false), (MISSED, missed))
        if found
    ]


# ------------------------------------------------------------------------------------------------------------ figures

THIN_CELL = 3
"""Number of frames below which cells of a map are hatched."""
MOST_WORDY_CELLS = 60
"""Largest number of cells of a map with numbers in them."""
TAIL = 20
"""Number of an estimator's largest errors that are marked in the tail figure."""
LIMIT_DEG = math.degrees(limits.NADIR_ERROR_LIMIT_RAD)
LEAST_SHOWN_DEG = 1e-3
"""Smallest error in timelines; smaller ones are drawn here."""
STRIP_IN, PANEL_IN, EMPTY_IN = 0.2, 1.05, 0.25
"""Heights of a line of verdicts, of an estimator's panel, and of an empty panel."""
_PAIR_COLOURS = {"roll": "#0072b2", "pitch": "#d55e00"}
_SPAN_LOOKS: dict[str, dict[str, Any]] = {
    "eclipse": {"color": GREY, "alpha": 0.25, "lw": 0},
    "Sun in the frame": {"color": "#e69f00", "alpha": 0.35, "lw": 0},
    "terminator in view": {"facecolor": "none", "edgecolor": "#0072b2", "hatch": "////", "alpha": 0.75, "lw": 0},
}
_SIGMA_LOOK: dict[str, Any] = {"marker": "_", "s": 60, "color": INK, "lw": 1.3}


def _claims(rows: Sequence[Row], estimator: str) -> list[Row]:
    return [row for row in rows if row.estimator == estimator and row.nadir_error_arcsec is not None]


def _degrees(row: Row, least: float = DEG.of(FLOOR_ARCSEC)) -> float:
    """Return a claim's error, at least the minimum of the axis."""
    return max(DEG.of(row.nadir_error_arcsec or 0.0), least)


def _strip(
    axes: Axes, rows: Sequence[Row], estimators: Sequence[str], x_of: Mapping[str, float], link: Link
) -> list[Any]:
    """Draw the verdicts on the rows over an axis, a line for each estimator; return the legend's entries."""
    plots.verdict_strip(axes, estimators)
    shown: dict[VerdictMark, Any] = {}
    for line_number, name in enumerate(estimators):
        by_verdict: dict[VerdictMark, list[Row]] = {}
        for row in sorted((row for row in rows if row.estimator == name), key=lambda row: x_of[row.case]):
            by_verdict.setdefault(verdict_of(row), []).append(row)
        for verdict, own in by_verdict.items():
            look = plots.verdict_look(verdict)
            marks = axes.scatter([x_of[row.case] for row in own], [line_number] * len(own), zorder=3, **look)
            marks.set_urls([link(row) for row in own])
            shown.setdefault(verdict, axes.scatter([], [], label=verdict.label, **look))
    return list(shown.values())


def timeline(
    rows: Sequence[Row],
    estimators: Sequence[str],
    minutes: Mapping[str, float],
    spans: Sequence[tuple[str, float, float]],
    link: Link,
) -> Draw:
    """Outcome strip and error with three claimed sigma of every estimator along the time of a flight.

    ``rows``: of one camera and band. ``minutes``: time of every case. ``spans``: shaded (name, start, end) [min].
    """
    errors = [_degrees(row, LEAST_SHOWN_DEG) for row in rows if row.nadir_error_arcsec is not None]
    # All panels share the axis, so that they can be compared.
    ends = max(min([*errors, LIMIT_DEG]) / 2, LEAST_SHOWN_DEG), 2 * max([*errors, LIMIT_DEG])

    def panel(axes: Axes, index: int, claims: Sequence[Row]) -> None:
        if not claims:
            plots.empty(axes, "no answer")
            return
        axes.set(yscale="log", ylim=ends, ylabel="error [deg]")
        plain_ticks(axes.yaxis)
        axes.axhline(LIMIT_DEG, **LIMIT)
        x = [minutes[row.case] for row in claims]
        axes.scatter(x, [max(3.0 * DEG.of(row.sigma_total_arcsec or 0.0), ends[0]) for row in claims], **_SIGMA_LOOK)
        marks = axes.scatter(x, [_degrees(row, LEAST_SHOWN_DEG) for row in claims], **mark(index))
        marks.set_urls([link(row) for row in claims])

    def draw(figure: Figure) -> None:
        heights = [PANEL_IN if _claims(rows, name) else EMPTY_IN for name in estimators]
        ratios = [STRIP_IN * len(estimators), *heights]
        strip, *panels = figure.subplots(len(ratios), 1, sharex=True, gridspec_kw={"height_ratios": ratios})
        for axes in (strip, *panels):
            for label, start, end in spans:
                axes.axvspan(start, end, zorder=0, **_SPAN_LOOKS[label])
        handles = _strip(strip, rows, estimators, minutes, link)
        for i, name in enumerate(estimators):
            claims, n = _claims(rows, name), sum(row.estimator == name for row in rows)
            panel(panels[i], i, sorted(claims, key=lambda row: minutes[row.case]))
            panels[i].set_title(f"{name}, {len(claims)} claims of {n} frames", loc="left", fontsize=9.5)
        panels[-1].set_xlabel("time from the first frame [min]")
        handles += [Patch(label=name, **_SPAN_LOOKS[name]) for name in dict.fromkeys(span[0] for span in spans)]
        handles += [
            strip.scatter([], [], **(mark(0) | {"color": GREY}), label="error (mark of the method)"),
            strip.scatter([], [], **_SIGMA_LOOK, label="3 sigma claimed"),
            strip.plot([], [], **LIMIT, label=f"false claim beyond {LIMIT_DEG:g}°")[0],
        ]
        figure.legend(handles=handles, loc="outside upper left", ncols=4, fontsize=SMALL)

    return draw


def heat_map(
    rows: Sequence[Row], x_of: Mapping[str, float], y_of: Mapping[str, float], labels: tuple[str, str]
) -> Draw:
    """Median nadir error over a grid of two axes, on a logarithmic colour scale, for one estimator, camera and band.

    Cells without an answer are crossed, cells with fewer than :data:`THIN_CELL` frames hatched, errors beyond the limit
    of a false claim outlined. ``x_of`` and ``y_of``: axis values of every case.
    """

    xs = np.array(sorted({x_of[row.case] for row in rows}))
    ys = np.array(sorted({y_of[row.case] for row in rows}))
    cells: dict[tuple[int, int], list[Row]] = {}
    for row in rows:
        cells.setdefault((bisect_left(ys, y_of[row.case]), bisect_left(xs, x_of[row.case])), []).append(row)
    median = np.full((len(ys), len(xs)), np.nan)
    for at, own in cells.items():
        if errors := [_degrees(row) for row in own if row.nadir_error_arcsec is not None]:
            median[at] = float(np.median(errors))
    wordy = median.size <= MOST_WORDY_CELLS

    def words(own: Sequence[Row], at: tuple[int, int]) -> str:
        """Return a cell's median error, the number of answers if below the number of frames, and of false claims."""
        answers, false = sum(row.nadir_error_arcsec is not None for row in own), sum(row.false_valid for row in own)
        lines = [f"{median[at]:.2g}", f"{answers}/{len(own)}" * (answers < len(own)), f"✖{false}" * bool(false)]
        return "\n".join(filter(None, lines))

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        x, y = _edges(xs), _edges(ys)
        known = median[np.isfinite(median)]
        if known.size:
            norm = LogNorm(min(float(known.min()), LIMIT_DEG / 10), max(float(known.max()), LIMIT_DEG))
            mesh = axes.pcolormesh(x, y, np.ma.masked_invalid(median), cmap="viridis_r", norm=norm)
            bar = figure.colorbar(mesh, ax=axes)
            bar.set_label("median nadir error [deg]")
            plain_ticks(bar.ax.yaxis)
            bar.ax.axhline(LIMIT_DEG, color=RED, lw=1.5)
        for (i, j), own in cells.items():
            if len(own) < THIN_CELL:
                size = x[j + 1] - x[j], y[i + 1] - y[i]
                axes.add_patch(Rectangle((x[j], y[i]), *size, fill=False, hatch="///", edgecolor="#00000066", lw=0))
            look: dict[str, Any] = {"ha": "center", "va": "center", "linespacing": 1.0}
            if np.isnan(median[i, j]):
                axes.text(xs[j], ys[i], "×", color=INK, fontsize=9, **look)
            elif wordy:
                text = axes.text(xs[j], ys[i], words(own, (i, j)), color="#111111", fontsize=7.5, **look)
                text.set_bbox({"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "boxstyle": "round,pad=0.15"})
        if min(median.shape) > 1 and known.size:
            # The border between cells within and beyond the limit.
            beyond = np.where(np.isfinite(median), median, np.inf) > LIMIT_DEG
            for i, j in np.argwhere(beyond[:, 1:] != beyond[:, :-1]):
                axes.plot([x[j + 1]] * 2, y[i : i + 2], color=RED, lw=1.6)
            for i, j in np.argwhere(beyond[1:] != beyond[:-1]):
                axes.plot(x[j : j + 2], [y[i + 1]] * 2, color=RED, lw=1.6)
        axes.set(xlabel=labels[0], ylabel=labels[1])
        axes.grid(visible=False)
        thin = min(map(len, cells.values()), default=THIN_CELL) < THIN_CELL
        head = [f"n = {len(rows)}", "× no answer", *(["2/3 answered"] if wordy else []), "✖ false claims"]
        ending = f"\nhatched: fewer than {THIN_CELL} frames" if thin else ""
        axes.set_title(", ".join(head) + ending, loc="left", fontsize=SMALL)

    return draw


def _edges(values: FloatArray) -> FloatArray:
    if len(values) == 1:
        return np.array([values[0] - 0.5, values[0] + 0.5])
    middle = (values[1:] + values[:-1]) / 2
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])


def curves(
    rows: Sequence[Row],
    estimators: Sequence[str],
    x_of: Mapping[str, float],
    label: str,
    link: Link,
    exclusion_deg: Mapping[str, float | None] | None = None,
) -> Draw:
    """Outcome strip, share of frames with a right answer, and the errors, over one axis.

    ``exclusion_deg``: over the Sun's distance from the boresight, the exclusion angle of each estimator.
    """
    edges = {name: edge for name, edge in (exclusion_deg or {}).items() if edge is not None}
    words = {
        name: ", exclusion angle " + (f"{edges[name]:.3g}°" if name in edges else "none found")
        for name in exclusion_deg or {}
    }

    def draw(figure: Figure) -> None:
        ratios = [STRIP_IN * len(estimators), 1.4, 1.8]
        strip, above, below = figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": ratios})
        handles = _strip(strip, rows, estimators, x_of, link)
        for i, name in enumerate(estimators):
            own = sorted((row for row in rows if row.estimator == name), key=lambda row: x_of[row.case])
            x = np.array([x_of[row.case] for row in own])
            right = np.array([row.is_right for row in own], dtype=float)
            at = np.unique(x)
            above.plot(
                at,
                [100 * right[x == value].mean() for value in at],
                marker=MARKERS[i % len(MARKERS)],
                ms=3.5,
                label=f"{name}{words.get(name, '')} (n = {len(own)})",
                **line(i),
            )
            if name in edges:
                above.axvline(edges[name], lw=1.0, **line(i))
            claims = [row for row in own if row.nadir_error_arcsec is not None]
            marks = below.scatter([x_of[row.case] for row in claims], [_degrees(row) for row in claims], **mark(i))
            marks.set_urls([link(row) for row in claims])
        above.set(ylabel="right answers [%]", ylim=(-4, 104))
        below.axhline(LIMIT_DEG, **LIMIT)
        below.set(yscale="log", ylabel="nadir error [deg]", xlabel=label)
        plain_ticks(below.yaxis)
        # Long names with an angle do not fit in two columns.
        longest = max((len(name) + len(words.get(name, "")) for name in estimators), default=0)
        plots.legend_above(figure, above, 2 if longest < 32 else 1)
        figure.legend(handles=handles, loc="outside lower left", ncols=3, fontsize=SMALL)

    return draw


def error_distribution(rows: Sequence[Row], estimators: Sequence[str], link: Link) -> Draw:
    """Share of claims with a larger nadir error, both axes logarithmic, to show the tails.

    The largest errors of every estimator, :data:`TAIL` of them, are marks with links to their frames.
    """

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        for i, name in enumerate(estimators):
            own = sorted(_claims(rows, name), key=lambda row: row.nadir_error_arcsec or 0.0)
            if not own:
                continue
            errors = np.array([_degrees(row) for row in own])
            percents = 100 * (1.0 - np.arange(len(errors)) / len(errors))
            axes.step(errors, percents, where="post", **line(i))
            marks = axes.scatter(errors[-TAIL:], percents[-TAIL:], **mark(i))
            marks.set_urls([link(row) for row in own[-TAIL:]])
            axes.plot([], [], marker=MARKERS[i % len(MARKERS)], ms=4.5, label=f"{name} (n = {len(own)})", **line(i))
        axes.axvline(LIMIT_DEG, **LIMIT, label=f"false claim beyond {LIMIT_DEG:g}°")
        axes.set(xscale="log", yscale="log", xlabel="nadir error [deg]", ylabel="claims with at least this error [%]")
        plain_ticks(axes.xaxis, axes.yaxis)
        plots.legend_above(figure, axes)

    return draw


def bias_and_noise(groups: Sequence[Mapping[str, Any]]) -> Draw:
    """Mean (bias) and standard deviation (noise) of roll and pitch errors, with 95 % bars on the mean.

    ``groups``: as from :func:`horizonval.scoring.summary.summarise`, a line for every estimator and camera.
    """

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True)
        largest = 0.1
        for i, group in enumerate(groups):
            for key, shift, marker in (("roll", -0.14, "o"), ("pitch", 0.14, "s")):
                found = group[f"{key}_error_arcsec"]
                if found["n"] < 2:
                    continue
                mean, spread, colour = DEG.of(found["mean"]), DEG.of(found["std"]), _PAIR_COLOURS[key]
                largest = max(largest, abs(mean))
                half = 1.96 * spread / math.sqrt(found["n"])
                left.errorbar(mean, i + shift, xerr=half, fmt=marker, ms=5, color=colour, capsize=3)
                right.plot(max(spread, DEG.of(FLOOR_ARCSEC)), i + shift, marker, ms=5, color=colour)
        left.axvline(0.0, color=INK, lw=0.8)
        # One wild method must not squeeze the others into a line: linear to a tenth of a degree, then logarithmic.
        left.set_xscale("symlog", linthresh=0.1)
        beyond = [value for value in (1.0, 10.0, 100.0) if value <= 1.2 * largest]
        left.set_xticks([*(-value for value in beyond[::-1]), -0.1, 0.0, 0.1, *beyond])
        names = [f"{g['estimator']}\n{g['camera']} (n = {g['roll_error_arcsec']['n']})" for g in groups]
        left.set(xlabel="bias [deg]", yticks=range(len(groups)), yticklabels=names)
        left.tick_params(axis="y", labelsize=8)
        left.set_ylim(len(groups) - 0.5, -0.5)
        right.set(xlabel="standard deviation [deg]", xscale="log")
        plain_ticks(left.xaxis, right.xaxis)
        for key, marker in (("roll", "o"), ("pitch", "s")):
            left.plot([], [], marker, color=_PAIR_COLOURS[key], label=key)
        plots.legend_above(figure, left)

    return draw
