"""Rays by azimuth and lowest height, exact on the ellipsoid, and heights at which made-up limb profiles drop."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from synthetic import truth_at

from horizonval.frame import FrameTruth
from horizonval.geometry.ellipsoid import WGS84, geodetic_from_itrs, itrs_from_geodetic, sphere, tangent_point
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.truth.infrared_horizon import locate, profile_heights_m
from horizonval.truth.infrared_radiance import angle_of_height, directions, ground_points, ray_paths

HEIGHT = profile_heights_m(100e3)


def profile(middle_m: float, width_m: float, plateau: float = 5.0) -> np.ndarray:
    """A smooth step: half at its middle, where it is also steepest."""
    return plateau / (1.0 + np.exp((HEIGHT - middle_m) / width_m))


def test_profiles_drop_where_they_are_made_to() -> None:
    found = locate(HEIGHT, np.stack([profile(40e3, 3e3), profile(37e3, 3e3)]), np.array([5.2, 8.0]))
    assert found.kind == "opaque"
    # The plateau at 10 km is exp(-10) short of 5; the spline's steps are a sixth of the width.
    np.testing.assert_allclose(found.plateau, 5.0, rtol=2e-4)
    np.testing.assert_allclose(found.half_plateau_m, [40e3, 37e3], rtol=0, atol=5.0)
    np.testing.assert_allclose(found.maximum_gradient_m, [40e3, 37e3], rtol=0, atol=20.0)
    found = locate(HEIGHT, profile(4e3, 1e3, plateau=30.0)[None], np.array([32.0]))
    assert found.kind == "window"
    assert found.plateau[0] == 32.0
    # 16 of 30 / (1 + exp(x)): x = ln(30 / 16 - 1)
    assert found.half_plateau_m[0] == pytest.approx(4e3 + 1e3 * np.log(30 / 16 - 1), abs=10.0)
    assert found.maximum_gradient_m[0] == pytest.approx(4e3, abs=20.0)
    bump = profile(38e3, 2e3) * (1.0 - 0.8 * np.exp(-(((HEIGHT - 26e3) / 2e3) ** 2)))
    assert locate(HEIGHT, bump[None], np.array([5.0])).half_plateau_m[0] == pytest.approx(38e3, abs=10.0)
    found = locate(HEIGHT, profile(10e3, 2e3, plateau=1.0)[None], np.array([20.0]))
    assert (found.kind, found.half_plateau_m[0]) == ("window", 0.0)
    radiance = np.stack([profile(40e3, 3e3)] * 2)
    assert locate(HEIGHT, radiance, np.array([5.0, 9.0])).kind == "opaque"
    assert locate(HEIGHT, radiance, np.array([5.0, 15.0])).kind == "window"
    assert HEIGHT[0] == 0.0
    assert np.all(np.diff(HEIGHT) > 0.0)
    assert profile_heights_m(50e3)[-1] <= 49.5e3


def test_what_was_read_stays_out_of_the_plain_data():
    truth = truth_at()
    before = json.dumps(truth.to_dict())
    assert truth.camera_spec is not None
    assert json.dumps(truth.to_dict()) == before
    assert truth == FrameTruth.from_dict(json.loads(before)) == pickle.loads(pickle.dumps(truth))


def test_names_of_scene_camera_and_head():
    truth = truth_at(name="pass")
    assert (truth.scene_name, truth.head, truth.camera_name) == ("pass", None, "vis-640x480")
    scene = {**truth.scene, "camera": {"file": "rigs/pair.toml", "head": "left"}}
    nameless = {**truth.camera, "camera": {**truth.camera["camera"], "name": ""}}
    other = replace(truth, scene=scene, camera=nameless)
    assert (other.head, other.camera_file, other.camera_name) == ("left", "rigs/pair.toml", "pair")


AZIMUTH = np.radians(np.arange(0.0, 360.0, 40.0))


@pytest.mark.parametrize("altitude_m", [150e3, 500e3, 35_786e3, 4e8])
def test_angles_have_their_height(altitude_m: float) -> None:
    r = itrs_from_geodetic(0.6, -2.0, altitude_m)
    heights = np.array([-10e3, 0.0, 3.3e3, 40e3, 99e3])[:, None]
    angle = angle_of_height(r, WGS84, AZIMUTH, heights)
    lowest = tangent_point(r, directions(r, AZIMUTH, angle), WGS84)[1]
    # A millimetre, and the rounding of an angle as seen from the Moon's distance (0.1 um).
    np.testing.assert_allclose(lowest, np.broadcast_to(heights, lowest.shape), rtol=0, atol=2e-3)
    np.testing.assert_allclose(angle[1], horizon_by_azimuth(r, WGS84, AZIMUTH), rtol=0, atol=1e-8)


def test_azimuth_runs_from_north_to_east() -> None:
    r = itrs_from_geodetic(0.3, 0.0, 500e3)
    north, east = directions(r, np.array([0.0, math.pi / 2]), np.array([1.0, 1.0]))
    assert north[2] > 0.5
    assert east[1] == pytest.approx(math.sin(1.0))


@pytest.mark.parametrize("height_m", [-10e3, 0.0, 40e3, 98e3])
def test_courses_follow_the_ray(height_m: float) -> None:
    """Distance and latitude at heights between the points that were fitted: 1 mm, and 1e-9 of the sine."""
    r = itrs_from_geodetic(-0.9, 0.4, 700e3)
    path = ray_paths(r, WGS84, AZIMUTH, [height_m], 100e3)[0]
    d = directions(r, AZIMUTH, angle_of_height(r, WGS84, AZIMUTH, height_m))
    s, lowest = tangent_point(r, d, WGS84)
    for along in np.linspace(-0.95, 0.95, 8) * math.sqrt(2 * 6.38e6 * (100e3 - height_m)):
        latitude, _, z = geodetic_from_itrs(r + (s + along)[:, None] * d, WGS84)
        u = np.copysign(np.sqrt(z - lowest), along)
        for n in range(len(AZIMUTH)):
            assert path.sine_at(u[n : n + 1])[n, 0] == pytest.approx(math.sin(latitude[n]), abs=1e-9)
            # ds/du = (dz/du) / (dz/ds) = 2 u / (normal . d)
            step = 10.0
            here = r + (s[n] + along) * d[n]
            z1, z0 = (geodetic_from_itrs(here + e * d[n], WGS84)[2] for e in (step, -step))
            slope = float(z1 - z0) / (2 * step)
            # The difference over 20 m of a height rounded to 1 nm, and its curvature.
            assert path.metres_per_u(u[n : n + 1])[n, 0] == pytest.approx(2 * u[n] / slope, rel=1e-7)


def test_courses_over_a_sphere_have_the_closed_form() -> None:
    ball = sphere(6.371e6)
    path = ray_paths(np.array([7e6, 0.0, 0.0]), ball, [0.0], [30e3], 100e3)[0]
    u = np.linspace(-260.0, 260.0, 7)
    b = ball.a_m + 30e3
    # s = u sqrt(2 b + u^2)
    expected = (2 * b + 2 * u**2) / np.sqrt(2 * b + u**2)
    np.testing.assert_allclose(path.metres_per_u(u)[0], expected, rtol=1e-9)


def test_ground_points_lie_on_the_ground() -> None:
    r = itrs_from_geodetic(0.2, 0.4, 700e3)
    place = ground_points(r, WGS84, AZIMUTH, -10e3)
    np.testing.assert_allclose(geodetic_from_itrs(place, WGS84)[2], 0.0, atol=1e-6)
