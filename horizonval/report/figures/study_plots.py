"""Figures of the page of a trade study: fronts, errors and shares by design, effects of the axes.

Designs carry their numbers; markers and hatching, not colours alone, tell what is what.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from horizonval.core.json_types import JsonObject
from horizonval.report.figures.plots import ESTIMATOR_COLOURS, ESTIMATOR_MARKERS, Draw

MOST_WORDY = 20
"""Among more designs only those on the front have their numbers and bars."""
_SHORT = 2.0
"""Ratio of the ends of a log axis below which all its ticks are labelled."""
_GREY = "#8d949c"
_LIMIT = "#b34700"
ERRORS = (
    ("bias_deg", "bias", "^"),
    ("noise_deg", "noise", "s"),
    ("p95_deg", "p95", "o"),
    ("three_sigma_deg", "3 sigma", "x"),
)
SHARES = (("availability", "answered", "o"), ("within", "answered within the limit", "D"))


def pareto(
    designs: Sequence[JsonObject],
    x_of: Mapping[str, JsonObject],
    front: Sequence[str],
    label: str,
    limit_deg: float,
    groups: Mapping[str, str],
    log_x: bool = True,
) -> Draw:
    """The p95 error of every design against what it costs, the front as a staircase.

    Parameters
    ----------
    designs : sequence of mapping
    x_of : mapping
        ``{value, interval}`` by name; designs without a value are left out.
    front : sequence of str
        Names on the front.
    label : str
        Of the axis, with its unit.
    limit_deg : float
    groups : mapping
        By name, the word whose marker the design carries.
    """

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        if log_x:
            axes.set_xscale("log")
            plain_ticks(axes.xaxis)
        words = list(dict.fromkeys(groups.values()))
        shown = [d for d in designs if d["p95_deg"]["value"] is not None and x_of[d["name"]]["value"] is not None]
        places = [v for d in shown for v in (x_of[d["name"]]["value"], *(x_of[d["name"]]["interval"] or ())) if v]
        if log_x and places:
            # A log axis finds no room of its own round a single place.
            axes.set_xlim(min(places) / 1.5, max(places) * 1.5)
        for d in shown:
            x, y = x_of[d["name"]], d["p95_deg"]
            i = words.index(groups[d["name"]])
            on = d["name"] in front
            if on or len(shown) <= MOST_WORDY:
                axes.errorbar(
                    x["value"],
                    y["value"],
                    xerr=_error_bars(x),
                    yerr=_error_bars(y),
                    fmt="none",
                    ecolor=_GREY,
                    lw=0.8,
                    zorder=1,
                )
                axes.annotate(
                    str(d["number"]), (x["value"], y["value"]), xytext=(5, 4), textcoords="offset points", fontsize=8
                )
            axes.scatter(
                x["value"],
                y["value"],
                marker=ESTIMATOR_MARKERS[i % len(ESTIMATOR_MARKERS)],
                s=48 if on else 30,
                facecolors=ESTIMATOR_COLOURS[i % len(ESTIMATOR_COLOURS)] if on else "white",
                edgecolors=ESTIMATOR_COLOURS[i % len(ESTIMATOR_COLOURS)],
                zorder=3,
            )
        steps = sorted((x_of[d["name"]]["value"], d["p95_deg"]["value"]) for d in shown if d["name"] in front)
        if len(steps) > 1:
            axes.step(*zip(*steps, strict=True), where="post", color="#333333", lw=1.0, ls="-", zorder=2)
        axes.axhline(limit_deg, color=_LIMIT, lw=1.1, ls="--")
        # Not before there is data: a log axis complains of an empty one.
        axes.set_yscale("log")
        plain_ticks(axes.yaxis)
        axes.set(xlabel=label, ylabel="p95 of the nadir error [deg]")
        handles = [
            Line2D([], [], ls="", marker=ESTIMATOR_MARKERS[i % len(ESTIMATOR_MARKERS)], mfc="white",
                   mec=ESTIMATOR_COLOURS[i % len(ESTIMATOR_COLOURS)], label=word)
            for i, word in enumerate(words)
        ]  # fmt: skip
        handles.append(Line2D([], [], color="#333333", lw=1.0, marker="o", mfc="#333333", label="front (filled)"))
        handles.append(Line2D([], [], color=_LIMIT, ls="--", lw=1.1, label=f"required: {limit_deg:g} deg"))
        figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=8.5)
        axes.set_title(f"n = {len(shown)} of {len(designs)} designs", loc="left", fontsize=8.5)

    return draw


def by_design(designs: Sequence[JsonObject], limit_deg: float, availability: float) -> Draw:
    """Errors of claims, and shares of frames, one line a design."""

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [1.4, 1.0]})
        lines = np.arange(len(designs))
        for k, (key, word, marker) in enumerate(ERRORS):
            _dots(left, lines, [d[key] for d in designs], "value", k, marker, word)
        left.set_xscale("log")
        plain_ticks(left.xaxis)
        left.axvline(limit_deg, color=_LIMIT, lw=1.1, ls="--")
        left.set_xlabel("error of claims [deg]")
        for k, (key, word, marker) in enumerate(SHARES):
            _dots(right, lines, [d[key] for d in designs], "rate", k, marker, word)
        right.axvline(availability, color=_LIMIT, lw=1.1, ls="--")
        right.set(xlabel="share of all frames", xlim=(-0.02, 1.02))
        left.set(yticks=lines, yticklabels=[f"{d['number']}  n = {d['n']}" for d in designs])
        left.set_ylim(len(designs) - 0.5, -0.5)
        figure.legend(
            handles=[*left.get_legend_handles_labels()[0], *right.get_legend_handles_labels()[0]],
            loc="outside upper left",
            ncols=3,
            fontsize=8.5,
        )

    return draw


def shares_of_variance(effects: JsonObject, words: Mapping[str, str]) -> Draw:
    """Share of the variance of the log error that each axis, and each pair of axes, takes."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        terms = effects["terms"]
        for i, term in enumerate(terms):
            share = term["share"]
            value = share["value"] or 0.0
            pair = len(term["axes"]) > 1 or term["axes"] == ["remainder"]
            axes.barh(i, value, color="white" if pair else "#0072b2", edgecolor="#0072b2", hatch="///" if pair else "")
            if share["interval"] is not None:
                axes.plot(share["interval"], [i, i], color="#111111", lw=1.4, marker="|", ms=7)
        axes.set(yticks=range(len(terms)), yticklabels=[term_words(term, words) for term in terms])
        axes.set_ylim(len(terms) - 0.5, -0.5)
        axes.set(xlim=(0, 1.02), xlabel="share of the variance of log$_{10}$ error between designs")
        axes.grid(axis="y", visible=False)

    return draw


def level_factors(effects: JsonObject, words: Mapping[str, str]) -> Draw:
    """By how much every level of every axis multiplies the error."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        names, at = [], 0
        for k, (key, levels) in enumerate(effects["levels"].items()):
            for line in levels:
                colour = ESTIMATOR_COLOURS[k % len(ESTIMATOR_COLOURS)]
                if line["interval"] is not None:
                    axes.plot(line["interval"], [at, at], color=colour, lw=1.2)
                axes.scatter(
                    line["factor"], at, color=colour, marker=ESTIMATOR_MARKERS[k % len(ESTIMATOR_MARKERS)], s=30
                )
                names.append(f"{words.get(key, key)} = {level_words(line['level'])}")
                at += 1
            if at < sum(len(v) for v in effects["levels"].values()):
                axes.axhline(at - 0.5, color="#d9dde2", lw=0.8)
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
        low, high = axes.get_xlim()
        axes.set_xlim(min(low, 0.5), max(high, 2.0))
        axes.axvline(1.0, color="#555555", lw=0.9)
        axes.set(yticks=range(at), yticklabels=names, xlabel="factor on the error")
        axes.set_ylim(at - 0.5, -0.5)
        axes.grid(axis="y", visible=False)

    return draw


def term_words(term: JsonObject, words: Mapping[str, str]) -> str:
    """Return a term's axes as words."""
    return " × ".join(words.get(key, key) for key in term["axes"])


def level_words(level: Any) -> str:
    """Return a value on an axis as text."""
    return f"{level:g}" if isinstance(level, float) else str(level)


def plain_ticks(axis: Axis) -> None:
    """Label a log axis with plain numbers, between the powers of ten at 2 and 5; a short axis at all its ticks."""

    def label(x: float, _: object) -> str:
        low, high = sorted(axis.get_view_interval())
        shown = high < _SHORT * low or f"{x:.3e}"[:5] in ("2.000", "5.000")
        # 20000, as 100000 beside it, not 2e+04.
        return f"{float(f'{x:.3g}'):g}" if shown else ""

    axis.set_major_formatter(lambda x, _: f"{x:g}")
    axis.set_minor_formatter(label)


def _error_bars(found: JsonObject) -> list[list[float]] | None:
    """Return the arms of an error bar: never negative, an open end drawn to the value."""
    if found.get("interval") is None:
        return None
    low, high = found["interval"]
    value = found["value"]
    return [[max(value - (value if low is None else low), 0.0)], [max((value if high is None else high) - value, 0.0)]]


def _dots(axes: Axes, lines: Any, found: Sequence[JsonObject], key: str, index: int, marker: str, word: str) -> None:
    offset = (index - 1) * 0.16
    colour = ESTIMATOR_COLOURS[index % len(ESTIMATOR_COLOURS)]
    known = [(line + offset, item) for line, item in zip(lines, found, strict=True) if item[key] is not None]
    for y, item in known:
        bounds = [b for b in item["interval"] or [] if b is not None]
        if bounds:
            axes.plot([min(*bounds, item[key]), max(*bounds, item[key])], [y, y], color=colour, lw=0.9)
    face = colour if marker == "x" else "white" if index % 2 else colour
    axes.scatter(
        [item[key] for _, item in known],
        [y for y, _ in known],
        marker=marker,
        s=24,
        facecolors=face,
        edgecolors=None if marker == "x" else colour,
        color=colour if marker == "x" else None,
        zorder=3,
        label=word,
    )
