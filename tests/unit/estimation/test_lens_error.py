"""What a method claims with a camera that is not known exactly: discs whose answers are closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from horizonval.core.outcome import Refusal
from horizonval.estimation.lens_error import miscalibrated, with_lens_error
from horizonval.estimation.observation import Calibration, Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.camera import CameraModel, project, unproject

CAMERA = CameraModel(width=64, height=48, fx=200.0, fy=200.0, cx=31.5, cy=23.5)
IMAGE = np.zeros((48, 64))
NOISE_RAD = 1e-5


def disc(column: float, row: float, rho_rad: float) -> Fit:
    """Return the fit of a planet about what the camera sees in a pixel."""
    nadir = np.asarray(unproject(CAMERA, np.array([column, row])))
    across = np.linalg.svd(nadir[None])[2][1:]
    azimuth = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    limb = np.cos(rho_rad) * nadir + np.sin(rho_rad) * (np.column_stack([np.cos(azimuth), np.sin(azimuth)]) @ across)
    return Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=NOISE_RAD**2 * (np.eye(3) - np.outer(nadir, nadir)),
        roll_rad=0.0,
        pitch_rad=0.0,
        angular_radius_rad=rho_rad,
        altitude_m=MEAN_RADIUS_M / np.sin(rho_rad) - MEAN_RADIUS_M,
        sigma_altitude_m=300.0,
        points=project(CAMERA, limb)[0],
    )


def on_axis(observation: Observation) -> Fit:
    return disc(31.5, 23.5, 0.1)


def said(**sigmas: float) -> Observation:
    return Observation(image=IMAGE, camera=CAMERA, calibration=Calibration(**sigmas))


def test_a_pixel_of_the_principal_point_is_its_angle() -> None:
    found = with_lens_error(on_axis)(said(principal_point_sigma_px=0.1))
    assert isinstance(found, Fit)
    assert found.systematic_nadir_cam is not None
    # Off the axis the same shift of the image is a smaller angle: by cos^2 in its direction, 0.99 at 0.1 rad.
    assert np.allclose(np.diag(found.systematic_nadir_cam), [(0.1 / 200.0) ** 2] * 2 + [0.0], rtol=2.2e-2, atol=1e-16)
    assert np.allclose(found.covariance_nadir_cam, NOISE_RAD**2 * np.diag([1.0, 1.0, 0.0]))


def test_focal_length_turns_what_is_off_the_axis_by_half_the_sine_of_twice_its_angle() -> None:
    """``tan a = x / f``: ``da = sin a cos a df / f``."""
    found = with_lens_error(lambda _: disc(63.0, 23.5, 1e-3))(said(focal_length_sigma=2e-3))
    assert isinstance(found, Fit)
    assert found.systematic_nadir_cam is not None
    off_axis = np.arctan2(31.5, 200.0)
    expected = np.sin(off_axis) * np.cos(off_axis) * 2e-3
    assert np.sqrt(np.trace(found.systematic_nadir_cam)) == pytest.approx(expected, rel=5e-3)
    assert np.abs(found.systematic_nadir_cam @ found.nadir_cam).max() < 1e-15


def test_focal_length_changes_the_altitude_of_a_disc_on_the_axis() -> None:
    """``d rho = sin rho cos rho df / f``, and ``d h = R cos rho / sin^2 rho d rho``."""
    found = with_lens_error(on_axis)(said(focal_length_sigma=2e-3))
    assert isinstance(found, Fit)
    moved_m = MEAN_RADIUS_M * np.cos(0.1) ** 2 / np.sin(0.1) * 2e-3
    assert found.sigma_altitude_m == pytest.approx(np.hypot(300.0, moved_m), rel=5e-3)
    assert np.sqrt(np.trace(found.systematic_nadir_cam)) < 1e-9


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
    """Two heads that see one disc: each moves the answer by half, and both together by the root of a half."""
    head = said(principal_point_sigma_px=0.1)
    both = with_lens_error(on_axis)(replace(head, heads={"left": head, "right": head}))
    single = with_lens_error(on_axis)(head)
    assert isinstance(both, Fit)
    assert isinstance(single, Fit)
    assert both.systematic_nadir_cam is not None
    assert np.diag(both.systematic_nadir_cam)[:2] == pytest.approx(
        0.5 * np.diag(single.systematic_nadir_cam)[:2], rel=1e-2
    )


def test_an_answer_without_points_is_refused() -> None:
    found = with_lens_error(lambda _: replace(disc(31.5, 23.5, 0.1), points=np.empty((0, 2))))(
        said(focal_length_sigma=1e-3)
    )
    assert isinstance(found, Refusal)
    assert "errors of the lens" in found.reason
