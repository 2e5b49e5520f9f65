"""Thermal radiance along given rays: black bodies, air that varies with latitude, the figure of the Earth."""

from __future__ import annotations

import numpy as np
import pytest
from emission_models import RADIUS_M, band, black, isothermal, model
from scipy.integrate import quad

from horizonval.core.arrays import FloatArray
from horizonval.earth.surface.ground_emission import uniform_ground
from horizonval.geometry.ellipsoid import WGS84
from horizonval.renderer.rays import cloud_top_radiance, thermal_radiance
from horizonval.renderer.thermal.emission_table import sky_radiance

HEIGHT_M = 500e3


def _rays(impact_m: FloatArray, radius_m: float = RADIUS_M) -> tuple[FloatArray, FloatArray]:
    """Rays along x that miss the centre of a sphere by its radius and these heights, in the equator's plane."""
    miss = radius_m + impact_m
    start = np.sqrt((radius_m + HEIGHT_M) ** 2 - miss**2)
    return np.stack([-start, miss, np.zeros_like(miss)], axis=1), np.tile([1.0, 0.0, 0.0], (len(miss), 1))


def test_opaque_air_is_seen_on_the_near_side() -> None:
    """Warm air south of 14 N, cold beyond: a ray whose lowest point is at 17 N ends where it enters the air, at 11.5 N.

    Extinction of 1 per km up to 30 km: a grazing ray is used up within 15 km, 0.15 deg. 1e-3: the step is as wide as
    a row.
    """
    z = np.linspace(0.0, 30e3, 301)
    sine = np.linspace(-1.0, 1.0, 401)
    warm = np.where(sine < np.sin(np.radians(14.0)), 300.0, 200.0)
    air = model(
        band(np.full((1, len(z)), 1e-3), z, np.repeat(warm[:, None], len(z), axis=1)), uniform_ground(250.0, 1.0)
    )
    lowest = np.radians(17.0)
    up, north = np.array([np.cos(lowest), 0.0, np.sin(lowest)]), np.array([-np.sin(lowest), 0.0, np.cos(lowest)])
    at = (RADIUS_M + 1e3) * up
    observer = np.stack([at - 2.5e6 * north, at + 2.5e6 * north])
    seen = thermal_radiance(air, RADIUS_M, observer, np.stack([north, -north]))["b"]
    assert seen == pytest.approx([black(300.0, 1), black(200.0, 1)], rel=1e-3)


def test_the_oblate_planet_is_round_along_the_equator_and_flatter_at_the_pole() -> None:
    """A section along the equator is a circle of radius a; at the pole the ellipsoid is a sphere of radius a^2 / b.

    Limb over the equator to 1e-6 (heights are good to a millimetre). Over the pole the curvature falls by 3 e^2 times
    the square of the polar distance: 2e-4 of the radius at the 10 degrees where rays leave the air, 1e-4 of radiance;
    with the curvature of the equator it would be off by 1 % of the radius.
    """
    air = isothermal(1e-8, 250.0)
    height = np.array([5e3, 20e3])
    observer, direction = _rays(height, WGS84.a_m)
    round_ = thermal_radiance(air, WGS84.a_m, observer, direction)["b"]
    flat = thermal_radiance(air, WGS84.a_m, observer, direction, polar_radius_m=WGS84.b_m)["b"]
    assert flat == pytest.approx(round_, rel=1e-6)
    over_pole = np.stack([np.full(2, -3e6), np.zeros(2), WGS84.b_m + height], axis=1)
    flat = thermal_radiance(air, WGS84.a_m, over_pole, direction, polar_radius_m=WGS84.b_m)["b"]
    radius = WGS84.a_m**2 / WGS84.b_m
    round_ = thermal_radiance(air, radius, over_pole + np.array([0.0, 0.0, radius - WGS84.b_m]), direction)["b"]
    assert flat == pytest.approx(round_, rel=2e-4)


def test_the_sky_of_an_isothermal_slab_has_the_closed_form() -> None:
    """``S (1 - 2 E3(tau))``, E3 by quadrature of ``mu exp(-tau / mu)``: 1e-9."""
    z = np.linspace(0.0, 1e4, 11)
    for tau in (0.01, 0.7, 5.0):
        e3 = quad(lambda mu, tau=tau: mu * np.exp(-tau / mu), 0.0, 1.0, epsabs=1e-13)[0]
        sky = sky_radiance(np.full(11, tau / 1e4), np.full(11, 2.0), z)
        assert float(sky) == pytest.approx(2.0 * (1.0 - 2.0 * e3), rel=1e-9)


@pytest.mark.parametrize("opacity_per_m", [1e-8, 1e-5, 1e-3])
def test_a_cloud_in_isothermal_air_is_a_black_body(opacity_per_m: float) -> None:
    observer = np.tile([-RADIUS_M - 500e3, 0.0, 0.0], (3, 1))
    direction = np.array([[1.0, 0.0, 0.0], [1.0, 0.2, 0.0], [1.0, 0.3, 0.1]])
    distance = np.array([490e3, 520e3, 600e3])
    seen = cloud_top_radiance(isothermal(opacity_per_m, 250.0, 0.3), RADIUS_M, observer, direction, distance)["b"]
    assert seen == pytest.approx(black(250.0), rel=1e-5)
