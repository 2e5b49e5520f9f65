"""The sampled horizon, against circles whose lengths are known and against the definitions of angles on the ground."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from synthetic import SOLAR_CAMERA, truth_at

from horizonval.geometry import frames
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.scoring import limits
from horizonval.scoring.horizon_view import (
    disc_in_frame,
    extent,
    horizon_view,
    inside_image,
    moon_in_frame,
    sun_in_frame,
    usable_margin_px,
)

CAMERA = CameraModel(640, 480, 500.0, 450.0, 319.5, 239.5)


def ring(rho: float, n: int = 36_000) -> np.ndarray:
    """A circle about the boresight, as points of the image."""
    turn = np.arange(n) * (2 * np.pi / n)
    los = np.column_stack([np.sin(rho) * np.cos(turn), np.sin(rho) * np.sin(turn), np.full(n, np.cos(rho))])
    return project(CAMERA, los)[0]


def test_the_length_of_a_part_of_a_curve() -> None:
    """On the plane image of a small circle: a quarter of it, two ends of a quarter, one sample, nothing."""
    uv = ring(0.3)
    n = len(uv)
    around = np.hypot(*(np.roll(uv, -1, axis=0) - uv).T)
    member = np.roll(np.arange(n) < n // 4, n // 3)
    assert extent(uv, member) == pytest.approx(around[member].sum(), rel=3e-3)
    assert extent(uv, np.arange(n) == 5) == extent(uv, np.zeros(n, dtype=bool)) == 0.0
    assert extent(uv, np.ones(n, dtype=bool)) == pytest.approx(around.sum())


def test_the_detector_reaches_half_a_pixel_beyond_its_outer_centres() -> None:
    edge = np.array([[-0.5, 0.0], [639.5, 479.5], [0.0, -0.5], [320.0, 240.0]])
    assert inside_image(CAMERA, edge).all()
    for off in ([-0.01, 0.0], [0.0, -0.01]):
        assert not inside_image(CAMERA, edge[:1] + off if off[0] else edge[2:3] + off).any()
        assert not inside_image(CAMERA, edge[1:2] - off).any()
    assert inside_image(CAMERA, np.array([[9.6, 9.6], [629.4, 469.4]]), 10.0).all()
    assert not inside_image(CAMERA, np.array([[9.4, 20.0], [20.0, 9.4], [629.6, 20.0], [20.0, 469.6]]), 10.0).any()
    assert not inside_image(CAMERA, np.array([[np.nan, 5.0]])).any()


@pytest.mark.parametrize(("radius", "inside"), [(0.02, False), (0.06, True)])
def test_a_disc_is_in_the_frame_if_any_of_it_is(radius: float, inside: bool) -> None:
    """Its centre is 0.04 rad or so beyond the right edge, on all sides of the image alike."""
    for side in ([1, 0], [-1, 0], [0, 1], [0, -1]):
        reach = math.atan((320 / 500.0) if side[0] else (240 / 450.0)) + 0.04
        centre = np.array([side[0] * math.sin(reach), side[1] * math.sin(reach), math.cos(reach)])
        assert disc_in_frame(CAMERA, centre, radius) is inside
    assert disc_in_frame(CAMERA, np.array([0.0, 0.0, 1.0]), 1.2), "a disc that fills the image shows no rim"
    assert not disc_in_frame(CAMERA, np.array([0.0, 0.0, -1.0]), 0.3)


def test_sun_and_moon_behind_the_earth_are_not_in_the_frame() -> None:
    truth = truth_at(roll_deg=66.0)
    at = {"sun_cam": (0.0, 0.0, 1.0), "moon_cam": (0.0, 0.0, 1.0), "moon_angular_radius_rad": 4.5e-3}
    seen = dataclasses.replace(truth, **at, sun_visible_fraction=0.1, moon_visible_fraction=0.1)
    hidden = dataclasses.replace(seen, sun_visible_fraction=0.0, moon_visible_fraction=0.0)
    for look in (sun_in_frame, moon_in_frame):
        assert look(CAMERA, seen)
        assert not look(CAMERA, hidden)
    assert not moon_in_frame(CAMERA, dataclasses.replace(seen, moon_cam=None))


@pytest.mark.parametrize(
    ("width", "height", "share"), [(640, 480, 1.0), (256, 900, 1.0), (128, 900, 0.5), (900, 64, 0.25)]
)
def test_small_images_have_a_narrower_rim(width: int, height: int, share: float) -> None:
    assert usable_margin_px(CameraModel(width, height, 500.0, 500.0, 0.0, 0.0)) == pytest.approx(limits.RIM_PX * share)


@pytest.mark.parametrize("ellipsoid", [WGS84, sphere(6.4e6)])
@pytest.mark.parametrize("altitude_km", [400.0, 9000.0])
def test_suns_angles_are_those_at_the_tangent_point(ellipsoid, altitude_km: float) -> None:  # type: ignore[no-untyped-def]
    """The line of sight grazes: it is level at its tangent point, which lies on it and on the surface."""
    truth = truth_at(
        ellipsoid=ellipsoid, altitude_km=altitude_km, roll_deg=50.0, sun_zenith_deg=60.0, sun_azimuth_deg=200.0
    )
    view = horizon_view(truth, truth.camera_model)
    los = frames.rotate(frames.inverse(truth.q_cam_from_itrs), view.los_cam)[::400]
    r, sun = np.array(truth.r_itrs), np.array(truth.sun_itrs)
    axes2 = np.array([ellipsoid.a_m, ellipsoid.a_m, ellipsoid.b_m]) ** 2
    # The nearest point to the surface along the ray, from the ellipsoid's equation.
    s = -np.sum(los * r / axes2, axis=1) / np.sum(los**2 / axes2, axis=1)
    point = r + s[:, None] * los
    assert np.sum(point**2 / axes2, axis=1) == pytest.approx(np.ones(len(los)), abs=1e-9)
    normal = point / axes2
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    assert view.cos_zenith[::400] == pytest.approx(normal @ sun, abs=1e-7)
    level = sun - (normal @ sun)[:, None] * normal
    azimuth = np.sum(level * los, axis=1) / np.linalg.norm(level, axis=1)
    assert view.cos_azimuth[::400] == pytest.approx(azimuth, abs=1e-6)
    uv, _ = project(truth.camera_model, view.los_cam)
    seen = inside_image(truth.camera_model, uv)
    assert (view.in_view == seen).all()
    assert np.abs(view.uv - uv)[seen].max(initial=0.0) < 1e-6
    assert seen.any() == (altitude_km == 400.0)


def test_narrow_fields_are_sampled_as_finely_as_wide_ones() -> None:
    counts = {}
    for fov in (120.0, 10.0, 1.0, 0.01):
        tables = SOLAR_CAMERA | {"camera": {"name": "c", "width": 640, "height": 480, "fov_deg": fov}}
        truth = truth_at(tables, roll_deg=66.0)
        counts[fov] = len(horizon_view(truth, truth.camera_model).in_view)
    assert counts[120.0] == 21_600
    assert counts[10.0] == pytest.approx(1000 * 360.0 / 7.5, rel=0.01)
    assert counts[0.01] == 400_000
    assert counts[1.0] == 400_000
