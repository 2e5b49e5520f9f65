"""Faults put in on purpose: the lane they belong to catches each and names the scenes; without them all is quiet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from horizonval.core.outcome import Outcome, Refusal
from horizonval.plugins import registry
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.suite import UNITS, GateSpec
from horizonval.studies.regression.regions import LIMB, regions_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics.gates import GateInputs, changed, measure, pairs_of
from horizonval.studies.regression.statistics.judge import judge


def plainly(name, observation):
    return registry.run_safely(registry.get(name), observation)


def verdicts(night, *, rows=None, images=None):
    """Every gate of the tiny suite by name, decided together."""
    base = night.results()
    now = GateInputs(rows if rows is not None else base.rows, images if images is not None else night.unchanged())
    gates = [measure(gate, now, base) for gate in night.suite.regression.gate]
    return {gate["name"]: gate for gate in judge([("accepted", gate) for gate in gates])}


def test_nothing_changed_passes_bit_by_bit(night):
    images = night.unchanged()
    assert all(one["same_radiance"] and one["same_images"] == one["n_images"] == 1 for one in images.values())
    again = night.replayed(plainly)
    assert changed(pairs_of(again.rows, night.results().rows)) == []
    found = verdicts(night, rows=again.rows, images=images)
    assert {gate["verdict"] for gate in found.values()} == {"PASS"}
    assert all(gate["estimate"]["value"] == 0.0 and gate["scenes"] == [] for gate in found.values())


def test_an_error_ten_percent_larger_is_caught_by_replay(night):
    """Every claimed nadir is pushed away from the true one by a tenth of the mean error.

    By a tenth of its own error the change would scatter from scene to scene as the errors do, over a factor of 25, and
    eight scenes would not tell it from chance.
    """
    claims = [row for row in night.results().rows if row.nadir_error_arcsec is not None]
    before = np.mean([row.nadir_error_arcsec for row in claims])
    truth = {}
    for scene, record in night.records.items():
        for seed in range(night.replicates):
            truth[night.arrays[scene][f"dn.vis.{seed}"].tobytes()] = record["truth"]["nadir_geocentric_cam"]

    def worse(name, observation):
        result = plainly(name, observation)
        if isinstance(result, Refusal):
            return result
        true = np.array(truth[observation.image.astype(np.uint16).tobytes()])
        off = result.nadir_cam - true
        pushed = result.nadir_cam + 0.1 * np.radians(before / 3600.0) * off / np.linalg.norm(off)
        return replace(result, nadir_cam=pushed / np.linalg.norm(pushed))

    rows = night.replayed(worse).rows
    found = verdicts(night, rows=rows)
    assert found["accuracy"]["verdict"] == "FAIL"
    assert found["accuracy"]["estimate"]["value"] == pytest.approx(0.1 * before, rel=0.01)
    assert set(found["accuracy"]["scenes"]) == {row.scene for row in claims}
    assert len(claims) > 5
    assert {name for name, gate in found.items() if gate["verdict"] != "PASS"} == {"accuracy"}
    moved = changed(pairs_of(rows, night.results().rows))
    assert {one["scene"] for one in moved} == {row.scene for row in claims}
    assert all("nadir error" in one["what"] for one in moved)


def test_half_a_pixel_is_caught_by_rendering_again(night):
    def shifted(scene, camera):
        frame = night.frames[scene.scene.name]
        moved = ndimage.shift(frame.radiance["vis"].astype(float), (0.5, 0.5), order=1, mode="nearest")
        return replace(frame, radiance={"vis": moved.astype(np.float32)})

    found = verdicts(night, images=night.again(render=shifted))
    assert found["moved"]["verdict"] == "FAIL"
    # Half a pixel in both axes is 0 to 0.71 px across the limb, by its direction.
    assert 0.2 < found["moved"]["estimate"]["value"] < 0.71
    assert set(found["moved"]["scenes"]) == set(night.records)
    assert found["accuracy"]["verdict"] == "PASS"


def test_a_wrong_sign_of_k1_is_caught_by_rendering_again(night):
    from horizonval.renderer.scene.frame import render_frame

    def wrong(scene, camera):
        lens = camera.camera.model_copy(update={"distortion": [0.02, 0.0, 0.0, 0.0, 0.0]})
        made = render_frame(scene, camera.model_copy(update={"camera": lens}))
        return replace(night.frames[scene.scene.name], radiance=made.radiance)

    found = verdicts(night, images=night.again(render=wrong))
    assert found["moved"]["verdict"] == "FAIL"
    assert set(found["moved"]["scenes"]) == set(night.records)


def test_two_percent_more_light_at_the_limb_is_caught_there(night):
    def brighter(scene, camera):
        frame = night.frames[scene.scene.name]
        limb = regions_of(frame.maps["hit"], frame.maps["tangent_height"]) == LIMB
        return replace(frame, radiance={"vis": frame.radiance["vis"] * np.where(limb, 1.02, 1.0).astype(np.float32)})

    found = verdicts(night, images=night.again(render=brighter))
    assert found["limb"]["verdict"] == "FAIL"
    assert found["limb"]["estimate"]["value"] == pytest.approx(2.0, abs=0.01)
    assert set(found["limb"]["scenes"]) == set(night.records)
    assert found["disc"]["verdict"] == "PASS"
    assert found["moved"]["verdict"] == "PASS", "light is not displacement"


def test_doubled_read_noise_is_caught_by_observing_again(night):
    def noisier(frame, camera: CameraSpec, **options):
        detector = camera.detector.model_copy(update={"read_noise_e": 2 * camera.detector.read_noise_e})
        return observe(frame, camera.model_copy(update={"detector": detector}), **options)

    found = verdicts(night, images=night.again(observe=noisier))
    assert found["noise"]["verdict"] == "FAIL"
    # 1 DN of read noise beside 0.29 DN of rounding: a factor of 1.93.
    assert 80 < found["noise"]["estimate"]["value"] < 100
    assert {found[name]["verdict"] for name in ("limb", "disc", "moved", "accuracy")} == {"PASS"}


def rows_of(outcomes, *, due=True, false=()):
    """Return rows of one image a scene with these statuses."""
    return [
        ReplicateRow(
            scene=f"scene-{i:03d}",
            band="vis",
            replicate=0,
            estimator="method",
            image="",
            status=str(outcome),
            reason=None,
            false_valid=i in false,
            nadir_error_arcsec=100.0 if outcome == Outcome.VALID else None,
            roll_error_arcsec=None,
            pitch_error_arcsec=None,
            table="day",
            due=due,
        )
        for i, outcome in enumerate(outcomes)
    ]


def gate_of(metric, lane="replay", margin=1.5):
    unit = UNITS[metric]
    reason = "as in the nightly suite, for this test"
    return GateSpec(name=metric, lane=lane, metric=metric, margin=margin, unit=unit, reason=reason)


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


def test_false_claims_are_a_gate_of_their_own():
    base = rows_of([Outcome.VALID] * 300)
    now = rows_of([Outcome.VALID] * 300, false=range(12))
    found = [
        measure(gate_of(m, margin=1.0), GateInputs(now), GateInputs(base)) for m in ("false_valid", "availability")
    ]
    false, availability = judge([("accepted", one) for one in found])
    assert (false["verdict"], availability["verdict"]) == ("FAIL", "PASS")
    assert false["scenes"] == [f"scene-{i:03d}" for i in range(12)]


def test_fresh_scenes_are_paired_only_with_the_same_night():
    """The same loss: hidden among other scenes, plain beside the reference version's run of the same night."""
    valid, lost = Outcome.VALID, Outcome.NO_LIMB
    base = GateInputs(fresh=rows_of([lost if i % 12 == 0 else valid for i in range(96)]), fresh_night="monday")
    now = rows_of([lost if i % 12 in (0, 1) else valid for i in range(96)])
    gate = gate_of("availability", "fresh", margin=15.0)
    other = measure(gate, GateInputs(fresh=now, fresh_night="tuesday"), base)
    same = measure(gate, GateInputs(fresh=now, fresh_night="monday"), base)
    assert not other.paired
    assert same.paired
    assert [one.estimate.value for one in (other, same)] == pytest.approx([100 / 12] * 2)
    assert same.estimate.p_worse == pytest.approx(2.0**-8)
    assert other.estimate.p_worse > 0.01
    unknown = measure(gate, GateInputs(fresh=now), GateInputs(fresh=now))
    assert not unknown.paired


def bounded(bound, error):
    return [replace(row, bound_arcsec=bound, nadir_error_arcsec=error) for row in rows_of([Outcome.VALID] * 40)]


@pytest.mark.parametrize("lane", ["replay", "fresh"])
def test_an_error_further_from_its_bound_is_caught(lane):
    """Also where the error itself is the same: frames that allow more are used worse."""

    def inputs(rows, night):
        spread = [replace(r, nadir_error_arcsec=r.nadir_error_arcsec + i % 5) for i, r in enumerate(rows)]
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


def test_without_bounds_nothing_is_decided_about_them():
    """Baselines from before they were kept."""
    now, base = bounded(100.0, 120.0), bounded(None, 120.0)
    (gate,) = judge([("accepted", measure(gate_of("error_over_bound"), GateInputs(now), GateInputs(base)))])
    assert (gate["verdict"], gate["estimate"]) == ("INCONCLUSIVE", None)


def test_a_method_that_the_baseline_has_not_changes_nothing():
    base = bounded(100.0, 120.0)
    new = [replace(row, estimator="new", nadir_error_arcsec=5000.0) for row in base]
    gate = gate_of("nadir_error", "fresh", margin=20.0)
    found = measure(gate, GateInputs(fresh=[*base, *new], fresh_night="b"), GateInputs(fresh=base, fresh_night="a"))
    assert not found.paired
    assert found.estimate.value == 0.0
