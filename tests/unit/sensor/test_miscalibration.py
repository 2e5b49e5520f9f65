"""What a platform believes of its camera: the stated errors and drawn ones, the same whenever they are asked for."""

from __future__ import annotations

import math
from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import toy_image, truth_at

from horizonval.core.errors import UserError
from horizonval.estimation.lens_error import k1_per_px, miscalibrated
from horizonval.estimation.methods import altitude_free
from horizonval.estimation.observation import Observation
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.sensor.knowledge import errors_of, stated_sigmas
from horizonval.spec.prior import CalibrationSpec
from horizonval.suites.observation import observation_of

PINHOLE = CameraModel(width=640, height=480, fx=550.0, fy=551.0, cx=318.0, cy=240.5, distortion=(-0.1, 0.02, 0, 0, 0))
FISHEYE = replace(PINHOLE, projection="fisheye", fx=300.0, fy=300.0, distortion=(0.01, 0.0, 0.0, 0.0, 0.0))
KNOWN = {"position_sigma_km": 1.0, "attitude_sigma_deg": (0.5, 0.5, 0.5)}


def with_tables(**tables: Any) -> FrameTruth:
    truth = truth_at(roll_deg=20.0, yaw_deg=-40.0, mount_roll_deg=50.0)
    return replace(truth, scene={**truth.scene, "scene": {"name": "one", "seed": 3}, **tables})


def told(**calibration: Any) -> tuple[FrameTruth, Observation, Observation]:
    """Return a truth, and what is told of its frame without and with errors of the calibration."""
    wrong = with_tables(prior=KNOWN, calibration=calibration)
    right = with_tables(prior=KNOWN)
    both = [observation_of(toy_image(one), altitude_free.ESTIMATOR) for one in (right, wrong)]
    return right, both[0], both[1]


def test_without_the_table_everything_told_is_exact() -> None:
    truth = with_tables()
    seen = observation_of(toy_image(truth), altitude_free.ESTIMATOR)
    assert seen.camera == truth.camera_model
    assert tuple(seen.q_cam_from_body) == truth.q_cam_from_body
    assert seen.calibration is None


def test_stated_errors_are_those_of_the_camera() -> None:
    _, right, wrong = told(
        focal_length_error_percent=1.0, principal_point_error_px=[2.0, -3.0], distortion_error_px=1.5
    )
    assert wrong.camera.fx == pytest.approx(1.01 * right.camera.fx, rel=1e-15)
    assert wrong.camera.fy == pytest.approx(1.01 * right.camera.fy, rel=1e-15)
    assert wrong.camera.cx - right.camera.cx == 2.0
    assert wrong.camera.cy - right.camera.cy == -3.0
    assert wrong.camera.distortion[0] > right.camera.distortion[0]
    assert np.array_equal(wrong.image, right.image)
    assert wrong.calibration is None


@pytest.mark.parametrize("camera", [PINHOLE, FISHEYE])
def test_distortion_moves_the_farthest_corner_by_its_pixels(camera: CameraModel) -> None:
    """The farthest corner is that across the principal point; the place itself is followed through both cameras."""
    corner = np.array([639.5, -0.5])
    direction = unproject(camera, corner)
    moved = project(miscalibrated(camera, distortion_px=1.5), direction)[0] - corner
    assert float(np.hypot(*moved)) == pytest.approx(1.5, rel=2e-3)
    assert moved[0] > 0.0 > moved[1]


def test_the_corner_of_an_image_circle_is_its_edge() -> None:
    circle = replace(FISHEYE, image_circle_rad=1.2)
    assert k1_per_px(circle) == pytest.approx(1.0 / (300.0 * 1.2**3))


def test_distortions_that_cannot_be_are_one_line() -> None:
    with pytest.raises(UserError, match="equal_angle has no distortion"):
        miscalibrated(replace(PINHOLE, projection="equal_angle", distortion=(0,) * 5), distortion_px=1.0)
    with pytest.raises(UserError, match=r"calibration: .*folds inside the image"):
        told(distortion_error_px=-300.0)


def test_a_mounting_adds_its_error_to_roll_and_pitch() -> None:
    """Of a level body, to first order; with the camera's own axes untouched."""
    truth = with_tables(calibration={"mounting_error_deg": [0.3, -0.2, 0.7]})
    level = replace(truth_at(mount_roll_deg=50.0), scene=truth.scene)
    seen = observation_of(toy_image(level), altitude_free.ESTIMATOR)
    nadir_body = Rotation.from_quat(seen.q_cam_from_body).inv().apply(level.nadir_geocentric_cam)
    roll, pitch = math.atan2(nadir_body[1], nadir_body[2]), math.asin(-nadir_body[0])
    assert math.degrees(roll) == pytest.approx(0.3, abs=5e-3)
    assert math.degrees(pitch) == pytest.approx(-0.2, abs=5e-3)


def test_what_is_known_on_the_body_comes_by_the_wrong_mounting() -> None:
    _, right, wrong = told(mounting_error_deg=[0.3, -0.2, 0.7])
    assert right.prior.q_cam_from_itrs is not None
    assert wrong.prior.q_cam_from_itrs is not None
    for one, other in ((right, wrong), (wrong, right)):
        body = [Rotation.from_quat(x.q_cam_from_body).inv() for x in (one, other)]
        attitudes = [
            b * Rotation.from_quat(np.array(x.prior.q_cam_from_itrs)) for b, x in zip(body, (one, other), strict=True)
        ]
        assert (attitudes[0] * attitudes[1].inv()).magnitude() < 1e-12
    assert right.sun_cam is not None
    assert wrong.sun_cam is not None
    suns = [Rotation.from_quat(x.q_cam_from_body).inv().apply(x.sun_cam) for x in (right, wrong)]
    assert np.allclose(suns[0], suns[1], atol=1e-12)


def predicted_nadir(told_so: Observation) -> np.ndarray:
    """Return the nadir in camera axes by what the platform says of place and attitude."""
    down = -told_so.prior.r_itrs / np.linalg.norm(told_so.prior.r_itrs)
    return np.asarray(Rotation.from_quat(told_so.prior.q_cam_from_itrs).apply(down))


def test_a_second_of_the_clock_is_seven_and_a_half_kilometres_ahead() -> None:
    truth, right, wrong = told(clock_error_s=1.0)
    moved = wrong.prior.r_itrs - right.prior.r_itrs
    forward = Rotation.from_quat(truth.q_body_from_lvlh).inv() * Rotation.from_quat(truth.q_cam_from_body).inv()
    forward_itrs = (forward * Rotation.from_quat(truth.q_cam_from_itrs)).inv().apply([1.0, 0.0, 0.0])
    # A circle at 6870 km: 7617 m/s; the ground below goes east at 0.53 km/s at latitude 40.
    assert float(moved @ forward_itrs) == pytest.approx(7617.0, rel=2e-3)
    assert float(np.linalg.norm(moved)) == pytest.approx(math.hypot(7617.0, 384.0), rel=5e-3)
    assert wrong.prior.epoch_utc == datetime.fromisoformat(truth.epoch_utc) + timedelta(seconds=1.0)


def test_a_late_exposure_has_position_and_attitude_of_the_stamp() -> None:
    """A body that keeps to the local vertical has turned with it; both together see the Earth where it was."""
    _, right, wrong = told(exposure_offset_s=20.0)
    nadirs = [predicted_nadir(one) for one in (right, wrong)]
    # The 0.5 deg that the prior is off by turn with the orbit's 1.3 deg: a product of 2e-4 rad. Without the turn: 2e-2.
    assert np.allclose(nadirs[0], nadirs[1], atol=5e-4)
    assert float(np.linalg.norm(wrong.prior.r_itrs - right.prior.r_itrs)) > 20 * 7000.0


def test_a_clock_moves_the_nadir_that_is_predicted_by_the_orbit_s_rate() -> None:
    """The attitude is the stars', the place the clock's: 360 deg in 94.5 min."""
    _, right, wrong = told(clock_error_s=10.0)
    nadirs = [predicted_nadir(one) for one in (right, wrong)]
    angle = math.degrees(math.acos(float(nadirs[0] @ nadirs[1])))
    assert angle == pytest.approx(10.0 * 360.0 / (94.5 * 60.0), rel=3e-3)


def test_values_that_are_stated_stay() -> None:
    place = [7000.0, 0.0, 0.0]
    truth = with_tables(
        prior={**KNOWN, "position_itrs_km": place}, calibration={"clock_error_s": 5.0, "clock_sigma_s": 0.0}
    )
    prior = observation_of(toy_image(truth), altitude_free.ESTIMATOR).prior
    assert np.allclose(prior.r_itrs, 1e3 * np.array(place))


def test_drawn_errors_have_the_stated_size_and_their_own_streams() -> None:
    """Over 1000 names a standard deviation scatters by 2.2 %, four of which are allowed."""
    spec = {"focal_length_sigma_percent": 0.5, "principal_point_sigma_px": 2.0, "mounting_sigma_deg": [1.0, 2.0, 3.0]}
    truth = with_tables()
    drawn = []
    for number in range(1000):
        scene = {**truth.scene, "scene": {"name": f"f{number}", "seed": 0}, "calibration": spec}
        errors = errors_of(replace(truth, scene=scene))
        drawn.append([errors.focal_length, *errors.principal_point_px, *errors.mounting_rad])
    found = np.array(drawn) / [0.005, 2.0, 2.0, *np.radians([1.0, 2.0, 3.0])]
    assert np.abs(found.std(axis=0) - 1.0).max() < 0.09
    assert np.abs(found.mean(axis=0)).max() < 0.13
    assert np.abs(np.corrcoef(found.T) - np.eye(6)).max() < 0.13


def test_frames_of_one_flight_share_their_errors() -> None:
    def focal(name: str, draw: str | None) -> float:
        spec = {"focal_length_sigma_percent": 1.0} | ({} if draw is None else {"draw": draw})
        return errors_of(
            replace(with_tables(), scene={"scene": {"name": name, "seed": 0}, "calibration": spec})
        ).focal_length

    assert focal("a", "flight") == focal("b", "flight")
    assert focal("a", "flight") != focal("a", "other")
    assert focal("a", None) != focal("b", None)


def test_sigmas_are_told_and_widen_the_prior() -> None:
    _, right, wrong = told(
        focal_length_sigma_percent=0.5, mounting_sigma_deg=[0.5, 0.5, 1.2], clock_sigma_s=1.0, distortion_sigma_px=0.3
    )
    assert wrong.calibration.focal_length_sigma == 0.005
    assert wrong.calibration.distortion_sigma_px == 0.3
    assert np.allclose(np.degrees(wrong.prior.attitude_sigma_rad), np.hypot(0.5, [0.5, 0.5, 1.2]))
    assert wrong.prior.position_sigma_m == pytest.approx(math.hypot(1e3, 7617.0), rel=2e-3)
    assert right.prior.position_sigma_m == 1e3
    assert stated_sigmas(CalibrationSpec(focal_length_error_percent=1.0)) is None
