"""Geometry and brightness of pixels near the limb, against independent codes and differences."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.earth.limb_heights import Relief
from horizonval.estimation.fit.edge_pixels import relief_modes
from horizonval.estimation.fit.known import position_from_limb
from horizonval.estimation.fit.light import (
    PIXEL_VARIANCE,
    edge_profile,
    eliminated,
    levels_information,
    light_basis,
    light_noise,
    solve_levels,
)
from horizonval.estimation.fit.pixels import Limb, level_distance, near_pixels, ray_height
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.limb.picture import rounding_variance
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
def test_distances_are_those_to_the_nearest_point_of_the_limb(latitude_deg: float, altitude_m: float) -> None:
    """Against a search of the nearest point of the exact horizon, as angles at the distance of the limb."""
    pose = _pose(latitude_deg, altitude_m)
    los = _sights_near_the_limb(pose, 1e-3)
    ellipsoid = WGS84.raised(pose.height_m)
    ray, across, rise = Limb(pose.cam_from_itrs, pose.r_itrs, ellipsoid.axes_m).seen(los.T.copy())
    exact = signed_limb_angle(los @ pose.cam_from_itrs, pose.r_itrs, ellipsoid)
    # the raised ellipsoid is not at an even height: 0.2 m
    assert -across / (ray.distance_m * rise) == pytest.approx(exact, rel=3e-4, abs=1e-7)


@pytest.mark.parametrize(("latitude_deg", "altitude_m"), PLACES)
def test_derivatives_are_those_of_differences(latitude_deg: float, altitude_m: float) -> None:
    """Within two degrees of the limb: the change of the normal's length is the height over the radius."""
    pose = _pose(latitude_deg, altitude_m)
    los = _sights_near_the_limb(pose, 2e-3).T.copy()
    limb = Limb(pose.cam_from_itrs, pose.r_itrs, WGS84.axes_m + pose.height_m)

    def distance(there: LimbPose) -> np.ndarray:
        axes = WGS84.axes_m + there.height_m
        return level_distance(ray_height(los, there.cam_from_itrs, there.r_itrs, axes).height_m, limb.curve)[0]

    ray, _, rise = limb.seen(los)
    analytic = rise * np.concatenate([ray.by_rotation(los), ray.by_position, -np.ones((1, len(rise)))])
    for i, h in enumerate([1e-5, 1e-5, 1e-5, 50.0, 50.0, 50.0, 50.0]):
        step = np.eye(7)[i] * h
        difference = (distance(pose.moved(step)) - distance(pose.moved(-step))) / (2 * h)
        assert analytic[i] == pytest.approx(difference, abs=0.02 * np.abs(difference).max())


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
    near = near_pixels(camera, LimbPose(np.eye(3), r), sphere(6.4e6).axes_m, 5.0, 3.0)
    # the distance of every pixel by one more way: differences of the angle over whole pixels
    d = unproject(camera, pixel_grid(camera))
    with np.errstate(invalid="ignore"):
        angle = np.arcsin(6.4e6 / 6.9e6) - np.arccos(d @ (-r / 6.9e6))
        by_row, by_column = np.gradient(angle)
        distance = angle / np.hypot(by_row, by_column)
    wanted = (distance > -5.0) & (distance < 3.0)
    got = np.zeros_like(wanted)
    got[near.rows, near.columns] = True
    rim = np.isfinite(distance) & (np.abs(distance + 1.0) < 3.9)
    assert wanted.sum() > 400
    assert (got & rim).sum() == (wanted & rim).sum()


def test_a_blur_moves_a_bent_limb_by_its_curvature() -> None:
    """Of a disc about the optical axis; 1e-3 of it for an angle that is no tangent."""
    camera = CameraModel(400, 400, 2000.0, 2000.0, 199.5, 199.5)
    rho = np.arctan(150.0 / 2000.0)
    limb = Limb(np.eye(3), np.array([0.0, 0.0, -6.4e6 / np.sin(rho)]), sphere(6.4e6).axes_m)
    turn = np.linspace(0.0, 6.0, 12)
    outwards = np.array([np.cos(turn), np.sin(turn)])
    pixel_m = 6.4e6 * np.cos(rho) / np.sin(rho) * np.cos(rho) ** 2 / 2000.0
    bend = limb.bend_m(camera, 199.5 + 150.0 * outwards.T, pixel_m * outwards)
    assert bend == pytest.approx(0.5 * pixel_m / 150.0, rel=2e-3)


def test_a_straight_limb_off_the_axis_does_not_bend() -> None:
    """The horizon of a giant sphere is a great circle, and a pinhole's picture of it a straight line."""
    camera = CameraModel(400, 400, 300.0, 300.0, 199.5, 199.5)
    direction = np.array([0.5, 0.0, 0.2]) / np.linalg.norm([0.5, 0.0, 0.2])
    limb = Limb(np.eye(3), -direction * (6.4e12 + 1e9), sphere(6.4e12).axes_m)
    near = near_pixels(camera, LimbPose(np.eye(3), -direction * (6.4e12 + 1e9)), sphere(6.4e12).axes_m, 1.0, 1.0)
    uv = np.column_stack([near.columns, near.rows]).astype(float)
    assert np.abs(limb.bend_m(camera, uv, near.gradient) / near.width_m).max() < 1e-3


def test_a_pixel_of_a_pinhole_on_its_axis_sees_its_focal_length() -> None:
    camera = CameraModel(401, 401, 2000.0, 2000.0, 200.0, 200.0)
    r = -7e6 * np.array([np.sin(np.arcsin(6.4 / 7.0)), 0.0, np.cos(np.arcsin(6.4 / 7.0))])
    near = near_pixels(camera, LimbPose(np.eye(3), r), sphere(6.4e6).axes_m, 2.0, 2.0)
    middle = np.argmin(np.hypot(near.columns - 200.0, near.rows - 200.0))
    assert near.width_m[middle] == pytest.approx(np.sqrt(7e6**2 - 6.4e6**2) / 2000.0, rel=1e-5)


def _summed(x: np.ndarray, lens_px: float, scale: float, slant_rad: float) -> np.ndarray:
    """A sky that is 1 inside and falls exponentially outside, summed over a square pixel turned against the limb and a
    Gaussian, on a grid of a hundredth of a pixel."""
    fine = np.arange(-40.0, 40.0, 0.01) + 0.005
    sky = np.where(fine > 0.0, 1.0, np.exp(np.minimum(fine, 0.0) / scale) if scale > 0.0 else 0.0)
    kernel = np.exp(-0.5 * (np.arange(-800, 801) * 0.01 / lens_px) ** 2)
    for side in (abs(np.cos(slant_rad)), abs(np.sin(slant_rad))):
        half = round(side / 0.02)
        kernel = np.convolve(kernel, np.ones(2 * half + 1), mode="same") if half else kernel
    blurred = np.convolve(sky, kernel / kernel.sum(), mode="same")
    return np.interp(x, fine, blurred)


@pytest.mark.parametrize("scale", [0.0, 0.3, 2.0, 8.0])
@pytest.mark.parametrize("slant_deg", [0.0, 45.0])
@pytest.mark.parametrize(("lens_px", "tolerance"), [(0.7, 1.2e-3), (0.4, 6e-3)])
def test_levels_are_those_of_a_square_pixel_behind_a_gaussian_lens(
    scale: float, slant_deg: float, lens_px: float, tolerance: float
) -> None:
    """The square is taken for a Gaussian: 7e-4 of the step at 0.7 px, 4e-3 at 0.4 px, and a grid's half step."""
    x = np.linspace(-9.0, 7.0, 101)
    blur = float(np.sqrt(lens_px**2 + PIXEL_VARIANCE))
    level = edge_profile(x, blur, np.full(101, scale) if scale > 0.0 else None).level
    difference = level - _summed(x, lens_px, scale, np.radians(slant_deg))
    assert np.abs(difference).max() < tolerance
    # What is left widens the edge and does not move it: it is odd.
    assert abs(difference.sum() * 0.16) < 1e-2


@pytest.mark.parametrize("scale", [0.0, 0.02, 0.5, 3.0])
def test_derivatives_of_the_profile(scale: float) -> None:
    x, blur, h = np.linspace(-12.0, 8.0, 81), 0.8, 1e-5
    soft = np.full(81, scale) if scale > 0.0 else None
    edge = edge_profile(x, blur, soft)
    by_x = (edge_profile(x + h, blur, soft).level - edge_profile(x - h, blur, soft).level) / (2 * h)
    by_blur = (edge_profile(x, blur + h, soft).level - edge_profile(x, blur - h, soft).level) / (2 * h)
    assert edge.slope == pytest.approx(by_x, abs=1e-8)
    assert edge.by_blur == pytest.approx(by_blur, abs=1e-8)
    if soft is not None:
        by_scale = (edge_profile(x, blur, soft + h).level - edge_profile(x, blur, soft - h).level) / (2 * h)
        assert edge.by_scale == pytest.approx(by_scale, abs=1e-8)


def test_the_series_of_a_nearly_hard_limb_continues_the_profile() -> None:
    x = np.linspace(-4.0, 4.0, 81)
    below, above = (edge_profile(x, 0.8, np.full(81, scale)).level for scale in (0.04 - 1e-9, 0.04 + 1e-9))
    assert below == pytest.approx(above, abs=1e-4)


def _problem(spread: float) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(4)
    x = rng.uniform(-10.0, 8.0, 900)
    edge = 1.0 / (1.0 + np.exp(-2.0 * x))
    basis = np.array([np.ones(900), edge, edge * x])
    levels = np.array([20.0, 150.0, 0.0]) + spread * rng.normal(size=(9, 3)) * [5.0, 30.0, 1.0]
    values = np.einsum("ij,ij->j", basis, np.repeat(levels, 100, axis=0).T) + rng.normal(0.0, 2.0, 900)
    jacobian = rng.normal(size=(4, 900)) * edge * (1.0 - edge)
    return basis, values, np.full(900, 0.25), jacobian, levels


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_elimination_is_the_whole_system_with_its_priors(spread: float) -> None:
    """Against one dense least-squares problem of shared unknowns, mean levels and every sector's departure."""
    basis, values, weights, jacobian, _ = _problem(spread)
    sectors = 9
    information = levels_information(basis, values, weights, sectors)
    light = solve_levels(basis, values, weights, sectors, information)
    residuals = values - light.of_pixels(basis)
    normal = eliminated(jacobian, basis, weights, sectors, information)
    right = jacobian @ (weights * residuals)
    whole = np.zeros((4 + 2 + 3 * sectors, 900))
    whole[:4], whole[4:6] = jacobian, basis[:2]
    for i, (first, last) in enumerate(pairwise(range(0, 1000, 100))):
        whole[6 + 3 * i : 9 + 3 * i, first:last] = basis[:, first:last]
    prior = np.diag(np.concatenate([np.zeros(6), np.tile(information, sectors)]))
    dense = (whole * weights) @ whole.T + prior
    solution = np.linalg.solve(dense, whole @ (weights * values))
    assert np.linalg.solve(normal, right) == pytest.approx(solution[:4], rel=1e-5, abs=1e-7)
    assert np.linalg.inv(normal) == pytest.approx(np.linalg.inv(dense)[:4, :4], rel=1e-4, abs=1e-9)


def test_even_light_is_known_as_one_level_and_uneven_light_by_sector() -> None:
    basis, values, weights, _, _ = _problem(0.0)
    even = solve_levels(basis, values, weights, 9, levels_information(basis, values, weights, 9)).of_sector
    # 900 pixels of 2 levels: 0.1 of the background; a sector alone, a hundred pixels, three times as much
    assert np.ptp(even[:, 0]) < 0.4
    basis, values, weights, _, levels = _problem(1.0)
    uneven = solve_levels(basis, values, weights, 9, levels_information(basis, values, weights, 9)).of_sector
    assert uneven[:, 1] == pytest.approx(levels[:, 1], abs=4.0)


def test_modes_make_the_relief() -> None:
    reliefs = (Relief(800.0, 0.4), Relief(300.0, 0.1))
    nodes, modes = relief_modes(1.5, reliefs)
    covariance = modes.T @ modes
    apart = nodes[:, None] - nodes[None, :]
    wanted = sum(r.sigma_m**2 * np.exp(-0.5 * (apart / r.correlation_rad) ** 2) for r in reliefs)
    # a mean over nodes of half a correlation length, and the thousandth that is left out
    assert covariance == pytest.approx(wanted, abs=0.03 * (800.0**2 + 300.0**2))
    assert len(modes) < len(nodes)


@pytest.mark.parametrize("night", [0, 6, 8])
def test_black_night_is_not_read_as_noise_of_the_earth(night: int) -> None:
    """Eight bits of space and night are exactly black: as noise of the Earth it made all that clouds do an outlier."""
    rng = np.random.default_rng(8)
    x, along = rng.uniform(-10.0, 8.0, 4000), rng.uniform(-0.5, 0.5, 4000)
    edge = edge_profile(x, 0.75, None).level
    lit = np.arange(4000) >= 400 * night
    values = np.rint(lit * edge * np.maximum(rng.normal(120.0, 12.0, 4000), 0.0))
    basis, places = light_basis(edge, x, along), np.array([400.0 * along + 200.0, x + 10.0])
    noise, _ = light_noise(basis, places, values, np.ones(4000), 10, rounding_variance(values))
    # By chance: three standard deviations of a variance of so many pixels.
    assert noise.parts[1] == pytest.approx(12.0**2, rel=3.0 * np.sqrt(2.0 / np.sum(lit & (edge > 0.9))))
    assert np.median(1.0 / noise.variance[lit & (edge > 0.9)]) > 0.5 / 12.0**2
