"""From the rows of results to ``study.json``, ``designs.csv`` and ``study-costs.json`` of a study.

The first two have the same bytes for the same study, version and frames; processor times are in the third.

A design *meets* what is required if it meets every requirement (:mod:`horizonval.scoring.requirements`), *fails* if
it fails one, and is *open* otherwise. Without a miss, n independent frames show an availability A only if A^n <= 5 %:
99 % takes 299. Bounds are not adjusted for the number of designs.
"""

from __future__ import annotations

import csv
import io
import math
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.scoring import requirements as requirement_files
from horizonval.scoring.requirements import frames_needed, judge, judged, worst
from horizonval.scoring.row import Row, read_results
from horizonval.spec.requirement import Requirement
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.studies.trade import cost
from horizonval.studies.trade.cost import MEASURES, SHARES, Expression, is_tie
from horizonval.studies.trade.design import PLAN_FILE, Design, StudyPlan, limit_of
from horizonval.studies.trade.effects import compare, effects_of, front
from horizonval.studies.trade.sample import (
    Sample,
    cluster_draws,
    measures_of,
    misses_of,
    sample_of,
    words_of,
)


def cheapest(
    designs: Sequence[Mapping[str, Any]],
    requirements: Sequence[Requirement],
    by: str,
    prices: Mapping[str, JsonObject],
) -> JsonObject:
    """Return the cheapest design that meets all requirements, and the designs that come close.

    ``designs``: ``name``, ``judged`` (:func:`horizonval.scoring.requirements.judge` of every requirement) and
    ``misses`` (:func:`horizonval.studies.trade.sample.misses_of`) of each. ``by``: expression of the price. ``prices``:
    by name (:func:`horizonval.studies.trade.cost.price_of`); designs without a price come last.

    Returns
    -------
    dict
        ``meets``, ``open``, ``fails``: names, cheapest first. ``cheapest``: the first that meets, or None; ``tied``:
        all that meet at an indistinguishable cost. ``candidate``: the cheapest open one whose measured shares reach
        what is required, or None; ``tied_candidates``. ``closest``: the one whose smallest share less what is required
        is largest, the first of ``tied_closest``. ``needed``: frames without a miss that would show all requirements.
        ``misses``: by name. ``text``: in words.
    """
    weakest = {design["name"]: _weakest(design["judged"], requirements) for design in designs}

    def place(design: Mapping[str, Any]) -> tuple[float, float, str]:
        value = prices[design["name"]]["value"]
        return (math.inf if value is None else value, -weakest[design["name"]].margin, design["name"])

    def tied_with_first(names: Sequence[str]) -> list[str]:
        return [name for name in names if is_tie(prices[names[0]], prices[name])]

    ordered = sorted(designs, key=place)
    by_verdict: dict[str, list[str]] = {"meets": [], "open": [], "fails": []}
    for design in ordered:
        by_verdict[worst([one["verdict"] for one in design["judged"]])].append(design["name"])
    candidates = [name for name in by_verdict["open"] if weakest[name].margin >= 0.0]
    best = max((one.margin for one in weakest.values()), default=0.0)
    closest = [name for name, one in weakest.items() if one.margin == best]
    needed = [frames_needed(one.share, one.confidence) or 0 for one in requirements]
    answer: JsonObject = {
        **by_verdict,
        "required": required_words(requirements),
        "by": by,
        "cheapest": by_verdict["meets"][0] if by_verdict["meets"] else None,
        "tied": tied_with_first(by_verdict["meets"]),
        "candidate": candidates[0] if candidates else None,
        "tied_candidates": tied_with_first(candidates),
        "closest": closest[0] if closest else None,
        "tied_closest": closest,
        "needed": max(needed),
        "misses": {design["name"]: design["misses"] for design in designs},
    }
    return answer | {"text": _text(answer, weakest, prices)}


def required_words(requirements: Sequence[Requirement]) -> str:
    """Return requirements as a phrase: the only one in words, or their number."""
    return requirements[0].in_words if len(requirements) == 1 else f"all {len(requirements)} requirements"


@dataclass(frozen=True)
class _Weakest:
    """The share of a design that is least above what is required, by ``margin``; ``words`` say what it counts."""

    margin: float
    words: str
    found: JsonObject


def _weakest(judged: Sequence[JsonObject], requirements: Sequence[Requirement]) -> _Weakest:
    several = len(requirements) > 1
    shares = [
        _Weakest(
            (one["rate"] or 0.0) - required.share,
            f"{required.counted}{f' ({required.id})' if several else ''}",
            one,
        )
        for required, found in zip(requirements, judged, strict=True)
        for one in found["evidence"]
    ]
    return min(shares, key=lambda share: share.margin)


BY_WORDS = {"pixel_rate": "pixel rate", "processor_s": "processor time"}
MOST_NAMED = 6


def _text(answer: JsonObject, weakest: Mapping[str, _Weakest], prices: Mapping[str, JsonObject]) -> str:
    required = answer["required"]
    by = BY_WORDS.get(answer["by"], answer["by"])

    def share(name: str) -> str:
        found = weakest[name].found
        if not found["of"]:
            return f"no {weakest[name].words}"
        return (
            f"{found['n']} of {found['of']} {weakest[name].words}, "
            f"95 % interval {100 * found['interval'][0]:.1f} to {100 * found['interval'][1]:.1f} %"
        )

    def named(names: Sequence[str]) -> str:
        if not names[1:]:
            return f"{names[0]} ({share(names[0])})"
        shares = [weakest[name].found for name in names[:MOST_NAMED]]
        words = [f"{name} ({found['n']} of {found['of']})" for name, found in zip(names, shares, strict=False)]
        if len(names) > MOST_NAMED:
            words.append(f"{len(names) - MOST_NAMED} more")
        return f"{', '.join(words)}: {len(names)} designs {_tie([prices[name] for name in names])}"

    if not weakest:
        return "no design has a result"
    if answer["cheapest"] is not None:
        verb = "meet" if answer["tied"][1:] else "meets"
        parts = [f"cheapest by {by} that {verb} {required}: {named(answer['tied'])}"]
        if answer["candidate"] is not None and _is_cheaper(answer, prices):
            parts.append(f"cheaper ones may meet it, too few frames to say: {', '.join(answer['tied_candidates'])}")
        return "; ".join(parts)
    if answer["candidate"] is not None:
        worth = weakest[answer["candidate"]].found["effective"]
        return (
            f"none is shown to meet {required}: the sample is too small to say. Cheapest by {by} that may: "
            f"{named(answer['tied_candidates'])}; {'its' if not answer['tied_candidates'][1:] else 'their'} sample is "
            f"worth {worth:.0f} independent frames, {answer['needed']} without a miss would show it"
        )
    closest = answer["closest"]
    others = answer["tied_closest"][1:]
    alike = f"; as close: {', '.join(others[:MOST_NAMED])}" if others else ""
    more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
    missed = f"Closest: {closest} ({share(closest)}), missed by {words_of(answer['misses'][closest])}{alike}{more}"
    if answer["open"]:
        return (
            f"none is shown to meet {required}, and none reached it here; not excluded: {len(answer['open'])} of "
            f"{len(weakest)} designs. {missed}"
        )
    return f"none meets {required}. {missed}"


def _tie(prices: Sequence[JsonObject]) -> str:
    """Return the reason of a tie: equal costs, or uncertain ones."""
    values = [price["value"] for price in prices]
    if None in values:
        return "without a cost"
    low, high = min(values), max(values)
    if math.isclose(low, high, rel_tol=1e-9) and all(price["interval"] is None and price["known"] for price in prices):
        return f"at the same cost, {low:.4g}"
    return f"whose costs, {low:.3g} to {high:.3g}, their uncertainty does not tell apart"


def _is_cheaper(answer: JsonObject, prices: Mapping[str, JsonObject]) -> bool:
    """Whether the candidate costs significantly less than the cheapest that meets."""
    candidate, meets = prices[answer["candidate"]], prices[answer["cheapest"]]
    if candidate["value"] is None or meets["value"] is None:
        return candidate["value"] is not None
    return bool(candidate["value"] < meets["value"] and not is_tie(candidate, meets))


RESULT = "study.json"
TABLE = "designs.csv"
RESULT_SCHEMA = 1


@dataclass(frozen=True)
class Data:
    """The samples of a study's designs, and the draws of its conditions."""

    plan: StudyPlan
    samples: dict[str, Sample]
    draws: FloatArray
    frames: dict[str, list[tuple[str, int]]]
    failed: tuple[str, ...]
    version: str

    def compare(self, first: str, second: str, error_deg: float) -> JsonObject:
        """Return the paired difference of two designs, by name or number. Raises ``UserError``: no such design."""
        a, b = (self.plan.design(name, "--compare").name for name in (first, second))
        comparison = compare(self.samples[a], self.samples[b], self.draws, error_deg)
        return {"a": a, "b": b, "error_deg": error_deg, **comparison}


def read_data(plan: StudyPlan, root: Path) -> Data:
    """Return the results of a study. Raises ``UserError``: no results, or those of another study."""
    folder = RunFolder(root)
    summary = read_json(folder.summary) or {}
    rows = read_results(folder.results)
    by_design: dict[tuple[str, str], list[tuple[str, Row]]] = {}
    for row in rows:
        entry, condition = plan.frames.get(row.case, ("", ""))
        if entry:
            by_design.setdefault((entry, row.estimator), []).append((condition, row))
    order = sorted(set(plan.conditions.values()))
    timings = cost.read_timings(root)
    samples, frames = {}, {}
    for design in plan.designs:
        design_rows = by_design.get((design.frames, design.estimator), [])
        if not design_rows:
            raise UserError(f"no results of design {design.name!r}", where=str(root), fix="run the study again")
        bands = sorted({row.band for _, row in design_rows})
        keyed = {condition if len(bands) == 1 else f"{condition} {row.band}": row for condition, row in design_rows}
        cluster = {
            condition if len(bands) == 1 else f"{condition} {row.band}": order.index(plan.conditions[condition])
            for condition, row in design_rows
        }
        seconds = {
            key: timings[row.case][stage] / len(bands)
            for key, row in keyed.items()
            if (stage := cost.PROCESSOR + design.estimator) in timings.get(row.case, {})
        }
        samples[design.name] = sample_of(keyed, cluster, seconds)
        frames[design.name] = [(row.case, len(bands)) for _, row in design_rows]
    draws = cluster_draws(len(order), plan.head.name, plan.head.seed)
    return Data(plan, samples, draws, frames, tuple(summary.get("failed") or ()), str(summary.get("version") or ""))


def conclude(data: Data, root: Path) -> tuple[JsonObject, JsonObject]:
    """Compute and write the results of a study; return them and the costs."""
    plan = data.plan
    untimed = [one for one in plan.requirements if one.latency_s is None]
    designs = [_design(number, design, data, untimed) for number, design in enumerate(plan.designs, start=1)]
    costs = _costs(data, root)
    price = cost.read_price(plan.head.cheapest_by, plan.designs[0].costs, f"{root / PLAN_FILE}: study.cheapest_by")
    timed = cost.is_timed(price)
    prices = prices_of(designs, price, costs["designs"])
    p95 = {design["name"]: design["p95_deg"]["value"] for design in designs}
    chosen = _front(designs, p95, {design["name"]: design["pixel_rate"] for design in designs})
    result: JsonObject = {
        "schema": RESULT_SCHEMA,
        "version": data.version,
        "study": plan.head.model_dump(mode="json"),
        "required": required_words(plan.requirements),
        "limit": plan.limit.model_dump(mode="json"),
        "conditions": len(plan.conditions),
        "clusters": int(data.draws.shape[1]),
        "failed": list(data.failed),
        "axes": list(dict.fromkeys(key for design in plan.designs for key in design.settings)),
        "designs": designs,
        "fronts": {
            "pixel_rate": chosen,
            **({} if timed else {"price": _front(designs, p95, _values(prices))}),
            "unavailability": _front(designs, p95, {d["name"]: -(d["availability"]["rate"] or 0.0) for d in designs}),
        },
        "effects": effects_of([(d.name, d.settings, data.samples[d.name]) for d in plan.designs], data.draws),
        "pairs": [data.compare(a, b, plan.limit_deg) for a, b in _neighbours(designs, chosen)],
        "prices": None if timed else prices,
        "query": query(data, designs, untimed, "pixel_rate" if timed else price.text, costs["designs"]),
    }
    costs |= {
        "front": _front(designs, p95, _values(costs["designs"])),
        "prices": prices if timed else None,
        "price_front": _front(designs, p95, _values(prices)) if timed else None,
        "query": query(data, designs, plan.requirements, price.text if timed else cost.SECONDS, costs["designs"]),
    }
    requirement_files.write(root, plan.head.name, judged(plan.requirements, data.samples))
    write_json(root / RESULT, result)
    write_json(root / cost.COSTS_FILE, costs)
    _write_table(root / TABLE, designs, result["axes"], result["prices"])
    return result, costs


def files_of_study(root: Path) -> list[Path]:
    """Return the result files of a study."""
    return [root / name for name in (PLAN_FILE, RESULT, cost.COSTS_FILE, TABLE, *requirement_files.FILES)]


def query(
    data: Data,
    designs: Sequence[JsonObject],
    requirements: Sequence[Requirement],
    by: str,
    seconds: Mapping[str, JsonObject],
    where: str = "study.cheapest_by",
) -> JsonObject:
    """Return the cheapest design for any requirements and price expression.

    ``seconds``: processor times of the designs. Raises ``UserError``, naming ``where``: ``by`` is not an expression.
    """
    limit = limit_of(requirements)
    shares = [
        {
            "name": design["name"],
            "judged": [judge(one, data.samples[design["name"]]) for one in requirements],
            "misses": misses_of(data.samples[design["name"]], limit.error_deg or math.inf),
        }
        for design in designs
    ]
    price = cost.read_price(by, data.plan.designs[0].costs, where)
    return cheapest(shares, requirements, price.text, prices_of(designs, price, seconds))


def prices_of(
    designs: Sequence[JsonObject], price: Expression, seconds: Mapping[str, JsonObject]
) -> dict[str, JsonObject]:
    """Return what each design costs, by name."""
    return {d["name"]: cost.price_of(price, cost.columns_of(d, seconds[d["name"]])) for d in designs}


def _values(prices: Mapping[str, JsonObject]) -> dict[str, float | None]:
    return {name: price["value"] for name, price in prices.items()}


def _design(number: int, design: Design, data: Data, untimed: Sequence[Requirement]) -> JsonObject:
    sample, limit_deg = data.samples[design.name], data.plan.limit_deg
    pixels = design.width * design.height * design.heads
    return {
        "number": number,
        **asdict(design),
        "pixels": pixels,
        "pixel_rate": pixels * data.plan.head.frame_rate_hz,
        **measures_of(sample, data.draws, limit_deg),
        "misses": misses_of(sample, limit_deg),
        "verdict": worst([judge(one, sample)["verdict"] for one in untimed]),
    }


def _costs(data: Data, root: Path) -> JsonObject:
    timings = cost.read_timings(root)
    return {
        "machine": f"{platform.machine()}, {os.cpu_count()} processors",
        "frames_s": round(cost.all_stages(timings), 2),
        "frames": len(timings),
        "designs": {
            design.name: cost.cost_of(data.frames[design.name], design.estimator, timings)
            for design in data.plan.designs
        },
    }


def _front(
    designs: Sequence[JsonObject], error: Mapping[str, float | None], against: Mapping[str, float | None]
) -> list[str]:
    names = [design["name"] for design in designs]
    kept = front([(error[name], against[name]) for name in names])
    return [name for name, is_on in zip(names, kept, strict=True) if is_on]


def _neighbours(designs: Sequence[JsonObject], chosen: Sequence[str]) -> list[tuple[str, str]]:
    """Return neighbouring pairs on a front, from the most pixels to the fewest."""
    on = sorted((d for d in designs if d["name"] in chosen), key=lambda d: (-d["pixel_rate"], d["name"]))
    return [(a["name"], b["name"]) for a, b in pairwise(on)]


def _write_table(
    path: Path, designs: Sequence[JsonObject], axes: Sequence[str], prices: Mapping[str, JsonObject] | None
) -> None:
    costs = list(designs[0]["costs"])
    header = ["number", "design", *axes, "camera", "estimator_name", "n", "clusters", "claims", "pixels"]
    header += ["pixels_per_s"]
    header += [f"{name}{end}" for name in MEASURES for end in ("", "_low", "_high", "_n")]
    header += [f"{name}{end}" for name in SHARES for end in ("", "_low", "_high", "_n", "_of")]
    header += [*costs, *([] if prices is None else ["cost"]), "missed_by", "verdict"]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    for d in designs:
        line = [d["number"], d["name"], *(d["settings"].get(key, "") for key in axes), d["camera"], d["estimator"]]
        line += [d["n"], d["clusters"], d["claims"], d["pixels"], d["pixel_rate"]]
        for name in MEASURES:
            low, high = d[name]["interval"] or (None, None)
            line += [d[name]["value"], low, high, d[name]["n"]]
        for name in SHARES:
            low, high = d[name]["interval"] or (None, None)
            line += [d[name]["rate"], low, high, d[name]["n"], d[name]["of"]]
        line += [*(d["costs"][key] for key in costs), *([] if prices is None else [prices[d["name"]]["value"]])]
        line += [words_of(d["misses"]), d["verdict"]]
        writer.writerow(["" if value is None else value for value in line])
    atomic.write_text(path, text.getvalue())
