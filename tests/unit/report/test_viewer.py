"""What the viewer is given: numbers packed without loss, exact directions, and curves where they belong."""

from __future__ import annotations

import base64
import math
import re
import zlib
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import brentq
from synthetic import SOLAR_CAMERA, TALL_CAMERA, THERMAL_CAMERA, toy_image, truth_at

from horizonval.geometry.camera import unproject
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.frames import inverse, rotate
from horizonval.report import infrared, viewer
from horizonval.report.load import CaseView
from horizonval.report.viewer import NODES, sightline_of


@pytest.mark.parametrize("shape", [(3, 5), (1, 64), (64, 1)])
def test_packed_numbers_are_the_numbers(shape):
    dn = np.random.default_rng(5).integers(0, 2**16, shape, dtype=np.uint16)
    planes = np.frombuffer(zlib.decompress(base64.b64decode(viewer.packed(dn))), np.uint8).astype(np.uint16)
    coded = (planes[: dn.size] | planes[dn.size :] << 8).reshape(shape)
    steps = (coded >> 1) ^ (0 - (coded & 1))
    np.testing.assert_array_equal(np.cumsum(steps, axis=1, dtype=np.uint16), dn)


def test_the_numbers_chosen_fit_and_are_spread():
    image = toy_image(truth_at(THERMAL_CAMERA))
    images = [image, None, *[image] * 8]
    assert viewer.numbered_frames(images) == {0, *range(2, 10)}
    some = viewer.numbered_frames(images, 3 * image.dn.size)
    assert len(some) == 3
    assert 1 not in some
    assert max(some) >= 6
    assert viewer.numbered_frames(images, image.dn.size - 1) == set()


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


def vertices(path: str) -> np.ndarray:
    return np.array([[float(x) for x in pair.split()] for pair in re.findall(r"[-\d.]+ [-\d.]+", path)])


HORIZON = {
    "kind": "opaque",
    "azimuth_deg": [0.0, 90.0, 180.0, 270.0],
    "half_plateau_height_m": [40e3] * 4,
    "maximum_gradient_height_m": [38e3] * 4,
    "accuracy": {
        "heights_km": [[None, 0.0], [0.0, 7.0], [60.0, None]],
        "relative": [0.05, 0.123, None],
        "half_height_km": 2.0,
        "sentences": ["Only of this band.", "Of all bands."],
    },
}


def infrared_truth(**changes):
    """A thermal frame over a sphere whose infrared horizon stands 40 km high all round."""
    ball = sphere(6371008.8)
    truth = truth_at(THERMAL_CAMERA, roll_deg=66.0, ellipsoid=ball)
    distance = math.hypot(*truth.r_itrs)

    def angles(height):
        return [math.asin((ball.a_m + height) / distance)] * 4

    found = HORIZON | {
        "geometric_angle_rad": angles(0.0),
        "half_plateau_angle_rad": angles(40e3),
        "maximum_gradient_angle_rad": angles(38e3),
    }
    return replace(truth, infrared_horizon={"lwir": found | changes})


def test_the_infrared_horizon_is_the_cone_of_its_height():
    """Over a sphere it is the limb of a sphere larger by its height: 0.02 px, printed to 0.01."""
    truth = infrared_truth()
    rho = math.asin((6371008.8 + 40e3) / math.hypot(*truth.r_itrs))
    drawn = vertices(viewer.infrared_path(truth, "lwir"))
    cone = vertices(viewer.limb_path(truth.camera_model, truth.nadir_geocentric_cam, rho))
    assert len(drawn) > 50
    row = np.interp(drawn[2:-2, 0], *cone[np.argsort(cone[:, 0])].T)
    np.testing.assert_allclose(drawn[2:-2, 1], row, atol=0.02)
    # 40 km as seen from 500 km over a limb 2570 km away: 0.9 deg, 2.3 px.
    hard = vertices(viewer.horizon_path(truth))
    above = np.interp(drawn[2:-2, 0], *hard[np.argsort(hard[:, 0])].T) - drawn[2:-2, 1]
    assert np.all((above > 2.0) & (above < 2.7))
    assert viewer.infrared_path(truth, "other") == ""
    assert viewer.infrared_path(truth_at(THERMAL_CAMERA), "lwir") == ""


def test_the_fitted_limb_of_a_perfect_fit_lies_on_the_true_horizon():
    """On a sphere the horizon is a cone; both curves are drawn to 0.01 px and thinned at different places."""
    truth = truth_at(roll_deg=66.0, ellipsoid=sphere(6371008.8))
    camera = truth.camera_model
    true = vertices(viewer.horizon_path(truth))
    fitted = vertices(viewer.limb_path(camera, truth.nadir_geocentric_cam, truth.angular_radius_rad))
    middle = true[(true[:, 0] > 5) & (true[:, 0] < 634)]
    order = np.argsort(fitted[:, 0])
    assert len(middle) > 100
    assert np.abs(np.interp(middle[:, 0], fitted[order, 0], fitted[order, 1]) - middle[:, 1]).max() < 0.05


def test_a_limb_that_leaves_and_enters_again_is_not_joined_across():
    """A far Earth larger than the image's height: two arcs, no line from one to the other."""
    truth = truth_at(THERMAL_CAMERA, altitude_km=10_000.0, ellipsoid=sphere(6371008.8))
    path = viewer.limb_path(truth.camera_model, truth.nadir_geocentric_cam, truth.angular_radius_rad)
    for piece in path.split("M")[1:]:
        assert np.linalg.norm(np.diff(vertices(piece), axis=0), axis=1).max() < 5
    assert path.count("M") >= 2


def view_of(truth, case="made"):
    return CaseView(case, "lwir", {}, {}, toy_image(truth), "", False, "")


def test_the_infrared_section_says_what_is_stored():
    section = infrared.section_of_frames([view_of(infrared_truth())])
    assert section["places"] == ["ground", "0–7", "above 60"]
    assert section["rows"] == [
        {
            "band": "lwir",
            "range": "8 to 14 um",
            "kind": "opaque",
            "radiance": ["5 %", "12.3 %", "–"],
            "height": "2 km",
        }
    ]
    assert section["figure"]["svg"].startswith("<svg")
    facts = dict(infrared.facts_of(infrared_truth(), "lwir"))
    assert facts == {"infrared horizon in view": "half of the plateau at 40.0 km, steepest fall at 38.0 km, on average"}
    bare = infrared.section_of_frames([view_of(infrared_truth(accuracy=None))])
    assert (bare["places"], bare["notes"], bare["rows"][0]["height"]) == ([], [], "–")
