"""The altitude-free method on hard-limb pictures: the paper's set-ups, a table of errors, a low orbit."""

from __future__ import annotations

import numpy as np
import pytest
from hard_limb import hard_limb_image

from horizonval.estimators.altitude_free import ESTIMATOR, nadir_of
from horizonval.estimators.observation import Fit, Observation
from horizonval.geometry.camera import Camera

RADIUS_M = Observation.earth_radius_m
NEWTON_RAD = 1e-6
"""0.2 arcsec: a hundredth of what the points allow at best, so the iteration is done."""


def _fit(pixels: int, fov_deg: float, altitude_km: float, roll_deg: float, pitch_deg: float) -> tuple[Fit, np.ndarray]:
    focal = pixels / 2 / np.tan(np.radians(fov_deg) / 2)
    camera = Camera(pixels, pixels, focal, focal, (pixels - 1) / 2, (pixels - 1) / 2)
    nadir = nadir_of(np.radians(roll_deg), np.radians(pitch_deg))
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
    assert fit.altitude_m is not None
    print(  # noqa: T201
        f"\n{pixels} px, {fov_deg:g} deg, {altitude_km:g} km: roll"
        f" {np.degrees(fit.roll_rad) * 3600 - 72000:+.1f} arcsec,"
        f" pitch {np.degrees(fit.pitch_rad) * 3600 - 108000:+.1f} arcsec,"
        f" altitude {fit.altitude_m / 1e3 - altitude_km:+.3f} km; updates {', '.join(f'{u:.0e}' for u in updates)}"
    )
    assert np.all(updates[3:] < NEWTON_RAD)
    # a fiftieth of a pixel, the worst a sub-pixel point should be off on a clean hard edge, at 400 px and more
    pixel_arcsec = fov_deg * 3600.0 / pixels
    assert _arcsec(fit.nadir_cam, nadir) < (0.02 if pixels >= 400 else 0.1) * pixel_arcsec


def test_sharp_camera_in_low_orbit_is_good_to_five_arcsec_rms() -> None:
    """1024 px over 60 deg from 500 km, limb across the picture; half a fiftieth of a pixel."""
    errors = []
    for roll, pitch in ((62.0, 0.0), (66.0, 8.0), (-68.0, 4.0), (3.0, 64.0), (-5.0, -70.0)):
        fit, nadir = _fit(1024, 60.0, 500.0, roll, pitch)
        errors.append(_arcsec(fit.nadir_cam, nadir))
    rms = float(np.sqrt(np.mean(np.square(errors))))
    print(f"\nnadir error {rms:.2f} arcsec rms of {np.round(errors, 2)}")  # noqa: T201
    assert rms < 5.0
