"""The page of a trade study: made of ``study.json`` and ``study-costs.json`` alone."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from horizonval.core.errors import DamagedFileError
from horizonval.core.json_types import JsonObject
from horizonval.report import template
from horizonval.report.figures import plots
from horizonval.report.figures import study_plots as draw
from horizonval.report.formatting import count, interval, number, percent
from horizonval.report.frames_on_demand import MOST_BESIDE, striking_frames
from horizonval.report.load import load_run
from horizonval.report.sentence import sentences
from horizonval.scoring.summary import summarise
from horizonval.store.folder import read_json

RESULT, COSTS, PAGE = "study.json", "study-costs.json", "study.html"
GLYPHS = {"meets": "●", "open": "○", "fails": "✕"}
VERDICTS = {"meets": "meets", "open": "too few frames to say", "fails": "fails"}
MOST_LEVELS = 7
"""As many as there are markers."""
NAMED_COSTS = ("pixel_rate", "processor_s")
"""Costs that the page has columns and figures of in any case."""
MOST_LABEL = 40
DASH = "\N{EN DASH}"
ERROR_COLUMNS = ("bias_deg", "noise_deg", "rms_deg", "p95_deg", "three_sigma_deg")
UNITS = {"_deg": "deg", "_px": "px", "_um": "µm", "_mm": "mm", "_s": "s", "_km": "km", "_h": "h", "_k": "K"}


def write_page(run_dir: Path) -> Path:
    """Write ``report/study.html`` of a finished study and return its path.

    Raises
    ------
    DamagedFileError
        A file of the study is not what it writes.
    """
    result, costs = (
        _read(run_dir / RESULT, {"designs", "query", "prices"}),
        _read(run_dir / COSTS, {"designs", "query"}),
    )
    run = read_json(run_dir / "run.json") or {}
    seen: dict[str, Any] = {"sentences": [], "frames": [], "kept": 0}
    if run:
        loaded = load_run(run_dir, MOST_BESIDE)
        groups = summarise(loaded.rows, loaded.given_pose, loaded.orbit)["groups"]
        seen = {"sentences": sentences(loaded, groups), **striking_frames(loaded)}
    text = (
        template.environment()
        .get_template(PAGE)
        .render(**page_of(result, costs), **seen, again=shlex.join(run.get("command") or ()), **template.shared_parts())
    )
    path = run_dir / "report" / PAGE
    path.parent.mkdir(exist_ok=True)
    template.write(path, text)
    return path


def _read(path: Path, keys: set[str]) -> dict[str, Any]:
    data: dict[str, Any] = read_json(path, fix="run the study again") or {}
    if not keys <= set(data):
        raise DamagedFileError("not a study's result", where=str(path), fix="run the study again")
    return data


def page_of(result: JsonObject, costs: JsonObject) -> dict[str, Any]:
    """Return everything the template shows."""
    head, designs = result["study"], result["designs"]
    words = axis_words(result["axes"])
    required = head["requirement"]
    prices = result["prices"] or costs["prices"]
    clustered = result["clusters"] < result["conditions"]
    return {
        "head": head,
        "version": result["version"],
        "headline": f"{count(len(designs), 'design')} under the same {count(result['conditions'], 'condition')}"
        + (f" from {count(result['clusters'], 'flight')}" if clustered else ""),
        "required": f"{required['error_deg']:g} deg in {100 * required['availability']:g} % of all conditions",
        "error_deg": f"{required['error_deg']:g}",
        "answers": list(
            dict.fromkeys(text[0].upper() + text[1:] for text in (result["query"]["text"], costs["query"]["text"]))
        ),
        "needed": result["query"]["needed"],
        "misses": _misses(designs, words),
        "by": None if head["cheapest_by"] in NAMED_COSTS else head["cheapest_by"],
        "given": list(designs[0]["costs"]),
        "figures": _figures(result, costs, words),
        "effects": _effects(result["effects"], words),
        "lines": [_line(d, costs["designs"][d["name"]], prices[d["name"]], words) for d in designs],
        "compare": shlex.join(["horizonval", "study", ".", "--compare", *(str(d["number"]) for d in designs[:2])]),
        "pairs": [_pair(pair, designs) for pair in result["pairs"]],
        "failed": result["failed"],
        "machine": costs["machine"],
        "frames_s": number(costs["frames_s"]),
        "timed": costs["frames"],
        "clustered": clustered,
    }


def axis_words(axes: Sequence[str]) -> dict[str, str]:
    """Return short words for the axes, the unit in brackets; the whole key where two would be alike."""
    short = {key: _word(key.rpartition(".")[2]) for key in axes}
    twice = {word for word in short.values() if list(short.values()).count(word) > 1}
    return {key: key if word in twice else word for key, word in short.items()}


def _word(key: str) -> str:
    for ending, unit in UNITS.items():
        if key.endswith(ending):
            return f"{key.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return {"width": "width [px]", "height": "height [px]"}.get(key, key.replace("_", " "))


def _figures(result: JsonObject, costs: JsonObject, words: Mapping[str, str]) -> list[dict[str, str]]:
    designs, head = result["designs"], result["study"]
    limit, availability = head["requirement"]["error_deg"], head["requirement"]["availability"]
    groups = _groups(result, words)
    few = len(designs) <= draw.MOST_WORDY
    rows = 1 + len(dict.fromkeys(groups.values())) // 2
    rate = {d["name"]: {"value": d["pixel_rate"], "interval": None} for d in designs}
    unanswered = {
        d["name"]: {
            "value": None if d["availability"]["rate"] is None else 1.0 - d["availability"]["rate"],
            "interval": None
            if d["availability"]["interval"] is None
            else [1.0 - b for b in reversed(d["availability"]["interval"])],
        }
        for d in designs
    }
    fronts = [
        ("Accuracy and pixel rate", draw.pareto(
            designs, rate, result["fronts"]["pixel_rate"], "pixel rate [pixels/s]", limit, groups)),
        ("Accuracy and availability", draw.pareto(
            designs, unanswered, result["fronts"]["unavailability"], "share of frames not answered", limit, groups,
            log_x=False)),
    ]  # fmt: skip
    if any(found["value"] is not None for found in costs["designs"].values()):
        label = "processor time of an estimate [s]"
        drawn = draw.pareto(designs, costs["designs"], costs["front"], label, limit, groups)
        fronts.append(("Accuracy and processor time", drawn))
    by, prices = head["cheapest_by"], result["prices"] or costs["prices"]
    if by not in NAMED_COSTS and any(price["value"] is not None for price in prices.values()):
        chosen = result["fronts"].get("price") or costs.get("price_front") or []
        label = f"cost: {by}" if len(by) <= MOST_LABEL else "cost"
        fronts.append(("Accuracy and cost", draw.pareto(designs, prices, chosen, label, limit, groups, log_x=False)))
    made = [
        {
            "uri": plots.figure_uri(drawn, 5.6, 4.4 + 0.2 * rows),
            "title": title,
            "text": "Numbers are those of the designs in the tables below; bars hold 95 %."
            + ("" if few else " Designs behind the front have neither."),
            "wide": "",
        }
        for title, drawn in fronts
    ]
    made.append(
        {
            "uri": plots.figure_uri(
                draw.by_design(designs, limit, availability), 10.0, 1.6 + (0.34 if few else 0.21) * len(designs)
            ),
            "title": "Errors and shares by design",
            "text": "Left: the errors of claims; right: shares of all frames. Dashed: what is required.",
            "wide": " wide",
        }
    )
    effects = result["effects"]
    if effects is not None:
        levels = sum(len(lines) for lines in effects["levels"].values())
        made.append(
            {
                "uri": plots.figure_uri(
                    draw.shares_of_variance(effects, words), 5.6, 1.4 + 0.34 * len(effects["terms"])
                ),
                "title": "Which axis matters",
                "text": "Filled: main effects; hatched: interactions of two axes, and what is left.",
                "wide": "",
            }
        )
        made.append(
            {
                "uri": plots.figure_uri(draw.level_factors(effects, words), 5.6, 1.4 + 0.3 * levels),
                "title": "What each level does",
                "text": "Factor of each level on the error, against the mean of all designs; bars hold 95 %.",
                "wide": "",
            }
        )
    return made


def _groups(result: JsonObject, words: Mapping[str, str]) -> dict[str, str]:
    """Return the word whose marker each design carries: its level on the axis that matters most, of few levels."""
    designs, effects = result["designs"], result["effects"]
    terms = effects["terms"] if effects is not None else []
    axes = [term["axes"][0] for term in terms if len(term["axes"]) == 1 and term["axes"][0] in result["axes"]]
    for key in (*axes, "estimator"):
        levels = {d["name"]: draw.level_words(d["settings"].get(key)) for d in designs}
        if 1 < len(set(levels.values())) <= MOST_LEVELS:
            return {name: f"{words.get(key, key)} = {level}" for name, level in levels.items()}
    return {d["name"]: "designs" for d in designs}


def _effects(effects: JsonObject | None, words: Mapping[str, str]) -> dict[str, Any] | None:
    if effects is None:
        return None
    common = effects["basis"] == "common"
    text = (
        f"over the {count(effects['n'], 'frame')} that all {effects['designs']} designs answered"
        if common
        else f"over each design's own claims ({effects['n']} at least), as too few frames were answered by all"
    )
    return {
        "text": text,
        "left_out": effects["left_out"],
        "complete": effects["complete"],
        "terms": [
            {
                "name": draw.term_words(term, words),
                "dof": term["dof"],
                "share": percent(term["share"]["value"]),
                "interval": interval(term["share"]["interval"], as_percent=True),
            }
            for term in effects["terms"]
        ],
    }


def _misses(designs: Sequence[JsonObject], words: Mapping[str, str]) -> JsonObject:
    """Return the table of why frames were missed: ``causes``, and by design the cells under them."""
    total: Counter[str] = Counter()
    for d in designs:
        total.update({cause: found["n"] for cause, found in d["misses"].items()})
    causes = sorted(total, key=lambda cause: (-total[cause], cause))
    return {
        "causes": causes,
        "lines": [
            {
                "number": d["number"],
                "name": _settings(d, words) or d["name"],
                "n": d["n"],
                "missed": sum(found["n"] for found in d["misses"].values()),
                "cells": [d["misses"].get(cause) for cause in causes],
            }
            for d in designs
        ],
    }


def _settings(d: JsonObject, words: Mapping[str, str]) -> str:
    return ", ".join(
        f"{word} = {draw.level_words(d['settings'][key])}" for key, word in words.items() if key in d["settings"]
    )


def _line(d: JsonObject, cost: JsonObject, price: JsonObject, words: Mapping[str, str]) -> dict[str, Any]:
    return {
        "number": d["number"],
        "name": d["name"],
        "settings": _settings(d, words),
        "camera": d["camera"],
        "n": d["n"],
        "claims": d["claims"],
        "errors": [(key, _measure(d[key])) for key in ERROR_COLUMNS],
        "exclusion": _measure(d["exclusion_deg"]) | _none_right(d["exclusion_deg"]),
        "shares": {key: _share(d[key]) for key in ("availability", "answered_due", "within", "false_valid")},
        "pixels": f"{d['pixels']:,}".replace(",", "\N{NARROW NO-BREAK SPACE}"),
        "pixel_rate": number(d["pixel_rate"], 4),
        "cost": _measure(cost),
        "price": {
            "value": number(price["value"], 4),
            "interval": interval(price["interval"]),
            "given": ", ".join(f"{name} {number(value, 4)}" for name, value in d["costs"].items()),
        },
        "verdict": f"{GLYPHS[d['verdict']]} {VERDICTS[d['verdict']]}",
    }


def _none_right(found: JsonObject) -> dict[str, str]:
    """Say it where even the widest angle has a wrong answer."""
    return {"value": "none"} if found["value"] is None and found["n"] else {}


def _measure(found: JsonObject) -> dict[str, Any]:
    low, high = found["interval"] or (None, None)
    words = ""
    if found["interval"] is not None:
        words = f"{number(low)} to {number(high)}" if high is not None else f"above {number(low)}, open"
    return {"value": number(found["value"]), "interval": words, "n": found["n"]}


def _share(found: JsonObject) -> dict[str, str]:
    if not found["of"]:
        return {"rate": DASH, "of": "none", "interval": ""}
    return {
        "rate": percent(found["rate"]),
        "of": f"{found['n']} of {found['of']}",
        "interval": interval(found["interval"], as_percent=True),
    }


def _pair(pair: JsonObject, designs: Sequence[JsonObject]) -> dict[str, Any]:
    numbers = {d["name"]: d["number"] for d in designs}
    return {
        "a": numbers[pair["a"]],
        "b": numbers[pair["b"]],
        "names": f"{pair['a']}, {pair['b']}",
        "n": pair["n"],
        "both": pair["both"],
        "difference": _with(pair["mean_difference_deg"]),
        "ratio": _with(pair["typical_ratio"]),
        "correlation": number(pair["correlation"], 2),
        **{key: _odd_one_out(pair[key]) for key in ("answered", "within")},
    }


def _with(found: JsonObject) -> dict[str, str]:
    return {"value": number(found["value"]), "interval": interval(found["interval"])}


def _odd_one_out(found: JsonObject) -> dict[str, str]:
    p = f"p = {number(found['p'], 2)}" if found["p"] is not None else "no difference"
    return {"counts": f"{found['only_a']}, {found['only_b']}", "p": p}
