"""Gates on rows made by hand, whose answers can be counted."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import nights
import numpy as np
import pytest
from scipy import stats

from horizonval.core.outcome import Outcome
from horizonval.spec.suite import UNITS, GateSpec
from horizonval.studies.regression.accept import difference_table
from horizonval.studies.regression.baseline import Baseline
from horizonval.studies.regression.gates import (
    MOST_NAMED,
    GateInputs,
    judge,
    measure,
    scenes,
)
from horizonval.studies.regression.history import pieces
from horizonval.studies.regression.night import levels_of
from horizonval.studies.regression.page import write_junit
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics import (
    Estimate,
    Verdict,
    decide,
    exact,
    holm,
    independent_loss,
    paired_difference,
    paired_loss,
)


def gate(metric: str, lane: str = "replay", **keys: Any) -> GateSpec:
    return GateSpec(
        name="g", lane=lane, metric=metric, margin=1.0, unit=UNITS[metric], reason="because it is tested", **keys
    )


def row(scene: int | str, error: float | None = 10.0, **columns: Any) -> ReplicateRow:
    return nights.row(f"s{scene}", error, **columns)


def test_a_mean_change_is_taken_over_pairs_that_claim() -> None:
    rng = np.random.default_rng(1)
    before, after = rng.normal(10, 2, 12), rng.normal(12, 2, 12)
    base = [row(k, error) for k, error in enumerate(before)] + [row(20, 5.0), row(21, None), row(22, 1.0)]
    now = [row(k, error) for k, error in enumerate(after)] + [row(20, None), row(21, 5.0), row(99, 900.0)]
    found = measure(gate("nadir_error"), GateInputs(now), GateInputs(base))
    assert found.paired
    assert found.estimate == paired_difference(list(after - before), list(range(12)))
    order = np.argsort(-(after - before), kind="stable")
    worse = [f"s{k}" for k in order if after[k] > before[k]]
    better = [f"s{k}" for k in order[::-1] if after[k] < before[k]]
    assert list(found.scenes) == worse + better


def test_availability_is_lost_among_the_due_and_false_claims_among_all() -> None:
    base = [row(k, due=k < 9) for k in range(12)]
    now = [row(k, None if k in (1, 10) else 10.0, due=False) for k in range(12)]
    found = measure(gate("availability"), GateInputs(now), GateInputs(base))
    one_of_nine = paired_loss([True] * 9, [k != 1 for k in range(9)], list(range(9)))
    assert found.estimate is not None
    assert one_of_nine is not None
    assert found.estimate.value == pytest.approx(100 / 9)
    for bound in ("lower95", "upper95", "lower99", "upper99"):
        assert getattr(found.estimate, bound) == pytest.approx(100 * getattr(one_of_nine, bound))
    assert (found.estimate.p_worse, found.estimate.p_better) == (one_of_nine.p_worse, one_of_nine.p_better)
    assert (found.estimate.n, found.scenes) == (9, ("s1",))
    lying = [row(k, false_valid=k in (2, 10)) for k in range(12)]
    found = measure(gate("false_valid"), GateInputs(lying), GateInputs(base))
    assert found.estimate is not None
    assert found.estimate.value == pytest.approx(100 * 2 / 12)
    assert found.scenes == ("s10", "s2")


def test_a_gate_looks_at_its_estimators_and_tables_only() -> None:
    base = [row(k, 1.0, estimator=e, table=t) for k in range(6) for e in "ab" for t in ("day", "dusk")]
    base = [r for r in base if (r.table == "day") == (int(r.case[1:]) < 3)]
    now = [row(r.case[1:], 1.0 + (r.estimator == "a"), estimator=r.estimator, table=r.table) for r in base]
    for keys, value, n in (({}, 0.5, 12), ({"estimators": ["a"]}, 1.0, 6), ({"estimators": ["b"]}, 0.0, 6)):
        estimate = measure(gate("nadir_error", **keys), GateInputs(now), GateInputs(base)).estimate
        assert estimate is not None
        assert (estimate.value, estimate.n) == (pytest.approx(value), n)
    assert measure(gate("nadir_error", cases=["day"]), GateInputs(now), GateInputs(base)).estimate is None, "3 scenes"


def test_fresh_scenes_of_one_night_are_pairs_and_of_two_nights_not() -> None:
    rng = np.random.default_rng(2)
    before, after = rng.normal(10, 2, 9), rng.normal(13, 2, 9)
    mine = [row(k, e) for k, e in enumerate(after)]
    theirs = [row(k, e) for k, e in enumerate(before)]
    g = gate("nadir_error", "fresh")
    same = measure(g, GateInputs(fresh=mine, fresh_night="n1"), GateInputs(fresh=theirs, fresh_night="n1"))
    assert same.paired
    assert same.estimate == paired_difference(list(after - before), list(range(9)))
    for night in ("n2", ""):
        other = measure(g, GateInputs(fresh=mine, fresh_night=night), GateInputs(fresh=theirs, fresh_night=""))
        assert not other.paired
        assert other.scenes == ()
        assert other.estimate is not None
        welch = stats.ttest_ind(after, before, equal_var=False, alternative="greater")
        assert other.estimate.value == pytest.approx(after.mean() - before.mean())
        assert other.estimate.p_worse == pytest.approx(welch.pvalue)


def test_a_fresh_frame_is_good_if_all_its_estimators_are() -> None:
    """Two estimators on one frame are one frame; frames that are not due do not count for availability."""

    def frames(bad: int, n: int, **columns: Any) -> list[ReplicateRow]:
        rows = [row(k, None if k < bad else 5.0, estimator="a", **columns) for k in range(n)]
        return rows + [row(k, 5.0, estimator="b", **columns) for k in range(n)]

    now, base = frames(4, 20) + frames(9, 9, due=False, band="ir"), frames(1, 25)
    found = measure(
        gate("availability", "fresh"), GateInputs(fresh=now, fresh_night="a"), GateInputs(fresh=base, fresh_night="b")
    )
    expected = independent_loss(24, 25, 16, 20)
    assert expected is not None
    assert found.estimate is not None
    assert found.estimate.value == pytest.approx(100 * expected.value) == pytest.approx(16.0)
    assert found.estimate.p_worse == expected.p_worse
    false = measure(
        gate("false_valid", "fresh"), GateInputs(fresh=now, fresh_night="a"), GateInputs(fresh=base, fresh_night="b")
    )
    assert false.estimate is not None
    assert false.estimate.value == 0.0


def test_images_are_measured_where_the_metric_applies() -> None:
    images = {(f"s{k}", "vis"): {"table": "day", "noise": float(k), "limb_radiance": None} for k in range(6)}
    images["s9", "vis"] = {"table": "dusk", "noise": 100.0, "limb_radiance": None}
    found = measure(gate("noise", "rerender", cases=["day"]), GateInputs(images=images), GateInputs())
    assert found.estimate == paired_difference([float(k) for k in range(6)], list(range(6)))
    assert found.scenes == ("s5", "s4", "s3", "s2", "s1")
    assert measure(gate("limb_radiance", "rerender"), GateInputs(images=images), GateInputs()).estimate is None


def estimate(value: float, error: float, p_worse: float, p_better: float = 0.5) -> Estimate:
    return Estimate(
        value, value - 2 * error, value + 2 * error, value - 3 * error, value + 3 * error, p_worse, p_better, 90, 40
    )


@pytest.mark.parametrize("two_sided", [False, True])
def test_a_bound_on_the_margin_is_not_within_it(two_sided: bool) -> None:
    """A change of exactly the margin is one that matters."""
    verdicts = [decide([exact(v, 90, 40)], [0.5], [two_sided])[0][0] for v in (0.25, 0.5, -0.5)]
    assert verdicts[0] is Verdict.PASS
    assert Verdict.PASS not in verdicts[1:2]
    assert (verdicts[2] is Verdict.PASS) is False
    assert decide([estimate(0.1, 0.2, 0.4)], [0.5], [two_sided])[0][0] is Verdict.INCONCLUSIVE, "upper bound at 0.5"
    assert decide([estimate(0.09, 0.2, 0.4)], [0.5], [two_sided])[0][0] is Verdict.PASS
    below = decide([estimate(-0.1, 0.2, 0.4)], [0.5], [two_sided])[0][0]
    assert below is (Verdict.INCONCLUSIVE if two_sided else Verdict.PASS)


def test_a_two_sided_gate_doubles_the_smaller_chance() -> None:
    small = [estimate(2.0, 0.1, 0.004, 0.996), estimate(-2.0, 0.1, 0.997, 0.003)]
    adjusted = [p for _, p in decide(small, [1.0, 1.0], [True, True])]
    assert adjusted == pytest.approx(holm([0.008, 0.006]))
    assert [v for v, _ in decide(small, [1.0, 1.0], [True, True])] == [Verdict.INCONCLUSIVE] * 2
    assert decide([estimate(0.0, 0.1, 0.7, 0.6)], [1.0], [True])[0][1] == 1.0
    mixed = decide([small[0], None, small[1]], [1.0] * 3, [False] * 3)
    assert [v for v, _ in mixed] == [Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.IMPROVED]
    assert mixed[1][1] is None


def test_all_gates_of_a_night_are_judged_with_their_scenes() -> None:
    base = [row(k, 10.0) for k in range(20)]
    now = [row(k, 15.0 + 0.02 * k) for k in range(20)]
    quiet = measure(gate("availability"), GateInputs(now), GateInputs(base))
    loud = measure(gate("nadir_error"), GateInputs(now), GateInputs(base))
    one, two = judge([("accepted", loud), ("release", quiet)])
    assert (one["verdict"], one["against"], one["n_scenes"], len(one["scenes"])) == ("FAIL", "accepted", 20, MOST_NAMED)
    assert (two["against"], two["n_scenes"], two["scenes"]) == ("release", 0, [])
    assert (one["two_sided"], one["paired"], one["unit"]) == (False, True, "arcsec")
    assert scenes(one).endswith(" and 8 more")
    assert scenes(one | {"n_scenes": 13}).endswith(" and 1 more")
    assert "more" not in scenes(one | {"n_scenes": 12})


def test_junit_counts_what_failed_was_skipped_and_is_missing(tmp_path: Path) -> None:
    found = [
        measure(
            gate("nadir_error"), GateInputs([row(k, 20.0) for k in range(8)]), GateInputs([row(k) for k in range(8)])
        )
    ]
    failing = judge([("accepted", found[0])])[0]
    published = [
        {"system": "A", "name": name, "verdict": v, "measured": 1.0, "accepted": 1.0, "unit": "deg\x00"}
        for name, v in (("a", "PASS"), ("b", "INCONCLUSIVE"))
    ]
    for problems in ([], ["one", "two"]):
        verdict = {
            "suite": "s",
            "night": "n",
            "verdict": "FAIL",
            "gates": [failing],
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


def test_levels_are_shares_of_what_is_due_and_medians_of_what_claims() -> None:
    rows = [row(0, 4.0), row(1, 8.0), row(2, None), row(3, 100.0, due=False, false_valid=True)]
    levels = levels_of(rows, [row(0, None, due=False)])
    assert levels["fixed est: availability"] == {"value": pytest.approx(200 / 3), "unit": "%", "n": 3}
    assert levels["fixed est: false claims"] == {"value": 25.0, "unit": "%", "n": 4}
    assert levels["fixed est: median nadir error"] == {"value": 8.0, "unit": "arcsec", "n": 3}
    assert set(levels) == {*[k for k in levels if k.startswith("fixed")], "fresh est: false claims"}
    assert levels["fresh est: false claims"]["value"] == 0.0


def head(**keys: Any) -> dict[str, Any]:
    return {"suite": "s", "night": "n", "version": "1", "accepted_utc": "u", "reason": "r", "past": []} | keys


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


def rows_of(outcomes: Any, *, due: bool = True, false: Any = ()) -> list[ReplicateRow]:
    """Return rows of one image a scene with these statuses."""
    return [
        nights.row(
            f"scene-{i:03d}",
            100.0 if outcome == Outcome.VALID else None,
            status=str(outcome),
            false_valid=i in false,
            due=due,
        )
        for i, outcome in enumerate(outcomes)
    ]


def gate_of(metric: str, lane: str = "replay", margin: float = 1.5) -> GateSpec:
    return gate(metric, lane).model_copy(update={"name": metric, "margin": margin})


def test_availability_of_96_for_99_percent_is_caught_and_named():
    valid, lost = Outcome.VALID, Outcome.SHORT_ARC
    base = rows_of([lost if i % 100 == 0 else valid for i in range(400)])
    now = rows_of([lost if i % 100 == 0 or i % 33 == 1 else valid for i in range(400)])
    measured = measure(gate_of("availability"), GateInputs(now), GateInputs(base))
    (gate,) = judge([("accepted", measured)])
    assert gate["verdict"] == "FAIL"
    assert gate["estimate"]["value"] == pytest.approx(3.0)
    assert measured.scenes == tuple(f"scene-{i:03d}" for i in range(400) if i % 33 == 1 and i % 100)
    (same,) = judge([("accepted", measure(gate_of("availability"), GateInputs(base), GateInputs(base)))])
    assert same["verdict"] == "PASS"
    (better,) = judge([("accepted", measure(gate_of("availability"), GateInputs(base), GateInputs(now)))])
    assert better["verdict"] == "IMPROVED"
    (small,) = judge([("accepted", measure(gate_of("availability"), GateInputs(now[:40]), GateInputs(base[:40])))])
    assert small["verdict"] == "INCONCLUSIVE"


def test_refusing_what_is_hard_does_not_improve_the_error():
    """The worst frames refused: the error over common claims is the same, availability fails."""
    base = rows_of([Outcome.VALID] * 300)
    now = rows_of([Outcome.DARK if i < 15 else Outcome.VALID for i in range(300)])
    base = [replace(row, nadir_error_arcsec=5000.0) for row in base[:15]] + base[15:]
    found = [measure(gate_of(m), GateInputs(now), GateInputs(base)) for m in ("nadir_error", "availability")]
    error, availability = judge([("accepted", one) for one in found])
    assert (error["verdict"], error["estimate"]["value"]) == ("PASS", 0.0)
    assert availability["verdict"] == "FAIL"


def bounded(bound, error):
    return [row(f"{i:02d}", error, bound_arcsec=bound) for i in range(40)]


@pytest.mark.parametrize("lane", ["replay", "fresh"])
def test_an_error_further_from_its_bound_is_caught(lane):
    """Also where the error itself is the same: frames that allow more are used worse."""

    def inputs(rows, night):
        spread = [
            replace(r, nadir_error_arcsec=r.nadir_error_arcsec + i % 5).against(r.bound_arcsec)
            for i, r in enumerate(rows)
        ]
        return GateInputs(spread) if lane == "replay" else GateInputs(fresh=spread, fresh_night=night)

    gate = gate_of("error_over_bound", lane, margin=0.2)
    base = inputs(bounded(100.0, 120.0), "then")
    (worse,) = judge([("accepted", measure(gate, inputs(bounded(80.0, 120.0), "tonight"), base))])
    assert (worse["verdict"], worse["unit"]) == ("FAIL", "1")
    assert worse["estimate"]["value"] == pytest.approx(122.0 / 80.0 - 1.22)
    (same,) = judge([("accepted", measure(gate, inputs(bounded(100.0, 121.0), "tonight"), base))])
    assert same["verdict"] == "PASS"
    (better,) = judge([("accepted", measure(gate, inputs(bounded(100.0, 60.0), "tonight"), base))])
    assert better["verdict"] == "IMPROVED"


def test_a_method_that_the_baseline_has_not_changes_nothing():
    base = bounded(100.0, 120.0)
    new = [replace(row, estimator="new", nadir_error_arcsec=5000.0) for row in base]
    gate = gate_of("nadir_error", "fresh", margin=20.0)
    found = measure(gate, GateInputs(fresh=[*base, *new], fresh_night="b"), GateInputs(fresh=base, fresh_night="a"))
    assert not found.paired
    assert found.estimate.value == 0.0
