"""A night in small: eight scenes of 96 pixels, rendered once, with everything a night has but processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.frame import FrameTruth, RadianceFrame
from horizonval.plugins import registry
from horizonval.spec.load import Case, Suite
from horizonval.studies.regression.baseline.pack import FrozenFrame, FrozenImage
from horizonval.studies.regression.images import compare_images
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics.gates import GateInputs
from horizonval.studies.regression.units import estimate_frozen, is_due, render_scene
from horizonval.suites.plan import CasePlan, plan_of
from horizonval.suites.suite import load_suite

SUITE = """
[suite]
name = "tiny"
seed = 3
estimators = ["altitude-free"]

[defaults]
camera = { file = "vis-cmos-512-60deg", mount_roll_deg = 55.0 }
platform = { epoch_utc = 2026-03-20T12:00:00Z, altitude_km = 500.0 }
render = { subsamples = 1, nodes = 32, orders = "single" }

[[cases]]
name = "day"
base.camera.detector.exposure_s = 1.2e-4
base.camera.camera = { width = 96, height = 96, fov_deg = 110.0, distortion = [-0.02, 0.0, 0.0, 0.0, 0.0] }
sobol.n = 8
sobol.ranges = { "sun.zenith_deg" = [10.0, 40.0], "sun.azimuth_deg" = [45.0, 90.0], "attitude.roll_deg" = [-6.0, 6.0] }

[regression]
replicates = 1

[[regression.gate]]
name = "accuracy"
lane = "replay"
metric = "nadir_error"
margin = 20.0
unit = "arcsec"
reason = "five percent of what images of 96 pixels allow"

[[regression.gate]]
name = "limb"
lane = "rerender"
metric = "limb_radiance"
margin = 1.0
unit = "%"
reason = "radiances are known to one percent"

[[regression.gate]]
name = "disc"
lane = "rerender"
metric = "disc_radiance"
margin = 1.0
unit = "%"
reason = "radiances are known to one percent"

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
"""


@dataclass
class Night:
    """The tiny suite, its frames by scene, the records and arrays of its base."""

    path: Path
    suite: Suite
    plan: CasePlan
    replicates: int = 1
    frames: dict[str, RadianceFrame] = field(default_factory=dict)
    records: dict[str, dict[str, Any]] = field(default_factory=dict)
    arrays: dict[str, dict[str, Any]] = field(default_factory=dict)
    _unchanged: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)

    def case(self, scene: str) -> Case:
        """Return a case by its name."""
        return next(case for case in self.suite.cases if case.name == scene)

    def frozen(self, scene: str) -> FrozenFrame:
        """Return a frame as a pack keeps it, but for its rounding."""
        record, arrays = self.records[scene], self.arrays[scene]
        sha = record["bands"]["vis"]["radiance_sha256"]
        return FrozenFrame(scene, "vis", sha, arrays["radiance.vis"].astype(float), arrays["regions"])

    def results(self) -> GateInputs:
        """Return the base's rows."""
        return GateInputs(rows=[row for record in self.records.values() for row in rows_of(record)])

    def replayed(self, run: Callable[[str, Any], Any]) -> GateInputs:
        """Return the rows of the base's images with something in place of the estimators."""
        rows = []
        for scene, record in self.records.items():
            images = [
                FrozenImage(
                    scene, "vis", seed, record["bands"]["vis"]["full_scale"], self.arrays[scene][f"dn.vis.{seed}"]
                )
                for seed in range(self.replicates)
            ]
            truth = FrameTruth.from_dict(record["truth"])
            found = estimate_frozen(truth, scene, images, self.plan, run=run)
            due = is_due(record["bands"]["vis"])
            rows += [replace(row, table=record["table"], due=due) for row in found]
        return GateInputs(rows=rows)

    def unchanged(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Return :meth:`again` without faults, worked out once."""
        if not self._unchanged:
            self._unchanged = self.again()
        return self._unchanged

    def again(self, **faults: Any) -> dict[tuple[str, str], dict[str, Any]]:
        """Return every scene beside the base, made with ``render`` or ``observe`` in place of the package's own."""
        found = {}
        for scene, base in self.records.items():
            faults.setdefault("render", lambda s, c: self.frames[s.scene.name])
            record, arrays = render_scene(self.case(scene), self.plan, self.replicates, estimate=False, **faults)
            radiance, frozen = arrays["radiance.vis"], self.frozen(scene)
            found[scene, "vis"] = compare_images("day", record["bands"]["vis"], base["bands"]["vis"], radiance, frozen)
        return found


def rows_of(record: dict[str, Any]) -> list[ReplicateRow]:
    """Return the rows of a record."""
    return [ReplicateRow.from_dict(row) for row in record["rows"]]


def plainly(name: str, observation: Any) -> Any:
    """Run an estimator in this process."""
    return registry.run_safely(registry.get(name), observation)


@pytest.fixture(scope="session")
def night(tmp_path_factory) -> Night:
    """Render and estimate the tiny suite once."""
    from horizonval.renderer.scene.frame import render_frame

    path = tmp_path_factory.mktemp("tiny") / "tiny.toml"
    path.write_text(SUITE, encoding="utf-8")
    suite = load_suite(path)
    made = Night(path, suite, plan_of(suite))

    def render(scene: Any, camera: Any) -> RadianceFrame:
        frame = render_frame(scene, camera)
        made.frames[scene.scene.name] = frame
        return frame

    for case in suite.cases:
        made.records[case.name], made.arrays[case.name] = render_scene(
            case, made.plan, made.replicates, render=render, run=plainly
        )
    return made
