"""Estimates of files: the truth is not given, each head comes once, and what an ideal sensor reads of a pose."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from synthetic import toy_image, truth_at

from horizonval.api.estimate import estimate_report, horizon_report, sources_of_heads
from horizonval.core.errors import UserError
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.ellipsoid import sphere
from horizonval.plugins import registry
from horizonval.store import exr
from horizonval.store.picture import GreyImage

OFF_RAD = math.radians(0.25)


def numbers(value: Any) -> list[float]:
    """Every number in a value, whatever holds it."""
    if dataclasses.is_dataclass(value):
        value = [getattr(value, f.name) for f in dataclasses.fields(value)]
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, np.ndarray):
        return [] if value.ndim > 1 else value.ravel().tolist()
    if isinstance(value, list | tuple):
        return [number for item in value for number in numbers(item)]
    return [float(value)] if isinstance(value, int | float) else []


@pytest.mark.parametrize("estimates", ["geocentric", "geodetic"])
def test_the_error_is_that_of_the_answer_and_the_truth_is_not_given(tmp_path, estimates):
    truth = truth_at(roll_deg=66.0)
    exr.write_image(tmp_path / "a.exr", toy_image(truth))
    nadir = np.array(truth.nadir_geodetic_cam if estimates == "geodetic" else truth.nadir_geocentric_cam)
    across = np.cross(nadir, [0.0, 1.0, 0.0])
    answer = math.cos(OFF_RAD) * nadir + math.sin(OFF_RAD) * across / np.linalg.norm(across)
    given: list[Observation] = []

    def run(observation: Observation) -> Fit:
        given.append(observation)
        return Fit(nadir_cam=answer, covariance_nadir_cam=1e-6 * np.eye(3), roll_rad=1.0, pitch_rad=0.0)

    method = Estimator(name="told", title="told", run=run, estimates=estimates)
    report = estimate_report(tmp_path / "a.exr", method)
    assert report["nadir_error_arcsec"] == pytest.approx(math.degrees(OFF_RAD) * 3600, rel=1e-9)
    assert report["false_valid"] is False
    assert given[0].oracle is None
    secret = {*truth.r_itrs, *truth.q_cam_from_itrs, *truth.nadir_geodetic_cam, *truth.nadir_geocentric_cam}
    assert not secret & set(numbers(given[0]))


def picture(head: str) -> GreyImage:
    truth = SimpleNamespace(
        head=head, camera={}, r_itrs=(7e6, 0.0, 0.0), epoch_utc="", roll_rad=0.0, pitch_rad=0.0, yaw_rad=0.0
    )
    source: Any = SimpleNamespace(truth=truth)
    return GreyImage(np.zeros((4, 4)), None, source)


@pytest.mark.parametrize("names", [("a.exr", "b.exr"), ("a.exr", "a.exr")])
def test_a_second_image_of_a_head_is_refused(names):
    method = registry.get("video-vertical")
    with pytest.raises(UserError, match="a second image of the head 'left'") as caught:
        sources_of_heads([(name, picture("left")) for name in names], method)
    assert caught.value.where == names[1]


CAMERA = {
    "camera": {"name": "c", "width": 64, "height": 48, "fov_deg": 50.0},
    "band": [{"name": "red", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7}],
}


def test_both_readings_of_a_pose_off_the_nadir() -> None:
    truth = truth_at(CAMERA, roll_deg=55.0, yaw_deg=20.0, altitude_km=700.0)
    found = horizon_report(truth)
    assert found["status"] == "defined"
    off = math.degrees(math.acos(truth.nadir_geocentric_cam[2]))
    assert found["pitch_error_deg"] == pytest.approx(off - found["angular_radius_deg"], abs=1e-9)
    # The boresight is less than a quarter turn from the plane: both readings of the pitch agree.
    assert found["pitch_elevation_deg"] == pytest.approx(found["pitch_error_deg"], abs=1e-9)
    assert found["roll_deg"] == pytest.approx(55.0)


def test_a_boresight_at_the_nadir_has_a_status_and_no_number() -> None:
    """Over a sphere, where the geodetic and the geocentric nadir are one."""
    truth = truth_at(CAMERA, ellipsoid=sphere(6371e3))
    found = horizon_report(truth)
    assert found["status"] == "boresight_at_nadir"
    assert found["roll_error_deg"] is None
    assert found["horizon_cam"] is None
