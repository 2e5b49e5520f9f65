"""The page of a trade study: made of ``study.json``, ``study-costs.json``, and a few frames of the run.

Designs carry their numbers; markers and hatching, not only colours, distinguish them.
"""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError
from horizonval.core.json_types import JsonObject
from horizonval.report import page, plots
from horizonval.report.load import load_run
from horizonval.report.plots import COLOURS, GREY, INK, LIMIT, MARKERS, SMALL, Draw, plain_ticks
from horizonval.report.viewer import MOST_BESIDE, striking_frames
from horizonval.report.words import count, interval, key_words, number, share
from horizonval.scoring.requirements import FILES
from horizonval.store.folder import read_json

RESULT, COSTS, PAGE = "study.json", "study-costs.json", "study.html"
REQUIREMENTS = FILES[0]
VERDICTS = {"meets": "● meets", "open": "○ too few frames to say", "fails": "✕ fails"}
MOST_LEVELS = 7
"""Maximum number of levels with separate markers."""
NAMED_COSTS = ("pixel_rate", "processor_s")
"""Costs that always have columns and figures."""
MOST_LABEL = 40
MOST_WORDY = 20
"""Number of designs above which only those on the front have numbers and bars."""
ERRORS = (
    ("bias_deg", "bias", "^"),
    ("noise_deg", "noise", "s"),
    ("p95_deg", "p95", "o"),
    ("three_sigma_deg", "3 sigma", "x"),
)
SHARES = (("availability", "answered", "o"), ("within", "answered within the limit", "D"))


def write_page(run_dir: Path) -> Path:
    """Write ``report/study.html`` of a finished study and return its path; ``DamagedFileError`` for a changed file."""
    result, costs = (
        _read(run_dir / RESULT, {"designs", "query", "prices"}),
        _read(run_dir / COSTS, {"designs", "query"}),
    )
    run = read_json(run_dir / "run.json") or {}
    seen: dict[str, Any] = {"frames": [], "kept": 0, "estimators": ()}
    if run:
        loaded = load_run(run_dir, MOST_BESIDE)
        seen = striking_frames(loaded.views, loaded.estimators)
    head = result["study"]
    text = page.render(
        PAGE,
        title=f"{head['name']}: designs compared",
        heading=head["title"] or head["name"],
        version=result["version"],
        about=[f"study {head['name']}"],
        links=[("frames and estimators", "index.html")],
        again=shlex.join(run.get("command") or ()),
        filters={"measure": _measure, "share": share, "term": term_words},
        requirements=read_json(run_dir / REQUIREMENTS),
        **page_of(result, costs),
        **seen,
    )
    path = run_dir / "report" / PAGE
    atomic.make_folder(path.parent)
    page.write(path, text)
    return path


def _read(path: Path, keys: set[str]) -> dict[str, Any]:
    data: dict[str, Any] = read_json(path, fix="run the study again") or {}
    if not keys <= set(data):
        raise DamagedFileError("not a study's result", where=str(path), fix="run the study again")
    return data


def page_of(result: JsonObject, costs: JsonObject) -> dict[str, Any]:
    """Return the template's content in addition to the study's numbers."""
    head, designs = result["study"], result["designs"]
    words = axis_words(result["axes"])
    clustered = result["clusters"] < result["conditions"]
    settings = {
        d["name"]: ", ".join(
            f"{word} = {level_words(d['settings'][key])}" for key, word in words.items() if key in d["settings"]
        )
        for d in designs
    }
    missed: Counter[str] = Counter()
    for d in designs:
        missed.update({cause: found["n"] for cause, found in d["misses"].items()})
    answers = (text[0].upper() + text[1:] for text in (result["query"]["text"], costs["query"]["text"]))
    return {
        "result": result,
        "costs": costs,
        "prices": result["prices"] or costs["prices"],
        "head": head,
        "headline": f"{count(len(designs), 'design')} under the same {count(result['conditions'], 'condition')}"
        + (f" from {count(result['clusters'], 'flight')}" if clustered else ""),
        "required": result["required"],
        "error_deg": f"{result['limit']['error_deg']:g}",
        "answers": list(dict.fromkeys(answers)),
        "settings": {name: found or name for name, found in settings.items()},
        "numbers": {d["name"]: d["number"] for d in designs},
        "verdicts": VERDICTS,
        "causes": sorted(missed, key=lambda cause: (-missed[cause], cause)),
        "by": None if head["cheapest_by"] in NAMED_COSTS else head["cheapest_by"],
        "figures": _figures(result, costs, words),
        "words": words,
        "effects_of": _effects_of(result["effects"]),
        "compare": shlex.join(["horizonval", "study", ".", "--compare", *(str(d["number"]) for d in designs[:2])]),
        "clustered": clustered,
    }


def axis_words(axes: Sequence[str]) -> dict[str, str]:
    """Return short names of the axes, the unit in brackets; the whole key where two would be equal."""
    short = {key: key_words(key) for key in axes}
    twice = {word for word in short.values() if list(short.values()).count(word) > 1}
    return {key: key if word in twice else word for key, word in short.items()}


def _figures(result: JsonObject, costs: JsonObject, words: Mapping[str, str]) -> list[dict[str, Any]]:
    designs, head, effects = result["designs"], result["study"], result["effects"]
    limit, availability = result["limit"]["error_deg"], result["limit"]["availability"]
    groups = _groups(result, words)
    few = len(designs) <= MOST_WORDY
    text = "Numbers are those of the designs in the tables below; bars hold 95 %."
    text += "" if few else " Designs behind the front have neither."
    height = 4.4 + 0.2 * (1 + len(dict.fromkeys(groups.values())) // 2)
    made = []

    def front(title: str, x_of: Mapping[str, JsonObject], names: Sequence[str], label: str, log_x: bool = True) -> None:
        drawn = pareto(designs, x_of, names, label, limit, groups, log_x)
        made.append(plots.figure(title, text, drawn, 5.6, height))

    rate = {d["name"]: {"value": d["pixel_rate"], "interval": None} for d in designs}
    front("Accuracy and pixel rate", rate, result["fronts"]["pixel_rate"], "pixel rate [pixels/s]")
    silent = {d["name"]: _complement(d["availability"]) for d in designs}
    label = "share of frames not answered"
    front("Accuracy and availability", silent, result["fronts"]["unavailability"], label, False)
    if any(found["value"] is not None for found in costs["designs"].values()):
        label = "processor time of an estimate [s]"
        front("Accuracy and processor time", costs["designs"], costs["front"], label)
    by, prices = head["cheapest_by"], result["prices"] or costs["prices"]
    if by not in NAMED_COSTS and any(price["value"] is not None for price in prices.values()):
        names = result["fronts"].get("price") or costs.get("price_front") or []
        front("Accuracy and cost", prices, names, f"cost: {by}" if len(by) <= MOST_LABEL else "cost", False)
    made.append(
        plots.figure(
            "Errors and shares by design",
            "Left: the errors of claims; right: shares of all frames. Dashed: what is required.",
            by_design(designs, limit, availability),
            10.0,
            1.6 + (0.34 if few else 0.21) * len(designs),
            wide=True,
        )
    )
    if effects is not None:
        made.append(
            plots.figure(
                "Which axis matters",
                "Filled: main effects; hatched: interactions of two axes, and what is left.",
                shares_of_variance(effects, words),
                5.6,
                1.4 + 0.34 * len(effects["terms"]),
            )
        )
        made.append(
            plots.figure(
                "What each level does",
                "Factor of each level on the error, against the mean of all designs; bars hold 95 %.",
                level_factors(effects, words),
                5.6,
                1.4 + 0.3 * sum(len(lines) for lines in effects["levels"].values()),
            )
        )
    return made


def _complement(found: JsonObject) -> JsonObject:
    rate, bounds = found["rate"], found["interval"]
    return {
        "value": None if rate is None else 1.0 - rate,
        "interval": None if bounds is None else [1.0 - bound for bound in reversed(bounds)],
    }


def _groups(result: JsonObject, words: Mapping[str, str]) -> dict[str, str]:
    """Return each design's word for its marker: its level on the most important axis with few levels."""
    designs, effects = result["designs"], result["effects"]
    terms = effects["terms"] if effects is not None else []
    axes = [term["axes"][0] for term in terms if len(term["axes"]) == 1 and term["axes"][0] in result["axes"]]
    for key in (*axes, "estimator"):
        levels = {d["name"]: level_words(d["settings"].get(key)) for d in designs}
        if 1 < len(set(levels.values())) <= MOST_LEVELS:
            return {name: f"{words.get(key, key)} = {level}" for name, level in levels.items()}
    return {d["name"]: "designs" for d in designs}


def _effects_of(effects: JsonObject | None) -> str:
    """Return the claims that the shares of the variance are based on."""
    if effects is None:
        return ""
    if effects["basis"] == "common":
        return f"over the {count(effects['n'], 'frame')} that all {effects['designs']} designs answered"
    return f"over each design's own claims ({effects['n']} at least), as too few frames were answered by all"


def _measure(found: JsonObject) -> dict[str, str]:
    """Return a number and its interval, which may be open above, in words."""
    if found["interval"] is None or found["interval"][1] is not None:
        return {"value": number(found["value"]), "interval": interval(found["interval"])}
    return {"value": number(found["value"]), "interval": f"above {number(found['interval'][0])}, open"}


# ------------------------------------------------------------------------------------------------------------ figures


def pareto(
    designs: Sequence[JsonObject],
    x_of: Mapping[str, JsonObject],
    front: Sequence[str],
    label: str,
    limit_deg: float,
    groups: Mapping[str, str],
    log_x: bool = True,
) -> Draw:
    """The p95 error of every design against a cost, with the front as a staircase.

    ``x_of``: ``{value, interval}`` of every design (None is omitted). ``front``: names on the front. ``label``: of the
    axis, with unit. ``groups``: word that selects a design's marker.
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
            # A log axis has no margin around a single value.
            axes.set_xlim(min(places) / 1.5, max(places) * 1.5)
        for d in shown:
            i, on = words.index(groups[d["name"]]), d["name"] in front
            x, y = x_of[d["name"]]["value"], d["p95_deg"]["value"]
            if on or len(shown) <= MOST_WORDY:
                axes.plot(_ends(x_of[d["name"]], x), [y, y], color="#8d949c", lw=0.8, zorder=1)
                axes.plot([x, x], _ends(d["p95_deg"], y), color="#8d949c", lw=0.8, zorder=1)
                axes.annotate(str(d["number"]), (x, y), xytext=(5, 4), textcoords="offset points", fontsize=8)
            colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
            axes.plot(x, y, marker, ms=7 if on else 5.5, color=colour, mfc=colour if on else "white", zorder=3)
        steps = sorted((x_of[d["name"]]["value"], d["p95_deg"]["value"]) for d in shown if d["name"] in front)
        if len(steps) > 1:
            axes.step(*zip(*steps, strict=True), where="post", color=INK, lw=1.0, ls="-", zorder=2)
        axes.axhline(limit_deg, **LIMIT)
        # After the data: an empty log axis warns.
        axes.set_yscale("log")
        plain_ticks(axes.yaxis)
        axes.set(xlabel=label, ylabel="p95 of the nadir error [deg]")
        handles = []
        for i, word in enumerate(words):
            colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
            handles.append(Line2D([], [], ls="", marker=marker, mfc="white", mec=colour, label=word))
        handles.append(Line2D([], [], color=INK, lw=1.0, marker="o", mfc=INK, label="front (filled)"))
        handles.append(Line2D([], [], **LIMIT, label=f"required: {limit_deg:g} deg"))
        figure.legend(handles=handles, loc="outside lower center", ncols=2, fontsize=SMALL)
        axes.set_title(f"n = {len(shown)} of {len(designs)} designs", loc="left", fontsize=SMALL)

    return draw


def by_design(designs: Sequence[JsonObject], limit_deg: float, availability: float | None) -> Draw:
    """Errors of claims, and shares of frames, one line a design."""

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True, gridspec_kw={"width_ratios": [1.4, 1.0]})
        lines = np.arange(len(designs))
        for k, (key, word, marker) in enumerate(ERRORS):
            _dots(left, lines, [d[key] for d in designs], "value", k, marker, word)
        left.set_xscale("log")
        plain_ticks(left.xaxis)
        left.axvline(limit_deg, **LIMIT)
        left.set_xlabel("error of claims [deg]")
        for k, (key, word, marker) in enumerate(SHARES):
            _dots(right, lines, [d[key] for d in designs], "rate", k, marker, word)
        if availability is not None:
            right.axvline(availability, **LIMIT)
        right.set(xlabel="share of all frames", xlim=(-0.02, 1.02))
        left.set(yticks=lines, yticklabels=[f"{d['number']}  n = {d['n']}" for d in designs])
        left.set_ylim(len(designs) - 0.5, -0.5)
        figure.legend(
            handles=[*left.get_legend_handles_labels()[0], *right.get_legend_handles_labels()[0]],
            loc="outside upper left",
            ncols=3,
            fontsize=SMALL,
        )

    return draw


def shares_of_variance(effects: JsonObject, words: Mapping[str, str]) -> Draw:
    """Share of the variance of the log error of each axis and each pair of axes."""

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
    """Factor by which every level of every axis multiplies the error."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        names, at = [], 0
        for k, (key, levels) in enumerate(effects["levels"].items()):
            for line in levels:
                colour = COLOURS[k % len(COLOURS)]
                if line["interval"] is not None:
                    axes.plot(line["interval"], [at, at], color=colour, lw=1.2)
                axes.scatter(line["factor"], at, color=colour, marker=MARKERS[k % len(MARKERS)], s=30)
                names.append(f"{words.get(key, key)} = {level_words(line['level'])}")
                at += 1
            if at < sum(len(v) for v in effects["levels"].values()):
                axes.axhline(at - 0.5, color="#d9dde2", lw=0.8)
        axes.set_xscale("log")
        plain_ticks(axes.xaxis)
        low, high = axes.get_xlim()
        axes.set_xlim(min(low, 0.5), max(high, 2.0))
        axes.axvline(1.0, color=GREY, lw=0.9)
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


def _ends(found: JsonObject, value: float) -> list[float]:
    """Return the ends of a number's error bar; an open or missing end is at the number."""
    known = [value, *(bound for bound in found["interval"] or () if bound is not None)]
    return [min(known), max(known)]


def _dots(axes: Axes, lines: Any, found: Sequence[JsonObject], key: str, index: int, marker: str, word: str) -> None:
    colour = COLOURS[index % len(COLOURS)]
    known = [(line + (index - 1) * 0.16, one) for line, one in zip(lines, found, strict=True) if one[key] is not None]
    for y, one in known:
        axes.plot(_ends(one, one[key]), [y, y], color=colour, lw=0.9)
    x, face = [one[key] for _, one in known], "white" if index % 2 and marker != "x" else colour
    axes.plot(x, [y for y, _ in known], marker, color=colour, mfc=face, ms=5, zorder=3, label=word)
