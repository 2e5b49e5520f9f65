"""Angles from the limb of an ellipsoid and their derivatives, the closed form, and pixels near the limb."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.pixels import image_scale, limb_angle, limb_bend, near_pixels
from horizonval.estimation.likelihood.start import position_from_limb
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.ellipsoid import WGS84, itrs_from_geodetic, sphere
from horizonval.geometry.horizon import horizon_directions, signed_limb_angle

PLACES = [(0.0, 300e3), (45.0, 800e3), (-80.0, 20_000e3), (20.0, 35_786e3)]


def _pose(latitude_deg: float, altitude_m: float, seed: int = 3) -> LimbPose:
    r = itrs_from_geodetic(np.radians(latitude_deg), 0.4, altitude_m)
    return LimbPose(Rotation.random(rng=np.random.default_rng(seed)).as_matrix(), r, 20e3)


def _sights_near_the_limb(pose: LimbPose, spread_rad: float, count: int = 60) -> np.ndarray:
    rng = np.random.default_rng(8)
    d = horizon_directions(pose.r_itrs, WGS84.raised(pose.height_m), rng.uniform(0.0, 2 * np.pi, count))
    d = d + rng.normal(0.0, spread_rad, d.shape)
    return (d / np.linalg.norm(d, axis=1)[:, None]) @ pose.cam_from_itrs.T


@pytest.mark.parametrize(("latitude_deg", "altitude_m"), PLACES)
def test_angle_over_its_gradient_is_the_distance_to_the_nearest_point_of_the_limb(
    latitude_deg: float, altitude_m: float
) -> None:
    """Against a search of the nearest point of the exact horizon. The gradient's own change over the distance is the
    flattening times the distance: 1 % of a distance of a milliradian is far above it."""
    pose = _pose(latitude_deg, altitude_m)
    los = _sights_near_the_limb(pose, 1e-3)
    ellipsoid = WGS84.raised(pose.height_m)
    angle = limb_angle(los.T.copy(), pose.cam_from_itrs, pose.r_itrs, ellipsoid.axes_m)
    exact = signed_limb_angle(los @ pose.cam_from_itrs, pose.r_itrs, ellipsoid)
    distance = angle.delta / np.linalg.norm(angle.by_direction, axis=0)
    assert distance == pytest.approx(exact, rel=1e-4, abs=1e-12)


@pytest.mark.parametrize(("latitude_deg", "altitude_m"), PLACES)
def test_derivatives_are_those_of_differences(latitude_deg: float, altitude_m: float) -> None:
    pose = _pose(latitude_deg, altitude_m)
    los = _sights_near_the_limb(pose, 2e-2).T.copy()

    def delta(there: LimbPose) -> np.ndarray:
        return limb_angle(los, there.cam_from_itrs, there.r_itrs, WGS84.axes_m + there.height_m).delta

    angle = limb_angle(los, pose.cam_from_itrs, pose.r_itrs, WGS84.axes_m + pose.height_m)
    analytic = np.concatenate([angle.by_rotation, angle.by_position, angle.by_height[None]])
    for i, h in enumerate([1e-5, 1e-5, 1e-5, 50.0, 50.0, 50.0, 50.0]):
        step = np.eye(7)[i] * h
        difference = (delta(pose.moved(step)) - delta(pose.moved(-step))) / (2 * h)
        # rounding of the difference: 1e-15 over the step
        assert analytic[i] == pytest.approx(difference, rel=1e-6, abs=1e-9 if i < 3 else 1e-15)


@pytest.mark.parametrize(("latitude_deg", "altitude_m"), PLACES)
def test_the_closed_form_finds_the_position_of_exact_points(latitude_deg: float, altitude_m: float) -> None:
    pose = _pose(latitude_deg, altitude_m)
    some = horizon_directions(pose.r_itrs, WGS84, np.linspace(0.3, 1.5, 40)) @ pose.cam_from_itrs.T
    found = position_from_limb(some, pose.cam_from_itrs, WGS84)
    # an arc of 70 deg magnifies rounding some thousand times
    assert found == pytest.approx(pose.r_itrs, abs=0.01)


def test_the_closed_form_of_a_sphere_needs_no_attitude() -> None:
    r = np.array([0.0, 0.0, -7e6])
    some = horizon_directions(r, sphere(6.4e6), np.linspace(0.0, 2.0, 20))
    assert position_from_limb(some, np.eye(3), sphere(6.4e6)) == pytest.approx(r, abs=0.01)


def test_points_on_a_plane_through_the_eye_are_no_limb() -> None:
    turn = np.linspace(0.0, 3.0, 20)
    flat = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(20)])
    with pytest.raises(np.linalg.LinAlgError):
        position_from_limb(flat, np.eye(3), sphere(6.4e6))


CAMERAS = [
    CameraModel(160, 120, 147.0, 147.0, 79.5, 59.5),
    CameraModel(203, 101, 180.0, 175.0, 99.0, 52.0, distortion=(-0.1, 0.02, 1e-3, -1e-3, 0.0)),
    CameraModel(150, 150, 60.0, 60.0, 74.5, 74.5, projection="fisheye", image_circle_rad=1.2),
]


@pytest.mark.parametrize("camera", CAMERAS)
def test_no_pixel_near_the_limb_is_missed(camera: CameraModel) -> None:
    off = np.radians(64.0)
    r = -6.9e6 * np.array([np.sin(off), 0.0, np.cos(off)])
    near = near_pixels(camera, np.eye(3), r, sphere(6.4e6).axes_m, 5.0, 3.0)
    # the distance of every pixel by one more way: differences of the angle over whole pixels
    d = unproject(camera, pixel_grid(camera))
    with np.errstate(invalid="ignore"):
        angle = np.arcsin(6.4e6 / 6.9e6) - np.arccos(d @ (-r / 6.9e6))
        by_row, by_column = np.gradient(angle)
        distance = angle / np.hypot(by_row, by_column)
    wanted = (distance > -5.0) & (distance < 3.0)
    got = np.zeros_like(wanted)
    got[near.rows, near.columns] = True
    rim = np.isfinite(distance) & (np.abs(distance + 1.0) < 3.99)
    assert wanted.sum() > 400
    assert (got & rim).sum() == (wanted & rim).sum()


def test_bend_of_a_disc_is_its_radius() -> None:
    """Of a disc about the optical axis; 1e-3 of it for an angle that is no tangent."""
    camera = CameraModel(400, 400, 2000.0, 2000.0, 199.5, 199.5)
    rho = np.arctan(150.0 / 2000.0)
    r = np.array([0.0, 0.0, -6.4e6 / np.sin(rho)])
    turn = np.linspace(0.0, 6.0, 12)
    uv = 199.5 + 150.0 * np.column_stack([np.cos(turn), np.sin(turn)])
    bend = limb_bend(camera, uv, np.eye(3), r, sphere(6.4e6).axes_m)
    assert bend == pytest.approx(-1.0 / 150.0, rel=1e-3)


def test_a_straight_limb_off_the_axis_does_not_bend() -> None:
    """The horizon of a giant sphere is a great circle, and a pinhole's picture of it a straight line."""
    camera = CameraModel(400, 400, 300.0, 300.0, 199.5, 199.5)
    direction = np.array([0.5, 0.0, 0.2])
    r = -direction / np.linalg.norm(direction) * (6.4e12 + 1.0)
    uv = np.column_stack([np.full(9, 79.5), np.linspace(20.0, 380.0, 9)])
    assert np.abs(limb_bend(camera, uv, np.eye(3), r, sphere(6.4e12).axes_m)).max() < 1e-5


def test_scale_of_a_pinhole_on_its_axis_is_its_focal_length() -> None:
    camera = CameraModel(401, 401, 2000.0, 2000.0, 200.0, 200.0)
    r = -7e6 * np.array([np.sin(np.arcsin(6.4 / 7.0)), 0.0, np.cos(np.arcsin(6.4 / 7.0))])
    near = near_pixels(camera, np.eye(3), r, sphere(6.4e6).axes_m, 2.0, 2.0)
    angle = limb_angle(near.los_cam, np.eye(3), r, sphere(6.4e6).axes_m)
    middle = np.argmin(np.hypot(near.columns - 200.0, near.rows - 200.0))
    assert image_scale(angle, near.by_column, near.by_row)[middle] == pytest.approx(1 / 2000.0, rel=1e-5)
