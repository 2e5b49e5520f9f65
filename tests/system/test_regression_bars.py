"""What the shipped nightly suite can tell from its accepted baseline: faults of the size that matters, and no others.

The faults are put into estimators; the frames, images and rows are the real ones.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nights import estimating_with, plainly

from horizonval.core.outcome import Outcome, Refusal
from horizonval.spec.suite import RegressionSpec
from horizonval.studies.regression import units
from horizonval.studies.regression.baseline import pack_path, read_baseline
from horizonval.studies.regression.fresh import judge_fresh
from horizonval.studies.regression.gates import judge_rows
from horizonval.studies.regression.partners import cameras_of, changed, pairs_of
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


def failed(now, base):
    """Return what fails: method, table, metric."""
    gates = judge_rows(RegressionSpec(), "replay", pairs_of(now, base.results.rows), cameras_of(base.scenes, {}))
    return {(gate["estimator"], gate["cases"], gate["metric"]) for gate in gates if gate["verdict"] == "FAIL"}


def test_the_baseline_is_small():
    assert sum(path.stat().st_size for path in BASELINE.parent.iterdir()) < 3e6


def test_replay_repeats_the_baseline_and_catches_a_fifth_more_error(suite, base, monkeypatch):
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
            moved = nadir + 1.2 * (fit.nadir_cam - nadir)
            return replace(fit, nadir_cam=moved / np.linalg.norm(moved))

        for rows, answer in ((real, run), (worse, pushed)):
            estimating_with(monkeypatch, answer)
            for row in units.replay_scene(pack, scene, {}, plan):
                of_base = before[row.key]
                due = {"expected": of_base.expected, "borderline": of_base.borderline}
                rows.append(row.against(of_base.bound_arcsec, table=of_base.table, **due))
    assert changed(pairs_of(real, base.results.rows)) == []
    assert failed(real, base) == set()
    found = failed(worse, base)
    assert {(name, table, "nadir_error") for name in suite.estimators for table in ("day", "infrared")} <= found
    assert not {metric for _, _, metric in found} & {"availability", "crashes"}


def test_replay_catches_3_percent_of_one_methods_answers_lost(base):
    now, number = [], 0
    for row in base.results.rows:
        number += row.estimator == "limb-profile" and row.is_claim
        if row.estimator == "limb-profile" and row.is_claim and number % 33 == 0:
            lost = dict.fromkeys(("nadir_error_arcsec", "roll_error_arcsec", "pitch_error_arcsec", "nees_nadir_total"))
            row = replace(row, **lost, status=str(Outcome.SHORT_ARC), without_sigma=False)
        now.append(row)
    assert failed(now, base) == {("limb-profile", table, "availability") for table in ("day", "hard", "infrared")}


def test_other_scenes_raise_no_false_alarm(base):
    """The fresh scenes of the baseline and the fixed ones are one pool: half is "the baseline's", half "tonight's"."""
    rng = np.random.default_rng(200)
    pool: dict[str, list] = {}
    for row in [*base.results.rows, *base.results.fresh]:
        if row.replicate == 0:
            pool.setdefault(row.case, []).append(row)
    scenes, verdicts = list(pool), []
    for _ in range(NIGHTS):
        order = rng.permutation(len(scenes))
        before, now = ([row for i in part for row in pool[scenes[i]]] for part in np.array_split(order, 2))
        gates = judge_fresh(RegressionSpec(), now, before, cameras_of(base.scenes, {}))
        verdicts.append({gate["verdict"] for gate in gates})
    for word in ("FAIL", "IMPROVED"):
        assert sum(word in one for one in verdicts) <= 0.01 * NIGHTS


def test_the_frozen_images_are_the_ones_that_were_accepted(base):
    assert len(base.images.images) == len({(r.case, r.band, r.replicate) for r in base.results.rows})
    assert {image.sha256 for image in base.images.images} == {row.image_address for row in base.results.rows}
    assert pack_path(BASELINE).is_file()
