"""The fisheye against OpenCV up to 90 deg off axis, against the formula in scalar arithmetic beyond, and itself."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.geometry.camera import (
    CameraModel,
    check_invertible,
    field_angles,
    in_image_circle,
    pixel_grid,
    pixel_solid_angle,
    project,
    unproject,
)
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.geometry.horizon import _PoseHorizon, horizon_rows, limb_side
from horizonval.spec.camera import turning_angle

LENSES = {
    "f-theta": (0.0, 0.0, 0.0, 0.0),
    "mild": (-0.0126, 0.0032, -0.0011, 0.0001),
    "strong": (0.09, -0.03, 0.006, -0.0005),
}
RNG_SEED = 5


def camera(k: tuple[float, ...], width: int = 1000, circle_deg: float | None = None) -> CameraModel:
    half = (width - 1) / 2
    circle = None if circle_deg is None else math.radians(circle_deg) / 2
    coefficients = (k[0], k[1], k[2], k[3], 0.0)
    return CameraModel(
        width,
        width,
        0.3 * width,
        0.302 * width,
        half + 1.3,
        half - 2.1,
        coefficients,
        "fisheye",
        image_circle_rad=circle,
    )


def directions(largest_deg: float, n: int = 2000) -> NDArray[np.float64]:
    rng = np.random.default_rng(np.random.SeedSequence(RNG_SEED))
    theta, phi = np.radians(rng.uniform(0.0, largest_deg, n)), rng.uniform(-np.pi, np.pi, n)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


@pytest.mark.parametrize("k", LENSES.values(), ids=LENSES)
def test_projection_is_opencvs(k: tuple[float, ...]) -> None:
    """1e-9 px of 1000: the same closed form in float64. OpenCV goes through tan(theta), so up to 85 deg."""
    lens, d = camera(k), directions(85.0)
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    points = (d / d[:, 2:])[:, None, :]
    theirs, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(k))
    also = cv2.fisheye.distortPoints(np.ascontiguousarray(points[..., :2]), matrix, np.array(k))
    ours, has_image = project(lens, d)
    assert has_image.all()
    assert np.abs(ours - theirs[:, 0]).max() < 1e-9
    assert np.abs(ours - also[:, 0]).max() < 1e-9


@pytest.mark.parametrize("k", LENSES.values(), ids=LENSES)
def test_projection_beyond_90_deg_is_the_formula(k: tuple[float, ...]) -> None:
    """1e-9 px: the formula again, angle by angle, from the arc cosine and powers instead of Horner's rule."""
    lens = camera(k)
    limit = math.degrees(turning_angle(k))
    for x, y, z in directions(min(limit, 179.0) - 1.0, 300):
        theta, phi = math.acos(max(-1.0, min(1.0, z))), math.atan2(y, x)
        theta_d = theta + k[0] * theta**3 + k[1] * theta**5 + k[2] * theta**7 + k[3] * theta**9
        uv, has_image = project(lens, [x, y, z])
        assert has_image
        # the arc cosine loses half of the digits beside the axis
        allowed = 1e-9 if 0.01 < theta < 3.13 else 1e-4
        assert uv[0] == pytest.approx(lens.fx * theta_d * math.cos(phi) + lens.cx, abs=allowed)
        assert uv[1] == pytest.approx(lens.fy * theta_d * math.sin(phi) + lens.cy, abs=allowed)


@pytest.mark.parametrize("k", LENSES.values(), ids=LENSES)
def test_there_and_back(k: tuple[float, ...]) -> None:
    """1e-12 rad from direction to direction, 1e-9 px from pixel to pixel, 1 deg and more inside the turning angle."""
    lens = camera(k)
    d = np.concatenate([directions(min(math.degrees(turning_angle(k)), 179.0) - 1.0), [[0.0, 0.0, 1.0]]])
    assert np.abs(unproject(lens, project(lens, d)[0]) - d).max() < 1e-12
    pixels = np.random.default_rng(np.random.SeedSequence(2)).uniform(200.0, 800.0, (500, 2))
    uv, has_image = project(lens, unproject(lens, pixels))
    assert has_image.all()
    assert np.abs(uv - pixels).max() < 1e-9


def test_what_the_lens_does_not_image() -> None:
    lens = camera(LENSES["strong"])
    turning = turning_angle(LENSES["strong"])
    beyond = [[math.sin(turning + 1e-6), 0.0, math.cos(turning + 1e-6)], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0]]
    uv, has_image = project(lens, beyond)
    assert not has_image.any()
    assert np.isnan(uv).all()
    assert np.isnan(unproject(lens, [1e5, 0.0])).all()


@pytest.mark.parametrize(("width", "relative"), [(250, 2e-4), (1000, 2.5e-5)])
def test_solid_angles_fill_the_image_circle(width: int, relative: float) -> None:
    """A 190 deg fisheye's pixels add up to ``2 pi (1 - cos 95 deg)``.

    A pixel counts whole or not at all. Of ~2 pi r pixels on the circle (r = 124 and 497) each errs by up to half its
    weight, at random: 0.29 sqrt(2 pi r) of pi r^2 pixels is 1.7e-4 and 2.1e-5.
    """
    half = (width - 1) / 2
    f = (width / 2) / math.radians(96.0)
    lens = CameraModel(width, width, f, f, half, half, projection="fisheye", image_circle_rad=math.radians(95.0))
    total = pixel_solid_angle(lens).sum()
    assert total == pytest.approx(2 * math.pi * (1 - math.cos(math.radians(95.0))), rel=relative)


def test_pixels_beyond_the_image_circle_see_nothing() -> None:
    lens = camera(LENSES["mild"], 200, circle_deg=170.0)
    check_invertible(lens)
    inside = in_image_circle(lens)
    assert 0.3 < inside.mean() < 0.8
    angle = field_angles(lens)
    assert angle[inside].max() <= math.radians(85.0)
    assert (angle[~inside] == math.pi).all()
    assert (pixel_solid_angle(lens)[~inside] == 0.0).all()
    assert np.isnan(unproject(lens, pixel_grid(lens))[~inside]).all()
    assert not project(lens, [math.sin(1.5), 0.0, math.cos(1.5)])[1]


@pytest.mark.parametrize("circle_deg", [None, 250.0])
def test_a_fisheye_that_folds_is_refused(circle_deg: float | None) -> None:
    """theta - 0.1 theta^3 turns back at sqrt(1 / 0.3) rad = 104.6 deg; the image's corners would need more."""
    assert math.degrees(turning_angle((-0.1, 0.0, 0.0, 0.0))) == pytest.approx(104.6073, abs=1e-3)
    with pytest.raises(UserError, match=r"104\.6"):
        check_invertible(camera((-0.1, 0.0, 0.0, 0.0), circle_deg=circle_deg))


def horizon_pixels(*view) -> list[np.ndarray]:
    """Return the visible arcs of the horizon as polylines; the arguments are those of :class:`_PoseHorizon`."""
    horizon = _PoseHorizon(*view)
    return [horizon.pixels(np.linspace(first, last, 720))[0] for first, last in horizon.arcs()]


def test_the_horizon_behind_the_camera_plane_is_in_the_image() -> None:
    """A fisheye that looks straight up from 500 km sees the horizon 112 deg off axis: a circle of known radius.

    1e-9 px: the sphere's horizon is ``asin(R / D)`` from the nadir, and an f-theta lens images it as a circle.
    """
    planet, up = sphere(6371e3), np.array([0.0, 0.0, 1.0])
    r_itrs = (6371e3 + 500e3) * up
    lens = CameraModel(400, 400, 80.0, 80.0, 199.5, 199.5, projection="fisheye", image_circle_rad=math.radians(125.0))
    (line,) = horizon_pixels(lens, [0.0, 0.0, 0.0, 1.0], r_itrs, planet)
    radius = 80.0 * (math.pi - math.asin(6371.0 / 6871.0))
    assert np.abs(np.hypot(*(line - 199.5).T) - radius).max() < 1e-9
    rows = horizon_rows(lens, [0.0, 0.0, 0.0, 1.0], r_itrs, [250.0], planet)[0]
    assert rows == pytest.approx(199.5 + np.array([-1, 1]) * math.sqrt(radius**2 - 50.5**2), abs=1e-9)
    narrow = CameraModel(400, 400, 80.0, 80.0, 199.5, 199.5, projection="fisheye", image_circle_rad=math.radians(110.0))
    assert horizon_pixels(narrow, [0.0, 0.0, 0.0, 1.0], r_itrs, planet) == []


def test_points_of_an_oblate_horizon_are_on_it_and_inside_the_circle() -> None:
    """A tilted 190 deg fisheye: every point drawn is a tangent (1e-12), and its ends lie on the circle (1e-6 px)."""
    tilt = math.radians(40.0) / 2
    q = [math.sin(tilt), 0.0, 0.0, math.cos(tilt)]
    r_itrs = np.array([6.9e6, 1e6, 2e6])
    lens = CameraModel(300, 300, 90.0, 90.0, 149.5, 149.5, (0.01, -0.002, 0.0, 0.0, 0.0), "fisheye", math.radians(95.0))
    lines = horizon_pixels(lens, q, r_itrs, WGS84)
    assert lines
    theta = math.radians(95.0)
    circle_px = 90.0 * (theta + 0.01 * theta**3 - 0.002 * theta**5)
    for line in lines:
        inner = line[1:-1]
        d = unproject(lens, inner)
        back = Rotation.from_quat(q).inv().apply(d)
        assert np.abs(limb_side(back, r_itrs, WGS84)).max() < 1e-12
        off = np.hypot(*(line - 149.5).T)
        assert off.max() <= circle_px + 1e-6
        at_border = (np.abs(line[[0, -1]] - 149.5) > 149.999).any(axis=1)
        assert (np.abs(off[[0, -1]] - circle_px)[~at_border] < 1e-6).all()
