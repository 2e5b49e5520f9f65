"""The altitude-free method on hard-limb pictures: the paper's set-ups, a table of errors, a low orbit."""

from __future__ import annotations

import numpy as np
import pytest
from hard_limb import hard_limb_image

from horizonval.estimation.methods.altitude_free import ESTIMATOR
from horizonval.estimation.methods.altitude_free_published import ESTIMATOR as PUBLISHED
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.frames import nadir_of_roll_pitch

RADIUS_M = MEAN_RADIUS_M
NEWTON_RAD = 1e-6
"""0.2 arcsec: a hundredth of what the points allow at best, so the iteration is done."""


def _fit(pixels: int, fov_deg: float, altitude_km: float, roll_deg: float, pitch_deg: float) -> tuple[Fit, np.ndarray]:
    focal = pixels / 2 / np.tan(np.radians(fov_deg) / 2)
    camera = CameraModel(pixels, pixels, focal, focal, (pixels - 1) / 2, (pixels - 1) / 2)
    nadir = nadir_of_roll_pitch(np.radians(roll_deg), np.radians(pitch_deg))
    rho = np.arcsin(RADIUS_M / (RADIUS_M + altitude_km * 1e3))
    image = hard_limb_image(pixels, fov_deg, nadir, rho)
    result = ESTIMATOR.run(Observation(image=image, camera=camera, full_scale=255.0))
    assert isinstance(result, Fit), result
    return result, nadir


def _arcsec(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)) * 3600.0)


SET_UPS = [
    (400, 60.0, 3000.0),
    (400, 40.0, 6000.0),
    (50, 40.0, 6000.0),
    (400, 80.0, 6000.0),
    (50, 80.0, 6000.0),
]


@pytest.mark.parametrize(("pixels", "fov_deg", "altitude_km"), SET_UPS)
def test_published_set_ups_converge_in_four_steps(pixels: int, fov_deg: float, altitude_km: float) -> None:
    fit, nadir = _fit(pixels, fov_deg, altitude_km, 20.0, 30.0)
    updates = np.abs(np.diff(fit.steps, axis=0)).max(axis=1)
    assert np.all(updates[3:] < NEWTON_RAD)
    # a fiftieth of a pixel, the worst a sub-pixel point should be off on a clean hard edge, at 400 px and more
    pixel_arcsec = fov_deg * 3600.0 / pixels
    assert _arcsec(fit.nadir_cam, nadir) < (0.02 if pixels >= 400 else 0.1) * pixel_arcsec


def test_sharp_camera_in_low_orbit_is_good_to_half_an_arcsec_rms() -> None:
    """1024 px over 60 deg from 500 km, limb across the picture; a four-hundredth of a pixel."""
    errors = []
    for roll, pitch in ((62.0, 0.0), (66.0, 8.0), (-68.0, 4.0), (3.0, 64.0), (-5.0, -70.0)):
        fit, nadir = _fit(1024, 60.0, 500.0, roll, pitch)
        errors.append(_arcsec(fit.nadir_cam, nadir))
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert rms < 0.5


def test_whole_pixels_claim_what_they_are_off_by() -> None:
    """Squared error over claimed covariance of the published method, 60 pictures with the limb somewhere in them.

    Two degrees of freedom: 2 in mean, standard error 0.26 for Gaussian errors. A covariance of points good to a tenth
    of a pixel, as sub-pixel points are, would make it 10.
    """
    rng = np.random.default_rng(np.random.SeedSequence(71))
    squares, altitudes = [], []
    for _ in range(60):
        pixels, fov_deg = int(rng.choice([100, 160])), float(rng.choice([40.0, 60.0, 80.0]))
        altitude_km = float(rng.choice([800.0, 3000.0, 6000.0]))
        rho = np.arcsin(RADIUS_M / (RADIUS_M + altitude_km * 1e3))
        off, azimuth = rho + np.radians(rng.uniform(-0.35, 0.35) * fov_deg), rng.uniform(0.0, 2.0 * np.pi)
        nadir = np.array([np.sin(off) * np.cos(azimuth), np.sin(off) * np.sin(azimuth), np.cos(off)])
        focal = pixels / 2 / np.tan(np.radians(fov_deg) / 2)
        camera = CameraModel(pixels, pixels, focal, focal, (pixels - 1) / 2, (pixels - 1) / 2)
        image = hard_limb_image(pixels, fov_deg, nadir, rho, fine=8)
        fit = PUBLISHED.run(Observation(image=image, camera=camera, full_scale=255.0))
        if not isinstance(fit, Fit):
            continue
        error = fit.nadir_cam - nadir
        squares.append(error @ np.linalg.pinv(fit.covariance_nadir_cam, rcond=1e-9) @ error)
        assert fit.altitude_m is not None
        assert fit.sigma_altitude_m is not None
        altitudes.append((fit.altitude_m - altitude_km * 1e3) / fit.sigma_altitude_m)
    assert len(squares) >= 50
    assert 1.0 < np.mean(squares) < 3.0
    assert 0.4 < np.sqrt(np.mean(np.square(altitudes))) < 1.5
