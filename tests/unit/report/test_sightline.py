"""Directions and horizon as the viewer is told them, against the camera and a search for the ellipsoid's edge."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import brentq
from synthetic import SOLAR_CAMERA, TALL_CAMERA, truth_at

from horizonval.geometry.camera import unproject
from horizonval.geometry.frames import inverse, rotate
from horizonval.report.sightline import NODES, sightline_of

FISHEYE = {
    "camera": {"name": "fish", "width": 300, "height": 300, "projection": "fisheye", "fov_deg": 185.0},
    "band": SOLAR_CAMERA["band"],
}


def direction(sight, width, height, u, v):
    """Interpolate as the page does, by other code."""
    node = np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    values = np.array(sight["directions"]).reshape(NODES, NODES, -1)
    across = BarycentricInterpolator((width - 1 + width * node) / 2, values, axis=1)(u)
    d = BarycentricInterpolator((height - 1 + height * node) / 2, across, axis=0)(v)
    d = np.append(d, 1.0) if sight["flat"] else d
    return d / np.linalg.norm(d)


@pytest.mark.parametrize("camera", [SOLAR_CAMERA, TALL_CAMERA, FISHEYE], ids=["brown", "strip", "fisheye"])
def test_directions_are_those_of_the_camera(camera):
    truth = truth_at(camera, roll_deg=66.0)
    sight, model = sightline_of(truth), truth.camera_model
    assert sight["flat"] == (camera is not FISHEYE)
    for share in ((0.0, 0.0), (0.13, 0.71), (0.5, 0.5), (1.0, 0.4)):
        u, v = share[0] * (model.width - 1), share[1] * (model.height - 1)
        found = direction(sight, model.width, model.height, u, v)
        # A thousandth of a degree.
        np.testing.assert_allclose(found, unproject(model, (u, v)), atol=1.7e-5)


def test_the_cone_is_the_edge_of_the_ellipsoid():
    truth = truth_at(SOLAR_CAMERA, roll_deg=66.0, pitch_deg=8.0, yaw_deg=35.0)
    sight = sightline_of(truth)
    nadir, cone = np.array(sight["nadir"]), np.zeros((3, 3))
    cone[np.triu_indices(3)] = sight["cone"]
    cone = cone + np.triu(cone, 1).T
    axes = np.array([truth.ellipsoid_a_m, truth.ellipsoid_a_m, truth.ellipsoid_b_m])
    start = np.array(truth.r_itrs) / axes
    for azimuth in np.linspace(0.0, 6.0, 7):
        first = np.cross(nadir, [0.3, 0.5, 0.8])
        first /= np.linalg.norm(first)
        level = np.cos(azimuth) * first + np.sin(azimuth) * np.cross(nadir, first)

        def hits(theta, level=level):
            d = rotate(inverse(truth.q_cam_from_itrs), np.cos(theta) * nadir + np.sin(theta) * level) / axes
            return (start @ d) ** 2 - (d @ d) * (start @ start - 1.0)

        edge = brentq(hits, 0.5, 1.5)
        a, b, c = nadir @ cone @ nadir, nadir @ cone @ level, level @ cone @ level
        assert np.arctan((-b - np.sqrt(b * b - a * c)) / c) == pytest.approx(edge, abs=1e-7)
