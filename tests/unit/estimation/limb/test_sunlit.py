"""The height of a sunlit limb by the Sun's place, and what a bow of heights does to a cone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from horizonval.estimation.fit.heights import steepest_height
from horizonval.estimation.fit.templates import FOLDER, load_templates
from horizonval.estimation.guard.sunlit import (
    cone_perturbation,
    heights_of,
    sun_angles,
    sunlit_limb,
)
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


@pytest.mark.parametrize(("zenith_deg", "azimuth_deg"), [(20.0, 30.0), (88.0, 90.0), (60.0, 170.0)])
def test_the_suns_angles_are_those_at_the_tangent_point(zenith_deg: float, azimuth_deg: float) -> None:
    zenith, azimuth = sun_angles(arc()[80:81], NADIR, sun_at(zenith_deg, azimuth_deg))
    assert math.degrees(zenith[0]) == pytest.approx(zenith_deg, abs=1e-6)
    assert math.degrees(azimuth[0]) == pytest.approx(azimuth_deg, abs=1e-6)


def height_km(zenith_deg: float, azimuth_deg: float, blur_px: float = 1.3) -> float:
    limb = sunlit_limb(arc()[80:81], NADIR, RHO, sun_at(zenith_deg, azimuth_deg), np.array([blur_px / 128.0]))
    return float(limb.height_m[0]) / 1e3


def test_a_resolved_limb_stands_where_a_grazing_ray_gets_opaque() -> None:
    """In blue-green air the optical depth along a grazing ray passes one 10 to 20 km up."""
    assert 10.0 < height_km(0.0, 0.0, blur_px=0.03) < 20.0


def test_the_limb_rises_towards_the_terminator_and_more_so_with_the_sun_ahead() -> None:
    low, high = height_km(90.0, 90.0), height_km(40.0, 90.0)
    assert low - high > 8.0
    assert height_km(88.0, 0.0) - height_km(88.0, 180.0) > 8.0


def test_a_wrong_sun_is_one_of_the_patterns() -> None:
    los, sun = arc(), sun_at(85.0, 60.0)
    blur = np.full(len(los), 1.3 / 128.0)
    known, coarse = (sunlit_limb(los, NADIR, RHO, sun, blur, sigma) for sigma in (0.0, math.radians(0.5)))
    assert len(coarse.patterns_m) == len(known.patterns_m) + 2
    # In the middle, at 85 deg, the limb rises by some 0.7 km per degree; half a degree along two axes.
    assert 100.0 < np.hypot(*coarse.patterns_m[-2:, 80]) < 1000.0


def test_heights_move_the_cone_as_a_fit_to_raised_points_does() -> None:
    los = arc()
    turn = np.linspace(-0.8, 0.8, len(los))
    height = 3000.0 * turn**2 + 800.0 * np.sin(3.0 * turn)
    up = RADIUS_M + 500e3
    # The exact raised limb: half-angle asin((R + h) / (R + H)).
    basis = tangent_basis(NADIR)
    rho = np.arcsin((RADIUS_M + height) / up)
    across = np.cos(turn)[:, None] * basis[:, 0] + np.sin(turn)[:, None] * basis[:, 1]
    cone = fit_cone(np.cos(rho)[:, None] * NADIR + np.sin(rho)[:, None] * across)
    moved = cone_perturbation(los, NADIR, RHO, height[None, :], RADIUS_M)[0]
    # To first order; the second is a hundredth of it.
    assert basis.T @ (cone.axis_cam - NADIR) == pytest.approx(moved[:2], abs=0.03 * float(np.abs(moved).max()))


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


def test_bands_have_heights_of_their_own() -> None:
    """Rayleigh's optical depth goes with the fourth power of the wavelength: blue limbs stand higher than red ones."""
    sigma, zenith, azimuth = np.array([6e3]), np.radians([40.0]), np.radians([90.0])
    blue, red = (heights_of(band).height_m(RHO, sigma, zenith, azimuth)[0] for band in (BLUE_UM, RED_UM))
    assert blue > red + 1e3
    # A band without profiles is taken for the visible one.
    assert heights_of((2.0, 2.3)) is heights_of(None)
