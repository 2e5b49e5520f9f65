"""What the shipped nightly suite can tell from its accepted baseline: faults of the size that matters, and no others.

The faults are put into estimators; the frames, images and rows are the real ones.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nights import estimating_with, plainly

from horizonval.core.outcome import Outcome, Refusal
from horizonval.studies.regression import units
from horizonval.studies.regression.baseline import pack_path, read_baseline
from horizonval.studies.regression.gates import GateInputs, changed, judge, measure, pairs_of
from horizonval.suites.plan import plan_of
from horizonval.suites.suite import load_suite

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
BASELINE = ROOT / "results" / "baseline" / "nightly.json"
NIGHTS = 200


@pytest.fixture(scope="module")
def suite():
    return load_suite(ROOT / "scenes" / "suites" / "nightly.toml")


@pytest.fixture(scope="module")
def base():
    return read_baseline(BASELINE, "nightly")


def by_name(suite, now, base, lanes):
    measured = [measure(gate, now, base) for gate in suite.regression.gate if gate.lane in lanes]
    judged = judge([("accepted", one) for one in measured], suite.regression.most_batches)
    return {gate["name"]: gate for gate in judged}


def failed(gates):
    return {name for name, gate in gates.items() if gate["verdict"] == "FAIL"}


def test_the_baseline_is_small():
    assert sum(path.stat().st_size for path in BASELINE.parent.iterdir()) < 3e6


def test_replay_repeats_the_baseline_and_catches_ten_percent_more_error(suite, base, monkeypatch):
    """Both from one pass over every frozen image of every third scene of each kind."""
    plan, pack = plan_of(suite), base.images
    before = {row.key: row for row in base.results.rows}
    tables = {row.case: row.table for row in base.results.rows}
    real, worse = [], []
    for scene in [name for name in pack.truths if tables[name] in ("day", "infrared")][::3]:
        nadir = np.array(pack.truths[scene]["nadir_geocentric_cam"])
        found = {}

        def run(name, observation, found=found):
            key = (name, observation.image.tobytes())
            if key not in found:
                found[key] = plainly(name, observation)
            return found[key]

        def pushed(name, observation, nadir=nadir, run=run):
            fit = run(name, observation)
            if isinstance(fit, Refusal):
                return fit
            moved = nadir + 1.1 * (fit.nadir_cam - nadir)
            return replace(fit, nadir_cam=moved / np.linalg.norm(moved))

        for rows, answer in ((real, run), (worse, pushed)):
            estimating_with(monkeypatch, answer)
            for row in units.replay_scene(pack, scene, {}, plan):
                of_base = before[row.key]
                due = {"expected": of_base.expected, "borderline": of_base.borderline}
                rows.append(row.against(of_base.bound_arcsec, table=of_base.table, **due))
    assert changed(pairs_of(real, base.results.rows)) == []
    gates = by_name(suite, GateInputs(worse), base.results, {"replay"})
    assert "replay-accuracy" in failed(gates)
    assert gates["replay-availability"]["verdict"] == "PASS"
    assert set(gates["replay-accuracy"]["scenes"]) <= {row.case for row in worse}
    assert gates["replay-accuracy"]["n_scenes"] >= 12


def test_replay_catches_availability_three_points_lower(suite, base):
    rng = np.random.default_rng(96)
    now, lost = [], set()
    for row in base.results.rows:
        if row.is_due and row.status == Outcome.VALID and rng.uniform() < 0.03:
            lost.add(row.case)
            row = replace(row, status="short_arc", nadir_error_arcsec=None)
        now.append(row)
    gates = by_name(suite, GateInputs(now), base.results, {"replay"})
    assert failed(gates) == {"replay-availability"}
    assert set(gates["replay-availability"]["scenes"]) <= lost
    assert gates["replay-availability"]["n_scenes"] == len(lost)


def test_nights_in_which_nothing_changed(suite, base):
    """At most 1 % of 200 nights raise a false alarm.

    Harder than real nights, whose noise is the baseline's: here it is drawn anew. Of the replicates of every scene,
    half are "the baseline" and half "tonight", at random; the fresh scenes of the baseline and the fixed ones are one
    pool, of which half is "the baseline's" and half "tonight's"; noise of the detector follows from its pixels.
    """
    rng = np.random.default_rng(200)
    replicates = 1 + max(row.replicate for row in base.results.rows)
    half = replicates // 2
    by_key: dict[str, dict[int, list]] = {}
    for row in base.results.rows:
        by_key.setdefault(row.case, {}).setdefault(row.replicate, []).append(row)
    # Rows under every number that a night may give them: a row is validated when it is made, which takes its time.
    as_number = {(row.key, k): replace(row, replicate=k) for row in base.results.rows for k in range(half)}
    pool = [[replace(row, replicate=0) for row in seeds[0]] for seeds in by_key.values()]
    fresh: dict[str, list] = {}
    for row in base.results.fresh:
        fresh.setdefault(row.case, []).append(row)
    pool += fresh.values()
    verdicts = {"PASS": 0, "FAIL": 0, "IMPROVED": 0, "INCONCLUSIVE": 0}
    for _ in range(NIGHTS):
        before, now = [], []
        for seeds in by_key.values():
            order = rng.permutation(replicates)
            for k in range(half):
                before += [as_number[row.key, k] for row in seeds[order[k]]]
                now += [as_number[row.key, k] for row in seeds[order[half + k]]]
        order = rng.permutation(len(pool))
        fresh_before, fresh_now = ([row for i in part for row in pool[i]] for part in np.array_split(order, 2))
        pixels = 4000 * half
        images = {
            (scene, band): {
                "table": record["table"],
                "limb_radiance": 0.0,
                "disc_radiance": 0.0,
                "limb_displacement": 0.0,
                "noise": 100 * (math.sqrt(rng.chisquare(pixels) / rng.chisquare(pixels)) - 1),
            }
            for scene, record in base.scenes.items()
            for band in record["bands"]
        }
        gates = by_name(
            suite,
            GateInputs(now, images, fresh_now, "tonight"),
            GateInputs(before, {}, fresh_before, "then"),
            {"replay", "rerender", "fresh"},
        )
        kinds = {gate["verdict"] for gate in gates.values()}
        for word in ("FAIL", "INCONCLUSIVE", "IMPROVED", "PASS"):
            if word in kinds:
                verdicts[word] += 1
                break
    assert verdicts["FAIL"] <= 0.01 * NIGHTS, verdicts
    assert verdicts["IMPROVED"] <= 0.01 * NIGHTS, verdicts


def test_the_frozen_images_are_the_ones_that_were_accepted(base):
    assert len(base.images.images) == len({(r.case, r.band, r.replicate) for r in base.results.rows})
    assert {image.sha256 for image in base.images.images} == {row.image_address for row in base.results.rows}
    assert pack_path(BASELINE).is_file()
