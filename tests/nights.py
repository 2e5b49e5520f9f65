"""A night in small: scenes rendered once, with everything that a night has except processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import horizonval.renderer  # noqa: F401  (names the LLVM library before any test imports Dr.Jit)
from horizonval.frame import RadianceFrame
from horizonval.plugins import registry
from horizonval.spec.load import Suite
from horizonval.studies.regression import units
from horizonval.studies.regression.baseline import FrozenFrame, FrozenImage, Pack
from horizonval.studies.regression.gates import judge_images, judge_rows
from horizonval.studies.regression.images import compare_images
from horizonval.studies.regression.partners import pairs_of
from horizonval.studies.regression.row import ReplicateRow
from horizonval.suites.plan import CasePlan, plan_of, units_of
from horizonval.suites.suite import load_suite
from horizonval.suites.units import scored

Run = Callable[[str, Any], Any]


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
"""


def row(scene: str, error: float | None = 10.0, **columns: Any) -> ReplicateRow:
    """Return a row made by hand: a claim with an error, or without one a refusal that was due an answer."""
    plain = {"band": "vis", "replicate": 0, "estimator": "est", "image": "0", "reason": None, "false_valid": False}
    plain |= {"status": "dark" if error is None else "valid", "table": "day", "due": True, "bound_arcsec": None}
    plain |= {"roll_error_arcsec": None, "pitch_error_arcsec": None, "nees_nadir_total": None, "without_sigma": False}
    return ReplicateRow.from_dict({**plain, "scene": scene, "nadir_error_arcsec": error, **columns})


def plainly(name: str, observation: Any) -> Any:
    """Run an estimator in this process."""
    return registry.run_safely(registry.get(name), observation)


def estimating_with(patch: pytest.MonkeyPatch, run: Run) -> None:
    """Let ``run`` answer in place of the estimators' processes."""
    patch.setattr(scored, "supervisor_of", lambda limits: SimpleNamespace(run=run, spent_s=None))


def key_of(scene: Any) -> str:
    """Return the name of the frame of a scene and a head."""
    return f"{scene.scene.name}:{scene.camera.head}"


@dataclass
class Night:
    """A suite, its frames by scene and head, and the records and arrays of its units."""

    path: Path
    suite: Suite
    plan: CasePlan
    frames: dict[str, RadianceFrame] = field(default_factory=dict)
    made: dict[str, tuple[dict[str, Any], dict[str, np.ndarray]]] = field(default_factory=dict)
    _unchanged: dict[tuple[str, str], dict[str, Any]] = field(default_factory=dict)

    @property
    def scenes(self) -> dict[str, dict[str, Any]]:
        """What is recorded of every case."""
        return {name: about for record, _ in self.made.values() for name, about in record["scenes"].items()}

    @property
    def arrays(self) -> dict[str, np.ndarray]:
        """The arrays of all cases."""
        return {name: values for _, arrays in self.made.values() for name, values in arrays.items()}

    @property
    def rows(self) -> list[ReplicateRow]:
        """The base's rows."""
        return [ReplicateRow.from_dict(row) for record, _ in self.made.values() for row in record["rows"]]

    def make(
        self, render: Callable[..., Any] | None = None, run: Run | None = None, observe: Any = None
    ) -> dict[str, tuple[dict[str, Any], dict[str, np.ndarray]]]:
        """Return record and arrays of every unit, made with something in place of the package's own."""
        plan = CasePlan(self.plan.estimators if run is not None else ())
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(units, "_render", render or (lambda scene, camera: self.frames[key_of(scene)]))
            if observe is not None:
                patch.setattr(units, "observe", observe)
            if run is not None:
                estimating_with(patch, run)
            return {unit.name: units.render_unit(unit, plan, 1) for unit in units_of(self.suite.cases, self.plan)}

    def pack(self) -> Pack:
        """Return the frozen images of the base."""
        images = []
        for name, about in self.scenes.items():
            band, dn = about["bands"]["vis"], self.arrays[f"{name}:dn.vis.0"]
            images.append(FrozenImage(name, "vis", 0, band["full_scale"], dn, band["radiance_per_dn"][0]))
        return Pack(tuple(images), (), {name: about["truth"] for name, about in self.scenes.items()})

    def replayed(self, run: Run) -> list[ReplicateRow]:
        """Return the rows of the frozen images with something in place of the estimators."""
        before, pack = {row.key: row for row in self.rows}, self.pack()
        with pytest.MonkeyPatch.context() as patch:
            estimating_with(patch, run)
            rows = [row for name in self.scenes for row in units.replay_scene(pack, name, {}, self.plan)]
        return [row.against(before[row.key].bound_arcsec, table="day") for row in rows]

    def fresh(self, run: Run) -> list[ReplicateRow]:
        """Return the rows of scenes made again with something in place of the estimators."""
        return [ReplicateRow.from_dict(row) for record, _ in self.make(run=run).values() for row in record["rows"]]

    def unchanged(self) -> dict[tuple[str, str], dict[str, Any]]:
        """Return :meth:`again` without faults, worked out once."""
        if not self._unchanged:
            self._unchanged = self.again()
        return self._unchanged

    def again(self, **faults: Any) -> dict[tuple[str, str], dict[str, Any]]:
        """Return the images of every case compared with the base's, made with faults as in :meth:`make`."""
        found = {}
        for record, arrays in self.make(**faults).values():
            for case, now in record["scenes"].items():
                base, old = self.scenes[case]["bands"]["vis"], self.arrays
                radiance = old[f"{case}:radiance.vis"].astype(float)
                frozen = FrozenFrame(case, "vis", base["radiance_sha256"], radiance, old[f"{case}:regions"])
                new = arrays[f"{case}:radiance.vis"]
                found[case, "vis"] = compare_images(now["table"], now["bands"]["vis"], base, new, frozen)
        return found

    def failed(self, rows: Any = None, images: Any = None) -> dict[str, set[str]]:
        """Return the scenes of the metrics that fail, by metric; what is not given has not changed."""
        assert self.suite.regression is not None
        gates = judge_rows(self.suite.regression, "replay", pairs_of(rows or self.rows, self.rows), {})
        gates += judge_images(self.suite.regression, images or {}, {})
        return {gate["metric"]: set(gate["scenes"]) for gate in gates if gate["verdict"] == "FAIL"}


def rendered(path: Path, text: str) -> Night:
    """Return a suite's night, rendered and estimated once."""
    from horizonval.renderer.frame import render_frame

    path.write_text(text, encoding="utf-8")
    suite = load_suite(path)
    night = Night(path, suite, plan_of(suite))
    night.made = night.make(lambda s, c: night.frames.setdefault(key_of(s), render_frame(s, c)), plainly)
    return night
