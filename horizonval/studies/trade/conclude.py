"""From the rows of results to what the designs deliver: ``study.json``, ``designs.csv``, ``study-costs.json``.

The first two are the same bytes for the same study, version and frames; times of processors are in the third.
"""

from __future__ import annotations

import csv
import io
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

from horizonval.core import atomic
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.scoring.row import Row, read_results
from horizonval.spec.suite import Requirement
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.studies.trade import cost
from horizonval.studies.trade.compare import compare
from horizonval.studies.trade.cost import MEASURES, SHARES
from horizonval.studies.trade.design import Design
from horizonval.studies.trade.effects import effects_of
from horizonval.studies.trade.expression import Expression
from horizonval.studies.trade.measures import measures_of
from horizonval.studies.trade.misses import misses_of, words_of
from horizonval.studies.trade.pareto import front
from horizonval.studies.trade.plan import FILE, StudyPlan
from horizonval.studies.trade.query import cheapest, verdict_of
from horizonval.studies.trade.sample import Sample, cluster_draws, sample_of

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
        """Return the paired difference of two designs, by name or number.

        Raises
        ------
        UserError
            There is no such design.
        """
        a, b = (self.plan.design(name, "--compare").name for name in (first, second))
        comparison = compare(self.samples[a], self.samples[b], self.draws, error_deg)
        return {"a": a, "b": b, "error_deg": error_deg, **comparison}


def read_data(plan: StudyPlan, root: Path) -> Data:
    """Return the results of a study whose frames are made.

    Raises
    ------
    UserError
        There are no results, or not those of this study.
    """
    folder = RunFolder(root)
    summary = read_json(folder.summary) or {}
    rows = read_results(folder.results)
    by_design: dict[tuple[str, str], list[tuple[str, Row]]] = {}
    for row in rows:
        entry, condition = plan.frames.get(row.case, ("", ""))
        if entry:
            by_design.setdefault((entry, row.estimator), []).append((condition, row))
    order = sorted(set(plan.conditions.values()))
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
        samples[design.name] = sample_of(keyed, cluster)
        frames[design.name] = [(row.case, len(bands)) for _, row in design_rows]
    draws = cluster_draws(len(order), plan.head.name, plan.head.seed)
    return Data(plan, samples, draws, frames, tuple(summary.get("failed") or ()), str(summary.get("version") or ""))


def conclude(data: Data, root: Path) -> tuple[JsonObject, JsonObject]:
    """Work out and write the results of a study; return them and the costs."""
    plan, requirement = data.plan, data.plan.requirement
    designs = [_design(number, design, data) for number, design in enumerate(plan.designs, start=1)]
    costs = _costs(data, root)
    price = cost.read_price(plan.head.cheapest_by, plan.designs[0].costs, f"{root / FILE}: study.cheapest_by")
    timed = cost.is_timed(price)
    prices = prices_of(designs, price, costs["designs"])
    p95 = {design["name"]: design["p95_deg"]["value"] for design in designs}
    chosen = _front(designs, p95, {design["name"]: design["pixel_rate"] for design in designs})
    result: JsonObject = {
        "schema": RESULT_SCHEMA,
        "version": data.version,
        "study": plan.head.model_dump(mode="json"),
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
        "pairs": [data.compare(a, b, requirement.error_deg) for a, b in _neighbours(designs, chosen)],
        "prices": None if timed else prices,
        "query": query(data, designs, requirement, "pixel_rate" if timed else price.text, costs["designs"]),
    }
    costs |= {
        "front": _front(designs, p95, _values(costs["designs"])),
        "prices": prices if timed else None,
        "price_front": _front(designs, p95, _values(prices)) if timed else None,
        "query": query(data, designs, requirement, price.text if timed else cost.SECONDS, costs["designs"]),
    }
    write_json(root / RESULT, result)
    write_json(root / cost.FILE, costs)
    _write_table(root / TABLE, designs, result["axes"], result["prices"])
    return result, costs


def files_of_study(root: Path) -> list[Path]:
    """Return the files that the results of a study are."""
    return [root / name for name in (FILE, RESULT, cost.FILE, TABLE)]


def query(
    data: Data,
    designs: Sequence[JsonObject],
    requirement: Requirement,
    by: str,
    seconds: Mapping[str, JsonObject],
    where: str = "study.cheapest_by",
) -> JsonObject:
    """Return the cheapest design for a requirement and a price, which need not be the study's own.

    ``seconds`` are the processor times of the designs. ``UserError``, naming ``where``, if ``by`` is no expression.
    """
    from horizonval.studies.trade.proportion import proportion

    shares = [
        {
            "name": design["name"],
            "within": proportion(
                data.samples[design["name"]].within(requirement.error_deg), data.samples[design["name"]].cluster
            ),
            "misses": misses_of(data.samples[design["name"]], requirement.error_deg),
        }
        for design in designs
    ]
    price = cost.read_price(by, data.plan.designs[0].costs, where)
    return cheapest(shares, requirement, price.text, prices_of(designs, price, seconds))


def prices_of(
    designs: Sequence[JsonObject], price: Expression, seconds: Mapping[str, JsonObject]
) -> dict[str, JsonObject]:
    """Return what each design costs, by name."""
    return {d["name"]: cost.price_of(price, cost.columns_of(d, seconds[d["name"]])) for d in designs}


def _values(prices: Mapping[str, JsonObject]) -> dict[str, float | None]:
    return {name: price["value"] for name, price in prices.items()}


def _design(number: int, design: Design, data: Data) -> JsonObject:
    measures = measures_of(data.samples[design.name], data.draws, data.plan.requirement.error_deg)
    pixels = design.width * design.height * design.heads
    return {
        "number": number,
        **asdict(design),
        "pixels": pixels,
        "pixel_rate": pixels * data.plan.head.frame_rate_hz,
        **measures,
        "misses": misses_of(data.samples[design.name], data.plan.requirement.error_deg),
        "verdict": verdict_of(measures["within"], data.plan.requirement.availability),
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
    """Return pairs that follow each other on a front, from the most pixels to the fewest."""
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
