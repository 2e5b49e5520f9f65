"""The orbit, the heads and their rays against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.geometry.ellipsoid import WGS84, geodetic_from_itrs, sphere, tangent_height, tangent_point
from horizonval.studies.stability.orbit import heads_round_orbit, offsets_of_heights, rays_along_parallels

RADIUS_M = 7278137.0


def test_axes_of_a_polar_orbit():
    heads = heads_round_orbit(RADIUS_M, math.pi / 2, 4)
    np.testing.assert_allclose(heads.r_itrs[1], [0, 0, RADIUS_M], atol=1e-6)
    # Over the ascending node: forward is north, right is east.
    np.testing.assert_allclose(heads.level[0], [[0, 0, 1], [0, 1, 0], [0, 0, -1], [0, -1, 0]], atol=1e-15)
    np.testing.assert_allclose(heads.nadir[0], [-1, 0, 0], atol=1e-15)


@pytest.mark.parametrize("inclination_deg", [0.0, 60.0, 90.0, 99.03])
def test_the_orbit_reaches_the_latitude_of_its_inclination(inclination_deg):
    heads = heads_round_orbit(RADIUS_M, math.radians(inclination_deg), 360)
    np.testing.assert_allclose(np.linalg.norm(heads.r_itrs, axis=-1), RADIUS_M, rtol=1e-14)
    highest = math.degrees(math.asin(np.max(heads.r_itrs[:, 2]) / RADIUS_M))
    assert highest == pytest.approx(min(inclination_deg, 180 - inclination_deg), abs=1e-9)
    level = heads.level
    assert np.max(np.abs(np.einsum("phi,pi->ph", level, heads.nadir))) < 1e-14
    assert np.max(np.abs(np.linalg.norm(level, axis=-1) - 1)) < 1e-14


def test_offsets_on_a_sphere():
    ball = sphere(6371e3)
    heads = heads_round_orbit(RADIUS_M, math.radians(70.0), 3, math.radians(20.0), ball)
    height = np.array([-6e4, -1e4, 0.0, 4e4, 1e5])
    exact = np.arcsin((6371e3 + height) / RADIUS_M) - math.asin(6371e3 / RADIUS_M)
    # 1 mm of height is 3e-10 rad.
    np.testing.assert_allclose(
        offsets_of_heights(heads, height, ball), np.broadcast_to(exact, (3, 4, 5)), rtol=0, atol=1e-9
    )


def test_offsets_on_the_ellipsoid_give_the_heights_back():
    heads = heads_round_orbit(RADIUS_M, math.radians(99.03), 8)
    height = np.array([-6e4, -50.0, 50.0, 4e4, 1e5])
    directions = heads.directions(offsets_of_heights(heads, height))
    found = tangent_height(heads.r_itrs[:, None, None, :], directions, WGS84)
    np.testing.assert_allclose(found, np.broadcast_to(height, found.shape), rtol=0, atol=1e-3)


def test_right_and_left_of_a_polar_orbit_are_alike():
    heads = heads_round_orbit(RADIUS_M, math.pi / 2, 24)
    s, _ = tangent_point(heads.r_itrs[:, None, None, :], heads.directions(np.full((24, 4, 1), 0.01)), WGS84)
    points = heads.r_itrs[:, None, None, :] + s[..., None] * heads.directions(np.full((24, 4, 1), 0.01))
    latitude = geodetic_from_itrs(points)[0][..., 0]
    # Latitudes to 1e-10 rad, 1 mm.
    np.testing.assert_allclose(latitude[:, 1], latitude[:, 3], rtol=0, atol=1e-10)
    assert np.max(np.abs(latitude[:, 0] - latitude[:, 2])) > 0.9


def test_rays_along_parallels_are_lowest_where_they_should_be():
    latitude, height = np.radians([-80.0, 0.0, 45.0]), np.array([-1e4, 5.0, 4e4])
    origin, direction = rays_along_parallels(latitude, height)
    s, lowest = tangent_point(origin, direction, WGS84)
    np.testing.assert_allclose(lowest, np.broadcast_to(height, (3, 3)), rtol=0, atol=1e-3)
    places = geodetic_from_itrs(origin + s[..., None] * direction)[0]
    # 1 m of the place along the ray is 1e-7 rad at most.
    np.testing.assert_allclose(places, np.broadcast_to(latitude[:, None], (3, 3)), rtol=0, atol=1e-7)
