"""Facts of a night on rows made by hand: one method goes wrong in a way a case, and its metric says so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import nights
import numpy as np
import pytest

from horizonval.core.outcome import Outcome
from horizonval.spec.suite import STANDING, GateSpec, RegressionSpec
from horizonval.studies.regression.gates import judge_images, judge_rows
from horizonval.studies.regression.partners import Asked, Promise, changed, missing, new, pairs_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.words import by_subject, subject_sentence

Spoil = Callable[[int, ReplicateRow], ReplicateRow]
SCENES = 60
CAMERAS = {f"s{k}": ("wide", "narrow")[k % 2] for k in range(SCENES)}
REFUSAL = {"nadir_error_arcsec": None, "roll_error_arcsec": None, "pitch_error_arcsec": None, "nees_nadir_total": None}
REFUSAL |= {
    "sigma_nadir_arcsec": None,
    "altitude_error_km": None,
    "status": str(Outcome.SHORT_ARC),
    "without_sigma": False,
    "false_valid": False,
}


def answer(row: ReplicateRow, roll: float, pitch: float, variance: float) -> ReplicateRow:
    """Return a row with other errors, its squared error over a claimed variance of each axis."""
    error = float(np.hypot(roll, pitch))
    nees = None if variance == 0.0 else error**2 / variance
    false = error > 1800.0 or bool(nees is not None and nees > 25.0 and error > 360.0)
    about = {"nadir_error_arcsec": error, "roll_error_arcsec": roll, "pitch_error_arcsec": pitch, "false_valid": false}
    about["sigma_nadir_arcsec"] = (2 * variance) ** 0.5
    return replace(row, **about, nees_nadir_total=nees, without_sigma=nees is None)


def accepted(scale: float = 53.0, seed: int = 1) -> list[ReplicateRow]:
    """Two methods, two cameras, two bands, two replicates, errors of ``scale`` arcsec in each axis, honest claims."""
    rng = np.random.default_rng(seed)
    return [
        answer(nights.row(f"s{k}", 1.0, estimator=e, band=b, replicate=r), *rng.normal(0, scale, 2).tolist(), scale**2)
        for e in "ab"
        for k in range(SCENES)
        for b in ("vis", "nir")
        for r in (0, 1)
    ]


def spoiled(rows: list[ReplicateRow], spoil: Spoil, only: dict[str, Any] | None = None) -> list[ReplicateRow]:
    """Return rows of which method a's go wrong, or those with other values; their number among them is passed on."""
    found, count = [], 0
    for row in rows:
        about = {**vars(row), "camera": CAMERAS[row.case]}
        if all(about[key] == value for key, value in (only or {"estimator": "a"}).items()):
            row, count = spoil(count, row), count + 1
        found.append(row)
    return found


def failed(now: list[ReplicateRow], base: list[ReplicateRow], word: str = "FAIL", **spec: Any) -> dict[str, set[str]]:
    """Return the metrics with a verdict, by method, camera and band."""
    found: dict[str, set[str]] = {}
    for gate in judge_rows(RegressionSpec(**spec), "replay", pairs_of(now, base), CAMERAS):
        if gate["verdict"] == word:
            found.setdefault(f"{gate['estimator']} {gate['camera']} {gate['band']}", set()).add(gate["metric"])
    return found


def moved(roll: float = 0.0, pitch: float = 0.0, factor: float = 1.0, claim: float = 1.0) -> Spoil:
    """Return what adds to the errors, enlarges them, and enlarges the claimed variance."""

    def spoil(_: int, row: ReplicateRow) -> ReplicateRow:
        assert row.roll_error_arcsec is not None
        assert row.pitch_error_arcsec is not None
        assert row.nadir_error_arcsec is not None
        assert row.nees_nadir_total is not None
        variance = row.nadir_error_arcsec**2 / row.nees_nadir_total * claim
        return answer(row, factor * row.roll_error_arcsec + roll, factor * row.pitch_error_arcsec + pitch, variance)

    return spoil


def refused(i: int, row: ReplicateRow) -> ReplicateRow:
    return replace(row, **REFUSAL)


def every(n: int, spoil: Spoil, first: int = 0) -> Spoil:
    return lambda i, row: spoil(i, row) if i % n == first else row


def crashed(i: int, row: ReplicateRow) -> ReplicateRow:
    return replace(refused(i, row), status=str(Outcome.CRASHED))


def not_a_number(i: int, row: ReplicateRow) -> ReplicateRow:
    return replace(row, **{**REFUSAL, "status": "valid", "false_valid": True, "without_sigma": True})


def silent(i: int, row: ReplicateRow) -> ReplicateRow:
    return replace(row, nees_nadir_total=None, sigma_nadir_arcsec=0.0, without_sigma=True)


def useless(i: int, row: ReplicateRow) -> ReplicateRow:
    """A sigma of 167 deg."""
    return replace(row, nees_nadir_total=1e-8, sigma_nadir_arcsec=6e5)


def altitude(error_km: float) -> Spoil:
    return lambda i, row: replace(row, altitude_error_km=error_km)


def without_roll(i: int, row: ReplicateRow) -> ReplicateRow:
    return replace(row, roll_error_arcsec=None)


def hard_refused(i: int, row: ReplicateRow) -> ReplicateRow:
    """A tenth, and the worst: the others' errors look better."""
    return refused(i, row) if (row.nadir_error_arcsec or 0.0) > 105.0 else row


FAULTS: dict[str, tuple[Spoil, set[str]]] = {
    "nothing": (lambda i, row: row, set()),
    "harmless noise of 5 arcsec": (lambda i, row: moved(roll=5.0 * (-1) ** i)(i, row), set()),
    "crashes throughout": (crashed, {"crashes", "availability"}),
    "crashes once": (every(240, crashed), {"crashes"}),
    "refuses throughout": (refused, {"availability"}),
    "refuses a tenth": (every(9, refused), {"availability"}),
    "refuses what is hard": (hard_refused, {"availability"}),
    "no number": (every(9, not_a_number), {"false_valid"}),
    "no sigma": (every(11, silent), {"without_sigma"}),
    "no roll": (every(11, without_roll), {"availability"}),
    "claims 3 times too sure": (moved(claim=1 / 9), {"honesty", "claimed_sigma"}),
    "claims 10 times too unsure": (moved(claim=100.0), {"honesty", "claimed_sigma"}),
    "a useless sigma in a tenth": (every(9, useless), {"claimed_sigma"}),
    "a claim 1.4 times less sure in a tenth": (every(9, moved(claim=1.4**2)), set()),
    "an altitude of 5 km claimed, 550 is true": (altitude(-545.0), {"altitude_mean", "altitude_error"}),
    "an altitude off either way": (lambda i, row: altitude(9.0 * (-1) ** (i // 4))(i, row), {"altitude_error"}),
    "an altitude claimed rightly": (altitude(0.5), set()),
    "30 arcsec of bias": (moved(pitch=30.0), {"pitch_mean"}),
    "noise doubled": (moved(factor=2.0), {"roll_scatter", "pitch_scatter", "nadir_error", "nadir_error_median"}),
    "60 arcsec worse": (moved(roll=80.0), {"roll_mean", "nadir_error"}),
    "2 deg off in a twentieth": (every(20, moved(roll=7200.0)), {"false_valid", "roll_scatter", "nadir_error"}),
    "0.2 deg off either way in a twentieth": (
        lambda i, row: moved(roll=720.0 * (-1) ** (i // 20))(i, row) if i % 20 == 0 else row,
        {"roll_scatter", "nadir_error"},
    ),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("only", [{"estimator": "a"}, {"estimator": "a", "band": "nir", "camera": "wide"}])
def test_a_fault_fails_its_metric_of_its_method_camera_and_band(name: str, only: dict[str, Any]) -> None:
    spoil, metrics = FAULTS[name]
    base = accepted()
    found = failed(spoiled(base, spoil, only), base)
    places = {f"a {camera} {band}" for camera in ("wide", "narrow") for band in ("vis", "nir")}
    places = {"a wide nir"} if "band" in only else places
    assert set(found) <= places, "only what changed is named"
    assert metrics <= set().union(*found.values())
    assert bool(found) == bool(metrics)
    if metrics and not name.endswith(("once", "twentieth")):
        assert set(found) == places


@pytest.mark.parametrize("axis", ["roll", "pitch"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("rms_arcsec", [10.0, 75.0, 500.0, 3600.0, 36000.0])
@pytest.mark.parametrize("offset", [0.0, 1000.0])
def test_a_bias_of_100_arcsec_in_one_axis_is_caught_whatever_the_errors(axis, sign, rms_arcsec, offset) -> None:
    """Also beside a large mean error of the other axis, which hides it from the total."""
    other = moved(**{"pitch" if axis == "roll" else "roll": offset})
    base = [other(0, row) for row in accepted(rms_arcsec / 2**0.5)]
    found = failed(spoiled(base, moved(**{axis: sign * 100.0})), base)
    assert len(found) == 4
    assert all(f"{axis}_mean" in metrics for metrics in found.values())


def test_losses_and_gains_do_not_cancel() -> None:
    base = spoiled(accepted(), every(10, refused))
    now = spoiled(accepted(), every(10, refused, first=5))
    assert all("availability" in metrics for metrics in failed(now, base).values())
    base, now = (spoiled(accepted(), every(10, moved(roll=7200.0), first=k)) for k in (0, 5))
    assert all("false_valid" in metrics for metrics in failed(now, base).values())


def test_a_few_large_errors_of_the_baseline_hide_nothing() -> None:
    """The total of 2 deg in a twentieth would hide doubled noise and claims that are too sure."""
    base = spoiled(accepted(), every(5, moved(roll=7200.0)))
    found = failed(spoiled(base, every(1, moved(factor=2.0))), base)
    assert any("nadir_error_median" in metrics for metrics in found.values())
    found = failed(spoiled(base, lambda i, row: row if row.false_valid else moved(claim=1 / 16)(i, row)), base)
    assert any("honesty" in metrics for metrics in found.values())


def test_what_is_better_is_improved_and_a_mean_that_moves_towards_zero_with_it() -> None:
    base = spoiled(accepted(), moved(roll=300.0))
    better = failed(accepted(), base, "IMPROVED")
    assert all({"roll_mean", "nadir_error"} <= metrics for metrics in better.values())
    assert "roll_mean" not in set().union(*failed(accepted(), base).values())
    mended = failed(accepted(), spoiled(accepted(), every(3, crashed)), "IMPROVED")
    assert mended["a wide vis"] == {"crashes", "availability"}


def test_answers_that_were_false_and_are_refused_are_no_loss_unless_one_was_due() -> None:
    base = spoiled(accepted(), moved(roll=7200.0))
    not_due = [replace(row, borderline=True) for row in base]
    assert not failed(spoiled(not_due, refused), not_due)
    assert all("availability" in metrics for metrics in failed(spoiled(base, refused), base).values())


def test_a_new_crash_without_a_partner_fails_and_other_new_rows_do_not() -> None:
    base = accepted()
    added = [replace(row, estimator="c") for row in base[:40]]
    assert not failed([*base, *added], base)
    assert set().union(*failed([*base, *(crashed(0, row) for row in added)], base).values()) == {"crashes"}


def test_a_baseline_without_claims_is_silent_about_them_alone() -> None:
    base = [replace(row, nees_nadir_total=None, sigma_nadir_arcsec=None) for row in accepted()]
    assert not any(row.states_claim for row in base)
    assert not failed(spoiled(accepted(), moved(claim=1 / 9)), base)
    assert not failed(spoiled(accepted(), altitude(9.0)), base)
    assert failed(spoiled(accepted(), moved(roll=30.0)), base)


def test_an_altitude_that_is_no_longer_claimed_is_lost() -> None:
    base = spoiled(accepted(), altitude(0.5))
    found = failed(spoiled(base, every(9, lambda i, row: replace(row, altitude_error_km=None))), base)
    assert set().union(*found.values()) == {"availability"}


def gate(metric: str, margin: float, lane: str = "replay", **keys: Any) -> GateSpec:
    unit = STANDING[metric].unit
    return GateSpec(name="g", lane=lane, metric=metric, margin=margin, unit=unit, reason="because it is tested", **keys)


def test_a_gate_of_the_suite_replaces_a_margin_where_it_looks() -> None:
    base = accepted()
    now = spoiled(spoiled(base, moved(roll=30.0)), moved(roll=30.0), {"estimator": "b"})
    assert set(failed(now, base, gate=[gate("roll_mean", 40.0, estimators=["a"])])) == {
        f"b {c} {b}" for c in ("wide", "narrow") for b in ("vis", "nir")
    }
    assert not failed(now, base, gate=[gate("roll_mean", 40.0, cases=["day"]), gate("pitch_mean", 40.0)][:1])
    tight = spoiled(base, moved(roll=5.0))
    assert not failed(tight, base)
    assert failed(tight, base, gate=[gate("roll_mean", 4.0)])
    wide = [gate("error_over_bound", 0.2)]
    bounded = [row.against(50.0) for row in base]
    assert set().union(*failed([row.against(40.0) for row in base], bounded, gate=wide).values()) == {
        "error_over_bound"
    }


@pytest.mark.parametrize(
    ("keys", "match"),
    [
        ({"metric": "nadir_error", "unit": "deg"}, "unit of nadir_error"),
        ({"metric": "noise", "unit": "%"}, "compares images"),
        ({"metric": "honesty", "unit": "factor"}, "factor above 1"),
        ({"metric": "roll_mean", "unit": "arcsec", "lane": "fresh"}, "not compared on scenes drawn anew"),
    ],
)
def test_a_gate_that_cannot_be_is_refused(keys: dict[str, Any], match: str) -> None:
    about = {"name": "g", "lane": "replay", "margin": 1.0, "reason": "because it is tested"}
    with pytest.raises(ValueError, match=match):
        GateSpec(**(about | keys))


@pytest.mark.parametrize(("metric", "value"), [("limb_radiance", -1.2), ("noise", 6.0), ("limb_displacement", 0.11)])
def test_one_scene_whose_image_differs_fails_by_name(metric: str, value: float) -> None:
    about = {"table": "day", "limb_radiance": 0.1, "disc_radiance": None, "limb_displacement": 0.0, "noise": -1.0}
    images = {(f"s{k}", "vis"): {**about, **({metric: value} if k == 7 else {})} for k in range(40)}
    bad = [g for g in judge_images(RegressionSpec(), images, CAMERAS) if g["verdict"] == "FAIL"]
    assert [(g["metric"], g["camera"], g["scenes"][0]) for g in bad] == [(metric, "narrow", "s7")]
    assert not [g for g in judge_images(RegressionSpec(), {("s1", "vis"): about}, CAMERAS) if g["verdict"] != "PASS"]


def test_a_sentence_names_the_method_and_what_happened() -> None:
    base = accepted()
    gates = judge_rows(RegressionSpec(), "replay", pairs_of(spoiled(base, every(5, refused)), base), CAMERAS)
    first, verdict, deciding = by_subject(gates)[0]
    text = subject_sentence(first, deciding)
    assert (verdict, text.split(" (")[0]) == ("FAIL", "a in day")
    assert "a in day (narrow, nir), frozen images: " in text
    assert "of 60 answers are lost" in text
    assert "scenes: s" in text


ASKED = Asked("wide", frozenset({"vis", "nir"}), frozenset("ab"))


def promise(*, scenes: dict[str, Asked] | None = None, replicates: int = 2) -> Promise:
    plain = {scene: ASKED._replace(camera=camera) for scene, camera in CAMERAS.items()}
    return Promise({**plain, **(scenes or {})}, replicates)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (promise(), []),
        (Promise({k: v for k, v in promise().scenes.items() if k != "s3"}, 2), ["scene s3", "8 answers"]),
        (promise(scenes={"s0": ASKED._replace(estimators=frozenset("b"))}), ["method a in day", "4 answers"]),
        (promise(scenes={"s0": ASKED._replace(bands=frozenset({"vis"}))}), ["band nir of day"]),
        (promise(scenes={"s0": ASKED._replace(camera="other")}), ["camera wide of day"]),
        (promise(replicates=1), ["replicate 1", "240 answers"]),
    ],
)
def test_what_the_suite_lacks_is_named(asked: Promise, words: list[str]) -> None:
    base = accepted()
    found = missing(asked, base, CAMERAS, {row.key for row in base})
    assert len(found) == bool(words)
    assert all(word in found[0] for word in words)
    assert new(asked, base, CAMERAS) == []


def test_an_answer_that_did_not_come_and_what_is_new_are_named() -> None:
    base = accepted()
    assert "answer a on s0 (vis, replicate 0)" in missing(promise(), base, CAMERAS, {row.key for row in base[1:]})[0]
    assert missing(promise(), base, CAMERAS, None) == []
    more = promise(scenes={"s99": ASKED, "s0": ASKED._replace(estimators=frozenset("abc"))}, replicates=3)
    assert [text.rsplit(": ", 1)[1] for text in new(more, base, CAMERAS)] == ["scene s99", "method c", "replicate 2"]


def test_every_change_is_listed_and_statuses_come_first() -> None:
    base = accepted()
    first = [refused(0, base[0]), moved(roll=9.0)(0, base[1]), moved(claim=2.0)(0, base[2]), silent(0, base[3])]
    now = [*first, *base[4:]]
    found = changed(pairs_of(now, base))
    assert [one["what"].split(" ")[0] for one in found[:2]] == ["valid", "nadir"]
    assert {one["what"].rsplit(" ", 3)[0] for one in found[2:]} >= {"squared error over claim"}
    assert len(found) == 4
