"""The height of a sunlit limb by the Sun's place, and what is not known of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from horizonval.estimation.fit.heights import steepest_height, sun_angles_at
from horizonval.estimation.fit.templates import FOLDER, load_templates
from horizonval.estimation.guard.limits import model_error, sunlit_heights
from horizonval.estimation.limb.cone import inwards_of
from horizonval.estimation.observation import Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import tangent_basis

RADIUS_M = 6371008.8
BLUE_UM, RED_UM = (load_templates(FOLDER / f"limb-{name}.npz").band_um for name in ("blue", "red"))
RHO = math.asin(RADIUS_M / (RADIUS_M + 500e3))
NADIR = np.array([0.1, 0.8, 0.5]) / np.linalg.norm([0.1, 0.8, 0.5])


def arc(width: float = 1.6, n: int = 161) -> np.ndarray:
    turn = np.linspace(-width / 2, width / 2, n)
    basis = tangent_basis(NADIR)
    across = np.cos(turn)[:, None] * basis[:, 0] + np.sin(turn)[:, None] * basis[:, 1]
    return np.cos(RHO) * NADIR + np.sin(RHO) * across


def sun_at(zenith_deg: float, azimuth_deg: float) -> np.ndarray:
    """Sun by its angles at the middle point of the arc: 0 is ahead."""
    middle = arc()[80]
    up = middle * (middle @ NADIR) - NADIR
    up /= np.linalg.norm(up)
    z, a = math.radians(zenith_deg), math.radians(azimuth_deg)
    return math.cos(z) * up + math.sin(z) * (math.cos(a) * middle + math.sin(a) * np.cross(up, middle))


def seen(sun: np.ndarray | None, focal_px: float = 128.0, **changes) -> Observation:
    camera = CameraModel(160, 120, focal_px, focal_px, 79.5, 59.5)
    return Observation(np.zeros((120, 160)), camera, band_kind="solar", sun_cam=sun, **changes)


@pytest.mark.parametrize(("zenith_deg", "azimuth_deg"), [(20.0, 30.0), (88.0, 90.0), (60.0, 170.0)])
def test_the_suns_angles_are_those_at_the_tangent_point(zenith_deg: float, azimuth_deg: float) -> None:
    middle = arc()[80:81]
    zenith, azimuth = sun_angles_at(middle, -inwards_of(middle, NADIR), sun_at(zenith_deg, azimuth_deg))
    assert math.degrees(zenith[0]) == pytest.approx(zenith_deg, abs=1e-6)
    assert math.degrees(azimuth[0]) == pytest.approx(azimuth_deg, abs=1e-6)


def height_km(zenith_deg: float, azimuth_deg: float, focal_px: float = 128.0, **changes) -> float:
    observation = seen(sun_at(zenith_deg, azimuth_deg), focal_px, **changes)
    return float(sunlit_heights(arc()[80:81], NADIR, RHO, observation)[0][0]) / 1e3


def test_a_resolved_limb_has_the_height_where_a_grazing_ray_gets_opaque() -> None:
    """In blue-green air the optical depth along a grazing ray passes one 10 to 20 km up."""
    assert 10.0 < height_km(0.0, 0.0, 6000.0) < 20.0


def test_the_limb_rises_towards_the_terminator_and_more_so_with_the_sun_ahead() -> None:
    assert height_km(90.0, 90.0) - height_km(40.0, 90.0) > 8.0
    assert height_km(88.0, 0.0) - height_km(88.0, 180.0) > 8.0


def test_a_wrong_sun_is_one_of_the_patterns() -> None:
    los, sun = arc(), sun_at(85.0, 60.0)
    _, exact = sunlit_heights(los, NADIR, RHO, seen(sun, prior=Prior(sun_sigma_rad=1e-9)))
    _, coarse = sunlit_heights(los, NADIR, RHO, seen(sun, prior=Prior(sun_sigma_rad=math.radians(0.5))))
    assert np.abs(exact[:2]).max() < 0.1
    # In the middle, at 85 deg, the limb rises by some 0.7 km per degree; half a degree along two axes.
    assert 100.0 < np.hypot(*coarse[:2, 80]) < 1000.0


def test_a_raised_limb_fits_the_cone_that_its_known_height_is_taken_away_from() -> None:
    los, sun = arc(), sun_at(85.0, 60.0)
    raised, _ = model_error(los, NADIR, RHO, seen(sun))
    up = np.cos(raised)[:, None] * los - np.sin(raised)[:, None] * inwards_of(los, NADIR)
    off = float(np.linalg.norm(fit_cone(up).axis_cam - NADIR))
    assert off > 1e-3
    again, covariance = model_error(up, NADIR, RHO, seen(sun))
    down = np.cos(again)[:, None] * up + np.sin(again)[:, None] * inwards_of(up, NADIR)
    # The pixels' size across the raised limb is another one, which is a part of the height.
    assert np.linalg.norm(fit_cone(down).axis_cam - NADIR) < 0.3 * off
    # The bow is not known without the Sun, and the claim has it.
    _, unknown = model_error(up, NADIR, RHO, seen(None))
    assert np.trace(unknown[:2, :2]) > np.trace(covariance[:2, :2])


def test_the_steepest_place_of_a_blurred_profile_is_that_of_a_convolution() -> None:
    """Against sums over a fine grid: a soft edge at 15 km with a bright layer above it."""
    z = np.concatenate([np.arange(-300e3, 0.0, 10e3), np.arange(0.0, 95.5e3, 1e3)])
    profile = 1.0 / (1.0 + np.exp((z - 15e3) / 3e3)) + 0.3 * np.exp(-(((z - 25e3) / 4e3) ** 2))
    fine = np.arange(-400e3, 400e3, 100.0)
    for sigma in (4e3, 12e3, 60e3):
        light = gaussian_filter1d(np.interp(fine, z, profile, right=0.0), sigma / 100.0, truncate=6.0, mode="nearest")
        expected = fine[np.argmin(np.gradient(light))]
        # The parabola between steps of a fifth of the blur is right to a hundredth of it.
        assert abs(steepest_height(z, profile[None], sigma)[0] - expected) < 0.01 * sigma + 100.0
    assert np.isnan(steepest_height(z, -profile[None], 12e3)[0])


def test_bands_have_separate_heights() -> None:
    """Rayleigh's optical depth goes with the fourth power of the wavelength: blue limbs are higher than red ones."""
    blue, red, unknown, other = (
        height_km(40.0, 90.0, 400.0, band_um=band) for band in (BLUE_UM, RED_UM, None, (2.0, 2.3))
    )
    assert blue > red + 1.0
    assert other == unknown
