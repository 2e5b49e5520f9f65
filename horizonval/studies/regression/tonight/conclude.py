"""The verdict of a night: from its gates, anchors and figures, and from what is missing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.core.memory import peak_mebibytes
from horizonval.studies.regression.baseline.baseline import Baseline
from horizonval.studies.regression.environment import environment
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics.decide import Verdict, night_verdict
from horizonval.studies.regression.statistics.gates import GateInputs
from horizonval.studies.regression.tonight.compare import compare
from horizonval.studies.regression.tonight.gathered import Gathered
from horizonval.studies.regression.tonight.wanted import NIGHT_SCHEMA

EXIT = {Verdict.PASS: 0, Verdict.IMPROVED: 0, Verdict.FAIL: 1, Verdict.INCONCLUSIVE: 3}
INCOMPLETE = 2


def verdict_of(night: Gathered, release: Baseline | None, reference: GateInputs | None) -> JsonObject:
    """Return the verdict; asks for further batches of fresh scenes as long as their gates are inconclusive."""
    while True:
        comparisons, gates = compare(night, release, reference)
        undecided = any(g["lane"] == "fresh" and g["verdict"] == Verdict.INCONCLUSIVE for g in gates)
        more = undecided and night.accepted is not None and reference is None and "fresh" in night.wanted.lanes
        if not more or night.batches >= night.spec.most_batches:
            break
        night.work_on_more_scenes()
    return _conclude(night, comparisons, gates)


def _conclude(night: Gathered, comparisons: list[JsonObject], gates: list[JsonObject]) -> JsonObject:
    problems = [f"{name}: {error}" for name, error in night.failed.items()]
    if night.accepted is None:
        problems.append(f"no accepted baseline at {night.wanted.baseline}: nothing to compare with")
    for about in comparisons:
        if about.get("missing_scenes"):
            count = len(about["missing_scenes"])
            problems.append(f"{count} scenes of the baseline ({about['name']}) are not in the suite any more")
    verdicts = [Verdict(one["verdict"]) for one in [*gates, *night.anchors, *night.published]]
    if night.accepted is None:
        verdicts.append(Verdict.FAIL)
    verdict = night_verdict(verdicts)
    proven = any(Verdict(item["verdict"]) is Verdict.FAIL for item in [*gates, *night.anchors, *night.published])
    status = EXIT[verdict] if proven or not problems else INCOMPLETE
    if problems and not proven and verdict in (Verdict.PASS, Verdict.IMPROVED):
        # What was not looked at has not passed.
        verdict = Verdict.INCONCLUSIVE
    return {
        "schema": NIGHT_SCHEMA,
        "suite": night.suite.name,
        "night": night.wanted.night,
        "lanes": list(night.wanted.lanes),
        "verdict": str(verdict),
        "exit_status": status,
        "complete": not problems,
        "problems": problems,
        "environment": environment(),
        "comparisons": comparisons,
        "gates": gates,
        "anchors": night.anchors,
        "published": night.published,
        "fresh": {"night": night.wanted.night, "batches": night.batches, "scenes": _count(night.fresh)},
        "levels": levels_of(night.all_rows() or night.replayed, night.fresh) | _cost(night),
    }


def _cost(night: Gathered) -> JsonObject:
    """Return speed and memory: followed from night to night, no gate, since they are a machine's and its load's."""
    found: JsonObject = {}
    if night.replay_s and night.replayed:
        n = len({(row.scene, row.band, row.replicate) for row in night.replayed})
        found["replay: time of an image"] = {"value": sum(night.replay_s) / n, "unit": "s", "n": n}
    if (peak := peak_mebibytes()) is not None:
        found["largest process: memory"] = {"value": peak, "unit": "MiB", "n": 1}
    return found


def _count(rows: Sequence[ReplicateRow]) -> int:
    return len({row.scene for row in rows})


def levels_of(rows: Sequence[ReplicateRow], fresh: Sequence[ReplicateRow]) -> JsonObject:
    """Return the figures whose trend is followed: availability, false claims and median error, by estimator."""
    found: JsonObject = {}
    for lane, own in (("fixed", rows), ("fresh", fresh)):
        for estimator in sorted({row.estimator for row in own}):
            mine = [row for row in own if row.estimator == estimator]
            due = [row for row in mine if row.due]
            errors = [row.nadir_error_arcsec for row in mine if row.nadir_error_arcsec is not None]
            name = f"{lane} {estimator}"
            if due:
                share = sum(row.is_claim for row in due) / len(due)
                found[f"{name}: availability"] = {"value": 100.0 * share, "unit": "%", "n": len(due)}
            share = sum(row.false_valid for row in mine) / len(mine)
            found[f"{name}: false claims"] = {"value": 100.0 * share, "unit": "%", "n": len(mine)}
            if errors:
                median = float(np.median(errors))
                found[f"{name}: median nadir error"] = {"value": median, "unit": "arcsec", "n": len(errors)}
            over = [row.error_over_bound for row in mine if row.error_over_bound is not None]
            if over:
                found[f"{name}: median error over bound"] = {
                    "value": float(np.median(over)),
                    "unit": "1",
                    "n": len(over),
                }
    return found
