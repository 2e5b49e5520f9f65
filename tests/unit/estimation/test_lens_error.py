"""What a method claims with a camera that is not known exactly: toy methods, whose answers are closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.lens_error import miscalibrated, with_lens_error
from horizonval.estimation.observation import Calibration, Fit, Observation
from horizonval.geometry.camera import CameraModel, project, unproject

CAMERA = CameraModel(width=64, height=48, fx=200.0, fy=200.0, cx=31.5, cy=23.5)
IMAGE = np.zeros((48, 64))
NOISE_RAD = 1e-5


def towards(column: float, row: float, observation: Observation) -> Fit:
    """Return a fit whose nadir is what the camera sees in a pixel, and whose altitude is its focal length."""
    return Fit(
        nadir_cam=np.asarray(unproject(observation.camera, np.array([column, row]))),
        covariance_nadir_cam=NOISE_RAD**2 * np.diag([1.0, 1.0, 0.0]),
        roll_rad=0.0,
        pitch_rad=0.0,
        altitude_m=1e3 * observation.camera.fx,
        sigma_altitude_m=300.0,
    )


def on_axis(observation: Observation) -> Fit:
    return towards(31.5, 23.5, observation)


def said(**sigmas: float) -> Observation:
    return Observation(image=IMAGE, camera=CAMERA, calibration=Calibration(**sigmas))


def test_a_pixel_of_the_principal_point_is_its_angle() -> None:
    found = with_lens_error(on_axis)(said(principal_point_sigma_px=0.1))
    assert isinstance(found, Fit)
    assert found.systematic_nadir_cam is not None
    assert np.allclose(np.diag(found.systematic_nadir_cam), [(0.1 / 200.0) ** 2] * 2 + [0.0], rtol=1e-5, atol=1e-20)
    assert np.allclose(found.covariance_nadir_cam, NOISE_RAD**2 * np.diag([1.0, 1.0, 0.0]))


def test_focal_length_turns_what_is_off_the_axis_by_half_the_sine_of_twice_its_angle() -> None:
    """``tan a = x / f``: ``da = sin a cos a df / f``, and the altitude's sigma grows by what the altitude changes."""
    found = with_lens_error(lambda observation: towards(63.0, 23.5, observation))(said(focal_length_sigma=2e-3))
    assert isinstance(found, Fit)
    assert found.systematic_nadir_cam is not None
    off_axis = np.arctan2(31.5, 200.0)
    expected = np.sin(off_axis) * np.cos(off_axis) * 2e-3
    assert np.sqrt(np.trace(found.systematic_nadir_cam)) == pytest.approx(expected, rel=5e-3)
    assert np.abs(found.systematic_nadir_cam @ found.nadir_cam).max() < 1e-18
    assert found.sigma_altitude_m == pytest.approx(np.hypot(300.0, 400.0))


@pytest.mark.parametrize(
    "camera",
    [
        replace(
            CAMERA, fx=90.0, fy=92.0, distortion=(0.9, 0.1, 1e-4, 2e-4, 3e-3, 1.3, 0.35, 0.02, 0, 0, 0, 0), skew=0.01
        ),
        replace(
            CAMERA, fx=60.0, fy=62.0, projection="unified", shape=(1.2, 0.0, 1.0), distortion=(-0.02, 0.01, 0, 0, 0)
        ),
    ],
    ids=["rational", "unified"],
)
def test_a_pixel_of_distortion_moves_the_corner_by_a_pixel(camera: CameraModel) -> None:
    """To 2 %: fx and fy differ by that much, and the column moves with the skew."""
    corner = np.array([-0.5, -0.5])
    moved = project(miscalibrated(camera, distortion_px=1e-3), unproject(camera, corner))[0] - corner
    assert np.linalg.norm(moved) == pytest.approx(1e-3, rel=2e-2)
    assert moved @ corner > 0.0


def test_a_camera_that_is_exact_changes_nothing() -> None:
    for calibration in (None, Calibration(), Calibration(mounting_sigma_rad=(0.1, 0.1, 0.1), clock_sigma_s=1.0)):
        observation = Observation(image=IMAGE, camera=CAMERA, calibration=calibration)
        found = with_lens_error(on_axis)(observation)
        assert isinstance(found, Fit)
        assert found.systematic_nadir_cam is None
        assert found.sigma_altitude_m == 300.0


def test_it_is_added_once_however_often_methods_are_wrapped() -> None:
    observation = said(principal_point_sigma_px=0.1)
    once, twice = with_lens_error(on_axis)(observation), with_lens_error(with_lens_error(on_axis))(observation)
    assert isinstance(once, Fit)
    assert isinstance(twice, Fit)
    assert np.array_equal(once.systematic_nadir_cam, twice.systematic_nadir_cam)


def test_every_head_has_errors_of_its_own() -> None:
    """The mean of two heads' answers: each moves it by half, and both together by the root of a half."""

    def mean(observation: Observation) -> Fit:
        fits = [on_axis(head) for head in observation.heads.values()]
        return replace(fits[0], nadir_cam=0.5 * (fits[0].nadir_cam + fits[1].nadir_cam))

    head = said(principal_point_sigma_px=0.1)
    found = with_lens_error(mean)(replace(head, heads={"left": head, "right": head}))
    assert isinstance(found, Fit)
    assert found.systematic_nadir_cam is not None
    assert found.systematic_nadir_cam[0, 0] == pytest.approx(0.5 * (0.1 / 200.0) ** 2, rel=1e-5)


def test_an_answer_that_hangs_on_an_error_of_the_lens_is_none() -> None:
    def of_this_camera_alone(observation: Observation) -> Fit | Refusal:
        return on_axis(observation) if observation.camera == CAMERA else Refusal(Outcome.NO_LIMB, "another camera")

    found = with_lens_error(of_this_camera_alone)(said(focal_length_sigma=1e-3))
    assert isinstance(found, Refusal)
    assert "focal length" in found.reason


def test_an_answer_on_one_side_is_enough() -> None:
    def of_no_longer_lens(observation: Observation) -> Fit | Refusal:
        longer = observation.camera.fx > CAMERA.fx
        return Refusal(Outcome.NO_LIMB, "longer") if longer else towards(63.0, 23.5, observation)

    found = with_lens_error(of_no_longer_lens)(said(focal_length_sigma=2e-3))
    assert isinstance(found, Fit)
    assert found.sigma_altitude_m == pytest.approx(np.hypot(300.0, 400.0))
