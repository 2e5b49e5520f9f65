"""Faults put into one head or into a method that sees all heads: rendering again and fresh scenes catch each.

That frozen images catch them is a matter of :mod:`test_heads_of_nights`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from horizonval.core.outcome import Outcome, Refusal
from horizonval.frame import RadianceFrame
from horizonval.plugins import registry
from horizonval.sensor.observe import observe
from horizonval.spec.load import Suite
from horizonval.studies.regression.baseline.pack import FrozenFrame
from horizonval.studies.regression.heads import render_heads
from horizonval.studies.regression.images import compare_images
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics.gates import GateInputs, measure
from horizonval.studies.regression.statistics.judge import judge
from horizonval.suites.plan import CasePlan, plan_of, units_of
from horizonval.suites.suite import load_suite

SCENES = 8
SUITE = f"""
[suite]
name = "pairs"
seed = 3
keep = "none"
estimators = ["video-vertical"]

[defaults]
camera.file = "vis-pair-1024-60deg"
camera.mount_roll_deg = 0.0
camera.camera = {{ width = 64, height = 64, fov_deg = 60.0 }}
platform = {{ epoch_utc = 2026-03-20T12:00:00Z, latitude_deg = 40.0, heading_deg = 350.0, altitude_km = 500.0 }}
sun = {{ zenith_deg = 10.0, azimuth_deg = 40.0 }}
render = {{ subsamples = 1, nodes = 32, orders = "single" }}

[[cases]]
name = "pair"
sobol = {{ n = {SCENES}, ranges = {{ "attitude.roll_deg" = [-2.0, 2.0], "attitude.pitch_deg" = [-2.0, 2.0] }} }}

[regression]
replicates = 1

[[regression.gate]]
name = "moved"
lane = "rerender"
metric = "limb_displacement"
margin = 0.1
unit = "px"
reason = "sub-pixel edges are good to a tenth of a pixel"

[[regression.gate]]
name = "noise"
lane = "rerender"
metric = "noise"
margin = 5.0
unit = "%"
reason = "data sheets give read noise to two figures"

[[regression.gate]]
name = "fresh"
lane = "fresh"
metric = "nadir_error"
margin = 100.0
unit = "arcsec"
reason = "a tenth of a pixel of these heads is 340 arcsec; pairs of the same scenes tell less"

[[regression.gate]]
name = "available"
lane = "fresh"
metric = "availability"
margin = 50.0
unit = "percentage points"
reason = "eight scenes without a loss still allow one in three"
"""


@dataclass
class Pairs:
    """The suite, its frames by case, and the record and arrays of every scene."""

    suite: Suite
    plan: CasePlan
    frames: dict[str, RadianceFrame] = field(default_factory=dict)
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    arrays: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)

    def make(self, **options: Any) -> dict[str, tuple[dict[str, Any], dict[str, np.ndarray]]]:
        """Return record and arrays of every scene."""
        units = units_of(self.suite.cases, self.plan)
        return {unit.name: render_heads(unit.cases, self.plan, 1, **options) for unit in units}

    def again(
        self, head: str, change: Callable[[RadianceFrame], RadianceFrame] = lambda frame: frame, **options: Any
    ) -> dict[tuple[str, str], dict[str, Any]]:
        """Return every head beside its base, the frames of one of them changed."""

        def render(scene: Any, camera: Any) -> RadianceFrame:
            frame = self.frames[case_of(scene)]
            return change(frame) if scene.camera.head == head else frame

        found = {}
        for name, (record, arrays) in self.make(estimate=False, render=render, **options).items():
            for now, base in zip(record["heads"], self.records[name]["heads"], strict=True):
                case, (about, before) = now["scene"], (now["bands"]["vis"], base["bands"]["vis"])
                old = self.arrays[name][f"{case}:radiance.vis"].astype(float)
                sha, regions = before["radiance_sha256"], self.arrays[name][f"{case}:regions"]
                frozen = FrozenFrame(case, "vis", sha, old, regions)
                found[case, "vis"] = compare_images("pair", about, before, arrays[f"{case}:radiance.vis"], frozen)
        return found

    def fresh(self, run: Callable[[str, Any], Any]) -> list[ReplicateRow]:
        """Return the rows of all heads with something in place of the method."""
        made = self.make(render=lambda scene, camera: self.frames[case_of(scene)], run=run)
        return [row for record, _ in made.values() for row in rows_of(record)]

    def verdicts(self, **now: Any) -> dict[str, dict[str, Any]]:
        """Return all gates by name; fresh rows are those of the base's own night."""
        rows = [row for record in self.records.values() for row in rows_of(record)]
        base = GateInputs(fresh=rows, fresh_night="then")
        mine = GateInputs(images=now.get("images", {}), fresh=now.get("fresh", rows), fresh_night="then")
        lanes = {"rerender"} if "images" in now else {"fresh"}
        measured = [measure(gate, mine, base) for gate in self.suite.regression.gate if gate.lane in lanes]
        return {gate["name"]: gate for gate in judge([("accepted", one) for one in measured])}


def plainly(name: str, observation: Any) -> Any:
    return registry.run_safely(registry.get(name), observation)


def rows_of(record: dict[str, Any]) -> list[ReplicateRow]:
    return [ReplicateRow.from_dict(row) for row in record["rows"]]


def case_of(scene: Any) -> str:
    return f"{scene.scene.name}:{scene.camera.head}"


@pytest.fixture(scope="module")
def pairs(tmp_path_factory) -> Pairs:
    from horizonval.renderer.scene.frame import render_frame

    path = tmp_path_factory.mktemp("pairs") / "pairs.toml"
    path.write_text(SUITE, encoding="utf-8")
    suite = load_suite(path)
    made = Pairs(suite, plan_of(suite))

    def render(scene: Any, camera: Any) -> RadianceFrame:
        return made.frames.setdefault(case_of(scene), render_frame(scene, camera))

    for name, (record, arrays) in made.make(render=render, run=plainly).items():
        made.records[name], made.arrays[name] = record, arrays
    assert len(made.records) == SCENES
    assert len(made.frames) == 2 * SCENES
    return made


@pytest.fixture(scope="module")
def heads(pairs) -> tuple[str, str]:
    """The names of the first and of the second head."""
    first, second = dict(next(iter(pairs.records.values()))["together"]["heads"])
    return first, second


def cases_of(pairs: Pairs, head: str) -> set[str]:
    return {dict(record["together"]["heads"])[head] for record in pairs.records.values()}


def test_without_a_fault_all_is_quiet(pairs, heads):
    images = pairs.again(heads[0])
    assert all(one["same_radiance"] and one["same_images"] == one["n_images"] == 1 for one in images.values())
    gates = pairs.verdicts(images=images) | pairs.verdicts(fresh=pairs.fresh(plainly))
    assert {gate["verdict"] for gate in gates.values()} == {"PASS"}
    assert all(gate["scenes"] == [] for gate in gates.values())


@pytest.mark.parametrize("which", [0, 1])
def test_half_a_pixel_in_one_head_is_caught_by_rendering_again(pairs, heads, which):
    def shifted(frame: RadianceFrame) -> RadianceFrame:
        moved = ndimage.shift(frame.radiance["vis"].astype(float), (0.5, 0.5), order=1, mode="nearest")
        return replace(frame, radiance={"vis": moved.astype(np.float32)})

    gates = pairs.verdicts(images=pairs.again(heads[which], shifted))
    assert gates["moved"]["verdict"] == "FAIL"
    assert set(gates["moved"]["scenes"]) == cases_of(pairs, heads[which]), "the other head stays where it was"


def test_doubled_read_noise_of_one_head_is_caught_by_observing_again(pairs, heads):
    def noisier(frame, camera, **options):
        if frame.truth.head == heads[1]:
            detector = camera.detector.model_copy(update={"read_noise_e": 2 * camera.detector.read_noise_e})
            camera = camera.model_copy(update={"detector": detector})
        return observe(frame, camera, **options)

    gates = pairs.verdicts(images=pairs.again(heads[0], observe=noisier))
    assert gates["noise"]["verdict"] == "FAIL"
    assert set(gates["noise"]["scenes"]) == cases_of(pairs, heads[1])
    assert gates["moved"]["verdict"] == "PASS", "noise is not displacement"


def test_a_worse_method_of_all_heads_is_caught_on_fresh_scenes(pairs):
    """Every answer is pushed away from the first head's true nadir by 300 arcsec, three times the margin."""
    order = iter([np.array(one["heads"][0]["truth"]["nadir_geocentric_cam"]) for one in pairs.records.values()])

    def worse(name, observation):
        fit, true = plainly(name, observation), next(order)
        assert not isinstance(fit, Refusal)
        off = fit.nadir_cam - true
        pushed = fit.nadir_cam + np.radians(300.0 / 3600.0) * off / np.linalg.norm(off)
        return replace(fit, nadir_cam=pushed / np.linalg.norm(pushed))

    gates = pairs.verdicts(fresh=pairs.fresh(worse))
    assert gates["fresh"]["verdict"] == "FAIL"
    assert gates["fresh"]["estimate"]["value"] == pytest.approx(300.0, rel=0.01)
    assert set(gates["fresh"]["scenes"]) == set(pairs.records)
    assert gates["available"]["verdict"] == "PASS"


def test_a_method_that_loses_its_heads_is_caught_on_fresh_scenes(pairs):
    """Where all answers are lost no error is left to compare: availability must say so."""

    def lost(name, observation):
        return Refusal(Outcome.NO_LIMB, "one head was not looked at")

    gates = pairs.verdicts(fresh=pairs.fresh(lost))
    assert gates["available"]["verdict"] == "FAIL"
    assert set(gates["available"]["scenes"]) == set(pairs.records)
