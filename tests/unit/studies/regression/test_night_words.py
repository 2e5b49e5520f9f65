"""A night in words: JUnit, levels of the trend, the table of a new baseline, and steps of a history."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import nights
import numpy as np
import pytest

from horizonval.spec.suite import RegressionSpec
from horizonval.studies.regression.accept import covered, difference_table, useless_methods
from horizonval.studies.regression.baseline import Baseline
from horizonval.studies.regression.gates import GateInputs, judge_rows
from horizonval.studies.regression.history import pieces
from horizonval.studies.regression.night import levels_of
from horizonval.studies.regression.page import headline, write_junit
from horizonval.studies.regression.partners import pairs_of
from horizonval.studies.regression.row import ReplicateRow


def row(scene: int | str, error: float | None = 10.0, **columns: Any) -> ReplicateRow:
    return nights.row(f"s{scene}", error, **columns)


def test_junit_counts_what_it_lists_and_headlines_name_the_method(tmp_path: Path) -> None:
    pairs = pairs_of([row(k, 60.0) for k in range(8)], [row(k) for k in range(8)])
    published = [
        {"system": "A", "name": name, "verdict": v, "measured": 1.0, "accepted": 1.0, "unit": "deg\x00"}
        for name, v in (("a", "PASS"), ("b", "INCONCLUSIVE"))
    ]
    for problems in ([], ["one", "two"]):
        verdict = {
            "suite": "s",
            "night": "n",
            "verdict": "FAIL",
            "gates": judge_rows(RegressionSpec(), "replay", pairs, {"s0": "c"} | {f"s{k}": "c" for k in range(8)}),
            "published": published,
        }
        verdict |= {"problems": problems, "environment": {"version": "1", "commit": "abc"}}
        write_junit(tmp_path / "junit.xml", verdict)
        suite = ElementTree.parse(tmp_path / "junit.xml").getroot()[0]
        counts = {key: int(suite.get(key, "")) for key in ("tests", "failures", "errors", "skipped")}
        assert counts == {"tests": 4, "failures": 1, "errors": int(bool(problems)), "skipped": 1}
        properties = {p.get("name"): p.get("value") for p in suite.iter("property")}
        assert properties == {"night": "n", "verdict": "FAIL", "version": "1", "commit": "abc"}
        errors = [e.get("message") for e in suite.iter("error")]
        assert errors == (["one; two"] if problems else [])
        assert headline(verdict) == "Regression: est in day (c, vis)."


def test_levels_are_shares_of_what_is_due_and_medians_of_what_claims() -> None:
    rows = [row(0, 4.0), row(1, 8.0), row(2, None), row(3, 100.0, due=False, false_valid=True)]
    levels = levels_of(rows, [row(0, None, due=False)])
    assert levels["fixed est: availability"] == {"value": pytest.approx(200 / 3), "unit": "%", "n": 3}
    assert levels["fixed est: false claims"] == {"value": 25.0, "unit": "%", "n": 4}
    assert levels["fixed est: median nadir error"] == {"value": 8.0, "unit": "arcsec", "n": 3}
    assert set(levels) == {*[k for k in levels if k.startswith("fixed")], "fresh est: false claims"}
    assert levels["fresh est: false claims"]["value"] == 0.0


def head(**keys: Any) -> dict[str, Any]:
    return {
        "suite": "s",
        "night": "n",
        "version": "1",
        "accepted_utc": "u",
        "reason": "r",
        "past": [],
        "covers": [],
    } | keys


def scene_record(*images: str) -> dict[str, Any]:
    return {"table": "day", "camera": "c", "bands": {"vis": {"images": list(images)}}}


def test_a_new_baseline_says_what_changes() -> None:
    old = [row(k, 10.0 + k) for k in range(4)] + [row(9, None, table="dusk")]
    new = [row(k, 20.0 + k) for k in range(3)] + [row(3, None), row(9, 5.0, table="dusk", false_valid=True)]
    old_scenes = {"s0": scene_record("a", "b"), "s7": scene_record("a")}
    before = Baseline(Path(), head(night="m", version="0"), GateInputs(old), old_scenes, Path())
    text = difference_table(before, GateInputs(new), {"s0": scene_record("a", "c"), "s8": scene_record("z")}, head())
    assert "1 of 3 detector images are the same" in text
    assert "| est | day | 4 | 100 → 75 | 0 → 0 | 11 → 21 |" in text
    assert "| est | dusk | 1 | 0 → 100 | 0 → 100 | – → – |" in text
    assert "| est | day | 4 | 75 | 0 | 21 |" in difference_table(None, GateInputs(new), {}, head())


def test_an_acceptance_says_what_it_covers() -> None:
    old = [row(k, 10.0) for k in range(6)] + [row(k, 5.0, estimator="gone") for k in range(6)]
    scenes = {f"s{k}": scene_record("a") for k in range(6)}
    before = Baseline(Path(), head(night="m"), GateInputs(old), scenes, Path())
    spec = RegressionSpec()
    found = covered(spec, before, GateInputs([row(k, 60.0) for k in range(6)]))
    assert found[0] == "no longer compared: gone in day (c, vis), 6 answers"
    assert found[1].startswith("FAIL: est in day (c, vis): nadir error (rms) 10 -> 60 arcsec (margin 20 arcsec)")
    assert covered(spec, before, GateInputs(old)) == covered(spec, None, GateInputs(old)) == []
    text = difference_table(before, GateInputs([]), {}, head(covers=found))
    assert "What the acceptance covers" in text
    assert f"- {found[1]}" in text


@pytest.mark.parametrize(("bad", "named"), [(8, False), (9, True), (10, True)])
@pytest.mark.parametrize("columns", [{"false_valid": True}, {"error": None, "status": "crashed"}])
def test_a_method_that_is_false_or_crashes_nearly_always_is_named(bad: int, named: bool, columns: dict) -> None:
    rows = [row(k, **(columns if k < bad else {})) for k in range(10)]
    what = "claims falsely" if "false_valid" in columns else "crashes"
    expected = [f"est in day (c, vis) {what} in {bad} of 10 images"] if named else []
    assert useless_methods(rows, {f"s{k}": "c" for k in range(10)}) == expected


def cheapest_partition(y: np.ndarray, fewest: int) -> list[int]:
    """Starts of the pieces with the least Bayesian criterion, by trying every partition."""
    n = len(y)
    best: dict[int, tuple[float, list[int]]] = {}
    for count in range(1, n // fewest + 1):
        for cuts in itertools.combinations(range(1, n), count - 1):
            ends = [0, *cuts, n]
            if min(np.diff(ends)) < fewest:
                continue
            cost = sum(np.abs(y[a:b] - np.median(y[a:b])).sum() for a, b in itertools.pairwise(ends))
            if count not in best or cost < best[count][0]:
                best[count] = cost, ends[:-1]
    criterion = {k: 2 * n * math.log(cost / n) + 3 * k * math.log(n) for k, (cost, _) in best.items()}
    return best[min(criterion, key=lambda k: criterion[k])][1]


@pytest.mark.parametrize("levels", [(0.0,), (0.0, 9.0), (0.0, 9.0, 0.0), (0.0, 1.0, 9.0), (3.0, 0.5, 3.0)])
@pytest.mark.parametrize("fewest", [3, 4])
def test_steps_are_those_of_the_best_partition_up_to_as_many_as_fit(levels: tuple[float, ...], fewest: int) -> None:
    rng = np.random.default_rng(len(levels))
    y = np.concatenate([level + rng.normal(0.0, 0.2, fewest) for level in levels for _ in range(3 // len(levels) or 1)])
    found = pieces(y, fewest)
    assert [p.start for p in found] == cheapest_partition(y, fewest)
    assert [p.stop for p in found] == [*[p.start for p in found[1:]], len(y)]
    assert [p.level for p in found] == [pytest.approx(np.median(y[p.start : p.stop])) for p in found]
    assert len(pieces(y[: fewest - 1], fewest)) == 1
