"""What the shipped nightly suite can tell from its accepted baseline: faults of the size that matters, and no others.

The faults are put into estimators, radiance, camera and detector; the frames, images and rows are the real ones.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from nights import estimating_with, plainly
from scipy import ndimage

from horizonval.core.outcome import Outcome, Refusal
from horizonval.sensor.observe import observe
from horizonval.studies.regression import units
from horizonval.studies.regression.baseline import pack_path, read_baseline
from horizonval.studies.regression.gates import GateInputs, changed, judge, measure, pairs_of
from horizonval.studies.regression.images import LIMB, compare_images, regions_of
from horizonval.suites.plan import Unit, plan_of
from horizonval.suites.suite import load_suite

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
BASELINE = ROOT / "results" / "baseline" / "nightly.json"
NIGHTS = 200
EVERY = 4
"""Of the scenes with radiance gates, for the faults that are put into frames."""


@pytest.fixture(scope="module")
def suite():
    return load_suite(ROOT / "scenes" / "suites" / "nightly.toml")


@pytest.fixture(scope="module")
def base():
    return read_baseline(BASELINE, "nightly")


@pytest.fixture(scope="module")
def rendered(suite):
    """Frames of every fourth scene of those whose radiance is gated."""
    from horizonval.renderer.frame import render_frame

    chosen = [case for case in suite.cases if case.table in ("day", "infrared")][::EVERY]
    return {case.name: (case, render_frame(case.scene, case.camera)) for case in chosen}


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


def images_with(suite, base, rendered, render=None, see=observe):
    """Every chosen scene compared with the baseline, with faults."""
    frames, found = {(frame.scene, frame.band): frame for frame in base.images.frames}, {}
    plan = replace(plan_of(suite), estimators=())
    for scene, (case, frame) in rendered.items():
        made = frame if render is None else render(case, frame)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(units, "_render", lambda scene, camera, made=made: made)
            patch.setattr(units, "observe", see)
            record, arrays = units.render_unit(Unit(scene, (case,)), plan, 2)
        for band, now in record["scenes"][scene]["bands"].items():
            old = base.scenes[scene]["bands"][band]
            radiance = arrays[f"{scene}:radiance.{band}"]
            found[scene, band] = compare_images(case.table, now, old, radiance, frames[scene, band])
    return found


def rerender_gates(suite, base, images):
    return by_name(suite, GateInputs(images=images), base.results, {"rerender"})


def test_rendering_again_gives_the_same_bits_and_passes(suite, base, rendered):
    images = images_with(suite, base, rendered)
    gates = rerender_gates(suite, base, images)
    assert all(one["same_images"] == one["n_images"] for one in images.values())
    assert {gate["verdict"] for name, gate in gates.items() if name != "detector-noise"} == {"PASS"}


def test_half_a_pixel_is_caught(suite, base, rendered):
    def shifted(case, frame):
        moved = {
            band: ndimage.shift(values.astype(float), (0.5, 0.5), order=1, mode="nearest").astype(np.float32)
            for band, values in frame.radiance.items()
        }
        return replace(frame, radiance=moved)

    gates = rerender_gates(suite, base, images_with(suite, base, rendered, shifted))
    assert "limb-displacement" in failed(gates)
    assert set(gates["limb-displacement"]["scenes"]) <= set(rendered)
    assert gates["limb-displacement"]["n_scenes"] == len(rendered)


def test_a_wrong_sign_of_k1_is_caught(suite, base, rendered):
    from horizonval.renderer.frame import render_frame

    lensed = {name: pair for name, pair in rendered.items() if pair[0].table == "day"}

    def wrong(case, frame):
        k = [-case.camera.camera.distortion[0], *case.camera.camera.distortion[1:]]
        lens = case.camera.camera.model_copy(update={"distortion": k})
        made = render_frame(case.scene, case.camera.model_copy(update={"camera": lens}))
        return replace(frame, radiance=made.radiance)

    gates = rerender_gates(suite, base, images_with(suite, base, lensed, wrong))
    assert "limb-displacement" in failed(gates)
    assert set(gates["limb-displacement"]["scenes"]) == set(lensed)


def test_two_percent_at_the_limb_is_caught_there(suite, base, rendered):
    def brighter(case, frame):
        limb = regions_of(frame.maps["hit"], frame.maps["tangent_height"]) == LIMB
        gain = np.where(limb, 1.02, 1.0).astype(np.float32)
        return replace(frame, radiance={band: values * gain for band, values in frame.radiance.items()})

    gates = rerender_gates(suite, base, images_with(suite, base, rendered, brighter))
    assert failed(gates) == {"limb-radiance"}
    assert gates["limb-radiance"]["estimate"]["value"] == pytest.approx(2.0, abs=0.02)
    assert gates["limb-radiance"]["n_scenes"] == len(rendered)


def test_doubled_read_noise_is_caught(suite, base, rendered):
    def noisier(frame, camera, **options):
        key = "read_noise_e" if camera.detector.kind == "cmos" else "netd_k"
        changes = {key: 2 * getattr(camera.detector, key)}
        return observe(
            frame, camera.model_copy(update={"detector": camera.detector.model_copy(update=changes)}), **options
        )

    gates = rerender_gates(suite, base, images_with(suite, base, rendered, see=noisier))
    assert failed(gates) == {"detector-noise"}
    assert 40 < gates["detector-noise"]["estimate"]["value"] < 110
    assert gates["detector-noise"]["n_scenes"] == len(rendered)


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
    assert len(base.images.images) == len({(r.scene, r.band, r.replicate) for r in base.results.rows})
    assert {image.sha256 for image in base.images.images} == {row.image_address for row in base.results.rows}
    assert pack_path(BASELINE).is_file()
