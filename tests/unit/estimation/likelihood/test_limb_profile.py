"""The fit of the whole profile of the limb on pictures made without the package: air, lens and noise by numpy alone."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_limbs import (
    BLACK,
    CAMERA,
    HEIGHT_M,
    LENGTH_RAD,
    RADIUS_M,
    mean_profile,
    picture,
    table,
    view,
)
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit import known_profile
from horizonval.estimation.fit.air import KnownAir
from horizonval.estimation.fit.blurred import AROUND, BlurredProfiles, around_of
from horizonval.estimation.fit.bundle import ShotPrior
from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.image import LENS, POSE, ShotState
from horizonval.estimation.fit.known_profile import start_pose
from horizonval.estimation.fit.pixels import ray_height
from horizonval.estimation.fit.pose import LimbPose, nadir_derivative
from horizonval.estimation.fit.profile import (
    BACKGROUND,
    OWN,
    ProfileChooser,
    ProfileImage,
    ProfileKnowledge,
    ProfileModel,
)
from horizonval.estimation.fit.profile_fit import OPTIONS, ProfileFit, fit_profiles, strained
from horizonval.estimation.fit.profile_pixels import profile_pixels
from horizonval.estimation.fit.templates import LimbTemplates, load_templates
from horizonval.estimation.lens_error import miscalibrated
from horizonval.estimation.methods import limb_profile
from horizonval.estimation.observation import Fit, Lens, Observation
from horizonval.estimation.prior import Prior
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import WGS84, sphere
from horizonval.sensor.expected_image import stated_lens
from horizonval.sensor.lens import lens_spread
from horizonval.spec.load import load_camera

ARCSEC = np.radians(1.0 / 3600.0)
A_M, B_M = 6378137.0, 6356752.314245
POSITION_SIGMA_M, TILT_SIGMA_RAD = 1e3, np.radians(1.0)
EPOCH = datetime(2026, 1, 16, 12, tzinfo=UTC)


def fit_profile(
    image: np.ndarray, camera: CameraModel, start: LimbPose, knowledge: ProfileKnowledge, **options: int
) -> ProfileFit:
    prior = ShotPrior(knowledge.mean, knowledge.information)
    return fit_profiles([ProfileImage(image, camera, knowledge)], prior, start, replace(OPTIONS, **options))


def fitted(
    seed: int, *, modes: bool, lift_sigma_m: float, left: bool = False, altitude_m: float = 600e3, **drawn: float
) -> tuple[ProfileFit, np.ndarray, np.ndarray]:
    """One picture's fit from a coarse prior, the error of its nadir in the plane across, and that plane."""
    r, cam, rng = view(seed, altitude_m)
    image = picture(cam, r, rng, modes=modes, left=left, **drawn)
    coarse = Rotation.from_rotvec(rng.normal(size=3) * TILT_SIGMA_RAD).as_matrix() @ cam
    mean = LimbPose(coarse, r + rng.normal(0.0, POSITION_SIGMA_M, 3))
    information = np.diag([TILT_SIGMA_RAD**-2] * 3 + [POSITION_SIGMA_M**-2] * 3 + [lift_sigma_m**-2])
    air = KnownAir(table(modes=modes, left=left), EPOCH, None, np.array([1.0, 0.0, 0.0]))
    planet = sphere(RADIUS_M)
    knowledge = ProfileKnowledge(planet, mean, information, air)
    start = start_pose(image, CAMERA, knowledge, TILT_SIGMA_RAD)
    fit = fit_profile(image, CAMERA, start, knowledge)
    true = -cam @ r / np.linalg.norm(r)
    across = np.linalg.svd(true[None])[2][1:]
    return fit, across @ (fit.pose.nadir_cam - true), across


def scores(count: int, *, modes: bool, lift_sigma_m: float, left: bool = False) -> tuple[float, float, list[float]]:
    """Rms error and rms claim [rad], and squared errors over what is claimed, of one degree of freedom."""
    errors, claims, squares = [], [], []
    for seed in range(count):
        fit, error, across = fitted(seed, modes=modes, lift_sigma_m=lift_sigma_m, left=left)
        by = across @ nadir_derivative(fit.pose)
        covariance = by @ fit.covariance @ by.T
        errors.append(error @ error)
        claims.append(np.trace(covariance))
        squares.append(float(0.5 * error @ np.linalg.solve(covariance, error)))
    return float(np.sqrt(np.mean(errors))), float(np.sqrt(np.mean(claims))), squares


def test_known_air_is_fitted_as_well_as_is_claimed() -> None:
    """Eight draws, 16 squares of unit normals: their mean is 1 to 0.35; up to 2.2 is 3.4 of it."""
    error, claim, squares = scores(8, modes=False, lift_sigma_m=300.0)
    assert 0.2 < np.mean(squares) < 2.2
    assert error < 1.6 * claim
    # A pixel is 2300 arcsec: the whole profile gives the nadir to a fiftieth of it.
    assert error < 45.0 * ARCSEC


def test_air_that_differs_along_the_limb_is_in_the_claim() -> None:
    """The edge 1.2 km higher or lower, from place to place: an unknown of the fit, and most of what it claims.

    The median of eight squares of two degrees of freedom, 0.69 for unit normals, is below 1.7 in 99 of 100 cases.
    """
    _, claim, squares = scores(8, modes=True, lift_sigma_m=50.0)
    assert 0.1 < np.median(squares) < 1.7
    assert claim > 2.0 * scores(2, modes=False, lift_sigma_m=50.0)[1]
    # Blind to it, a fit would be off by 1.2 km and more, at 80 arcsec a kilometre.
    assert claim < 200.0 * ARCSEC


def test_what_no_mode_holds_is_in_the_claim() -> None:
    """Left-overs alike over height and along the limb, as bright as two times the noise of a pixel and more.

    Twenty squares of unit normals: their mean is within 0.37 and 2.0 in 99 of 100 cases (chi-squared / 20).
    """
    _, claim, squares = scores(10, modes=False, left=True, lift_sigma_m=50.0)
    assert 0.37 < np.mean(squares) < 2.0
    assert claim > 1.2 * scores(2, modes=False, lift_sigma_m=50.0)[1]


def test_air_as_it_is_told_strains_nothing() -> None:
    """Squares of the air's unknowns over how many are determined: 1 in the mean of four draws, of ten each to 0.22."""
    ratios = []
    for seed in range(4):
        image, knowledge, start = knowledge_of(seed, CAMERA)
        fit = fit_profile(image, CAMERA, start, knowledge)
        assert 4.0 < fit.determined < 60.0
        ratios.append(fit.squares / fit.determined)
    assert 0.5 < np.mean(ratios) < 1.6


def test_air_unlike_its_table_is_claimed_wider() -> None:
    """Modes twice as strong as the table has them: the claim grows by about as much, and holds the errors.

    The mean of three squares of two degrees of freedom is below 2.6 in 98 of 100 cases.
    """
    squares, wider = [], []
    for seed in range(3):
        image, knowledge, start = knowledge_of(seed, CAMERA, strength=2.5)
        fit = fit_profile(image, CAMERA, start, knowledge)
        true = -view(seed)[1] @ view(seed)[0] / np.linalg.norm(view(seed)[0])
        across = np.linalg.svd(true[None])[2][1:]
        by = across @ nadir_derivative(fit.pose)
        error = across @ (fit.pose.nadir_cam - true)
        squares.append(float(0.5 * error @ np.linalg.solve(by @ fit.covariance @ by.T, error)))
        of_air = by @ fit.relief_covariance @ by.T
        plain = by @ fit.covariance @ by.T - of_air + of_air / strained(fit.squares, fit.determined)
        wider.append(np.trace(by @ fit.covariance @ by.T) / np.trace(plain))
    assert np.median(wider) > 1.5
    assert np.mean(squares) < 2.6


def test_rounding_is_noise_too() -> None:
    """Noise of a tenth of a step: dark pixels have one number but for a few, and are no more certain than rounding is.

    When they seemed to be, two of these fits used up their steps. Eight squares of two degrees of freedom: their mean
    is 1 to 0.35 for unit normals, and the claim is to be of use too.
    """
    steps, squares = [], []
    for seed in range(8):
        fit, error, across = fitted(seed, modes=False, lift_sigma_m=300.0, noise=0.1, bright=100.0)
        by = across @ nadir_derivative(fit.pose)
        steps.append(len(fit.steps))
        squares.append(float(0.5 * error @ np.linalg.solve(by @ fit.covariance @ by.T, error)))
    assert max(steps) < 25
    assert 0.2 < np.mean(squares) < 2.2


def test_pixels_wider_than_the_table_is_deep() -> None:
    """From the geostationary ring a pixel of 0.64 deg is 465 km of height: below the table its last level goes on.

    30 arcsec are 0.013 px: the picture's finest steps are 78 km wide, over an edge of 12 km.
    """
    for seed in range(3):
        _, error, _ = fitted(seed, modes=False, lift_sigma_m=300.0, altitude_m=35786e3)
        assert np.linalg.norm(error) < 30.0 * ARCSEC


def test_lines_below_the_limb_see_the_air_where_they_end() -> None:
    """Of a table whose brightness is the latitude, and of one mode: places by intersecting lines with a sphere."""
    latitudes = np.radians(np.arange(-80.0, 81.0, 10.0))
    source_m = float(HEIGHT_M[HEIGHT_M <= 20e3][-1])
    step = (source_m >= HEIGHT_M).astype(float)
    known = replace(
        table(modes=False),
        axes=(latitudes, np.array([1.0])),
        mean=(1.0 + latitudes)[:, None, None] * step,
        modes=np.broadcast_to(step, (len(latitudes), 1, 1, len(step))),
        mode_kinds=("air",),
        correlation_rad=everywhere([LENGTH_RAD], len(latitudes)),
        left_sigma=np.zeros((len(latitudes), 1, len(step))),
    )
    air = KnownAir(known, EPOCH, None, np.array([1.0, 0.0, 0.0]))
    # The lowest point stands above the equator; the line comes from the south and leads to the north.
    normal, los = np.array([[1.0, 0.0, 0.0]] * 2), np.array([[0.0, 0.0, 1.0]] * 2)
    nodes = air.nodes(normal, los, LimbPose(np.eye(3), np.array([0.0, 0.0, -7e6])), (-60e3, 60e3, 500.0), 0.0)
    grid = nodes.bottom_m + nodes.step_m * np.arange(nodes.functions.shape[2])
    at = np.array([-50e3, -20e3, 0.0, 10e3])
    ends = np.arccos((RADIUS_M + at) / (RADIUS_M + source_m))
    mean, near, elsewhere = (np.interp(at, grid, nodes.functions[0, k]) for k in range(3))
    # Multilinear between latitudes and places of the table; the angle is the square root's, right to 0.3 %.
    np.testing.assert_allclose(mean, 1.0 - ends, atol=2e-3)
    np.testing.assert_allclose(near, np.exp(-0.5 * (ends / LENGTH_RAD) ** 2), atol=6e-3)
    np.testing.assert_allclose(near**2 + elsewhere**2, 1.0, atol=2e-3)


def sunlit(light: Any) -> LimbTemplates:
    """Profiles that are even over height, as bright as a function of the Sun's zenith angle and azimuth says."""
    zenith, azimuth = np.radians(np.arange(0.0, 91.0, 5.0)), np.radians(np.arange(0.0, 181.0, 15.0))
    height = np.array([-60e3, 0.0, 60e3])
    mean = light(zenith[:, None, None], azimuth[None, :, None]) * np.ones(3)
    none = np.zeros((*mean.shape[:2], 0, 3))
    return LimbTemplates(
        "solar",
        (0.45, 0.75),
        height,
        (zenith, azimuth),
        mean,
        none,
        (),
        everywhere([], len(zenith)),
        np.zeros_like(mean),
    )


def test_every_height_stands_under_its_own_sun() -> None:
    distance_m, zenith = 2.0e6, np.radians(40.0)
    heights = replace(sunlit(lambda z, a: (1.0 + z + 0.0 * a) ** 2), height_m=np.linspace(-20e3, 60e3, 3))
    normal, los = np.array([[1.0, 0.0, 0.0]] * 2), np.array([[0.0, 0.0, 1.0]] * 2)
    air = KnownAir(heights, EPOCH, None, np.array([np.cos(zenith), 0.0, np.sin(zenith)]))
    curve = RADIUS_M / (2.0 * distance_m**2)
    nodes = air.nodes(normal, los, LimbPose(np.eye(3), np.array([7e6, 0.0, 0.0])), (-15e3, 55e3, 500.0), curve)
    y = nodes.bottom_m + nodes.step_m * np.arange(nodes.functions.shape[2])
    # Who looks higher looks at what is nearer: ahead, where the Sun is, it stands lower there.
    inside = slice(2, -2)
    expected = (1.0 + zenith + (y - curve * y**2) / distance_m) ** 2
    np.testing.assert_allclose(nodes.functions[0, 0, inside], expected[inside], rtol=3e-4)


def test_a_sun_sensor_says_the_azimuth_alone() -> None:
    place = LimbPose(np.eye(3), np.array([7e6, 0.0, 0.0]))
    sun = np.array([0.5, 0.6, np.sqrt(1.0 - 0.5**2 - 0.6**2)])
    table = sunlit(lambda z, a: 1.0 + z + np.sin(a) ** 2)
    normal, los, at = np.array([[0.8, 0.6, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([10e3])

    def light(read: np.ndarray | None) -> float:
        return float(KnownAir(table, EPOCH, read, sun).means(normal, los, place, at)[0, 0])

    level = np.cross([1.0, 0.0, 0.0], sun)
    higher = Rotation.from_rotvec(np.radians(0.4) * level / np.linalg.norm(level)).apply(sun)
    assert light(higher) == pytest.approx(light(None), rel=1e-12)
    assert light(Rotation.from_rotvec([np.radians(0.4), 0.0, 0.0]).apply(sun)) != pytest.approx(light(None), rel=1e-4)


def test_a_sun_sensor_that_contradicts_the_time_is_believed_alone() -> None:
    """The same light as under a Sun that the time says to be where the sensor sees it."""
    place = LimbPose(np.eye(3), np.array([7e6, 0.0, 0.0]))
    sun = np.array([0.5, 0.6, np.sqrt(1.0 - 0.5**2 - 0.6**2)])
    hours_off = Rotation.from_rotvec([0.0, 0.4, 0.5]).apply(sun)
    observation = _level_image(q_cam_from_itrs=np.array([0.0, 0.0, 0.0, 1.0]), attitude_sigma_rad=np.full(3, 0.03))
    near = Rotation.from_rotvec([0.0, 0.03, 0.0]).apply(sun)
    assert known_profile.known_sun_itrs(replace(observation, sun_cam=sun), hours_off) is None
    for read in (near, None):
        assert known_profile.known_sun_itrs(replace(observation, sun_cam=read), sun) is sun
    table = sunlit(lambda z, a: 1.0 + z + np.sin(a) ** 2)
    normal, los, at = np.array([[0.8, 0.6, 0.0]]), np.array([[0.0, 0.0, 1.0]]), np.array([10e3])
    right, read = (KnownAir(table, EPOCH, sun, one).means(normal, los, place, at) for one in (sun, None))
    np.testing.assert_allclose(read, right, rtol=1e-12)


def test_nodes_stand_on_the_limb_of_the_ellipsoid() -> None:
    r, cam, _ = view(1)
    pose, axes = LimbPose(cam, r), WGS84.axes_m
    image = np.zeros((CAMERA.height, CAMERA.width))
    near = profile_pixels(image, CAMERA, pose, np.zeros(LENS), WGS84, (-40e3, 60e3), 60e3)
    heights = ray_height(near.nodes.los_cam.T, cam, r, axes).height_m
    assert np.abs(heights).max() < 1.0


def test_height_of_a_ray_is_the_least_along_it() -> None:
    """Against a search along the ray for its lowest point, whose height is found by search as well."""
    rng = np.random.default_rng(1)
    axes = np.array([A_M, A_M, B_M])

    def height(point: np.ndarray) -> float:
        rho, z = float(np.hypot(point[0], point[1])), float(point[2])

        def distance2(beta: float) -> float:
            return (rho - A_M * np.cos(beta)) ** 2 + (z - B_M * np.sin(beta)) ** 2

        there = float(np.arctan2(z, rho))
        found = minimize_scalar(
            distance2, bounds=(there - 0.02, there + 0.02), method="bounded", options={"xatol": 1e-12}
        )
        sign = 1.0 if np.sum((point / axes) ** 2) > 1.0 else -1.0
        return sign * float(np.sqrt(found.fun))

    for wanted in (-30e3, 0.0, 20e3, 70e3):
        r, cam, _ = view(int(rng.integers(1000)), 700e3)
        off = np.arcsin((6368e3 + wanted) / np.linalg.norm(r))
        up = r / np.linalg.norm(r)
        level = np.cross(up, rng.normal(size=3))
        level /= np.linalg.norm(level)
        d = -np.cos(off) * up + np.sin(off) * level
        ray = ray_height((cam @ d)[:, None], cam, r, axes)
        ways = ray.distance_m[0] + np.linspace(-40e3, 40e3, 161)
        least = min(height(r + way * d) for way in ways)
        # the scaled ellipsoid is not at an even height: 2 f h^2 / a, 5 m; steps of 500 m miss the least by 5 mm
        assert abs(ray.height_m[0] - least) < 6.0
        turn = np.array([3e-6, -2e-6, 4e-6])
        turned = Rotation.from_rotvec(turn).as_matrix() @ cam
        moved = ray_height((cam @ d)[:, None], turned, r, axes).height_m[0] - ray.height_m[0]
        assert moved == pytest.approx(float(turn @ ray.by_rotation((cam @ d)[:, None])[:, 0]), rel=0.02, abs=0.02)
        shift = np.array([10.0, -20.0, 15.0])
        shifted = ray_height((cam @ d)[:, None], cam, r + shift, axes).height_m[0] - ray.height_m[0]
        assert shifted == pytest.approx(float(ray.by_position[:, 0] @ shift), abs=0.3)


def on(grid: np.ndarray, coefficients: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the spline of coefficients (..., n) on a grid at heights."""
    place = np.clip(((at - grid[0]) / (grid[1] - grid[0])).astype(int), 1, len(grid) - 3)
    weights, _ = around_of((at - grid[place]) / (grid[1] - grid[0]))
    return np.asarray(np.sum(coefficients[..., place + AROUND[:, None]] * weights, axis=-2))


def test_blurred_profiles_are_convolutions() -> None:
    """Against sums over a fine grid, and derivatives against differences, of a smooth lens and a sampled one."""
    step = 500.0
    grid = np.arange(-100e3, 150e3, step)
    profile = mean_profile(grid)
    sigma = 9e3
    tables = BlurredProfiles(profile[None, None], step, np.array([[0.8, 0.6]]) * 12e3)
    blur = sigma / 12e3
    blurred = tables.values(blur, 0.0)[0, 0]
    at = np.array([-20e3, 0.0, 30e3, 45e3])
    fine = np.arange(-6.0, 6.0, 0.05) * sigma
    weight = np.exp(-0.5 * (fine / sigma) ** 2)
    # a square pixel of 12 km, seen askew
    square = np.meshgrid(*(part * (np.arange(40) - 19.5) / 40.0 for part in (0.8 * 12e3, 0.6 * 12e3)))
    pixel = (square[0] + square[1]).ravel()
    wanted = [(mean_profile(h + fine[:, None] + pixel).mean(axis=1) @ weight) / weight.sum() for h in at]
    np.testing.assert_allclose(on(grid, blurred, at), wanted, atol=2e-4)
    one = np.ones((1, 1))
    for sharpness in (0.0, 0.7):
        level, by_blur, by_sharpness = tables.changes(one, blur, sharpness)[:, 0]
        np.testing.assert_allclose(level, tables.values(blur, sharpness)[0, 0], atol=1e-12)
        wider, narrower = (tables.values(blur * f, sharpness)[0, 0] for f in (np.exp(0.01), np.exp(-0.01)))
        np.testing.assert_allclose(by_blur, (wider - narrower) / 0.02, atol=1e-4)
        steeper = tables.values(blur, 1.0)[0, 0] - tables.values(blur, 0.0)[0, 0]
        np.testing.assert_allclose(by_sharpness, steeper, atol=1e-12)


def test_a_sharp_lens_is_one_of_samples_at_whole_pixels() -> None:
    """Against sums over pixels; 30 km wide, an edge of 12 km shows another lens by a hundredth of its step."""
    step, pixel_m, blur = 500.0, 30e3, 0.5
    grid = np.arange(-300e3, 350e3, step)
    tables = BlurredProfiles(mean_profile(grid)[None, None], step, np.array([[0.8, 0.6]]) * pixel_m)
    offsets = np.meshgrid(*(part * pixel_m * (np.arange(40) - 19.5) / 40.0 for part in (0.8, 0.6)))
    pixel = (offsets[0] + offsets[1]).ravel()
    place = np.arange(-6, 7)
    comb = np.exp(-0.5 * (place / blur) ** 2)
    weight = np.outer(comb, comb).ravel() / comb.sum() ** 2
    away = np.add.outer(0.8 * pixel_m * place, 0.6 * pixel_m * place).ravel()
    at = np.array([0.0, 20e3, 35e3, 60e3])
    wanted = [weight @ mean_profile(h + away[:, None] + pixel).mean(axis=1) for h in at]
    smooth, sharp = (on(grid, tables.values(blur, q)[0, 0], at) for q in (0.0, 1.0))
    np.testing.assert_allclose(sharp, wanted, atol=5e-4)
    assert np.abs(smooth - sharp).max() > 5e-3


def test_a_lens_that_is_softer_outside_mixes_both_blurs() -> None:
    """By where a place lies between the angles; beyond them the last one's. Derivatives against differences."""
    step, boxes = 500.0, np.array([[0.8, 0.6]] * 4) * 12e3
    grid = np.arange(-100e3, 150e3, step)
    profiles = np.repeat(mean_profile(grid)[None, None], 4, axis=0)
    lens = Lens(np.array([0.1, 0.5]), np.array([0.6, 1.2]))
    tables = BlurredProfiles(profiles, step, boxes, lens, np.array([0.0, 0.2, 0.5, 0.7]))
    one = BlurredProfiles(profiles, step, boxes)
    sharp, soft = one.values(0.6 * 0.8, 0.3)[:, 0], one.values(1.2 * 0.8, 0.3)[:, 0]
    share = np.array([0.0, 0.25, 1.0, 1.0])[:, None]
    np.testing.assert_allclose(tables.values(0.8, 0.3)[:, 0], (1.0 - share) * sharp + share * soft, atol=1e-12)
    by_blur = tables.changes(np.ones((4, 1)), 0.8, 0.3)[1]
    wider, narrower = (tables.values(0.8 * f, 0.3)[:, 0] for f in (np.exp(0.01), np.exp(-0.01)))
    np.testing.assert_allclose(by_blur, (wider - narrower) / 0.02, atol=1e-4)
    weights = np.random.default_rng(5).normal(size=(4, len(grid)))
    pulled = tables.pull(weights, 0.8, 0.3)
    np.testing.assert_allclose(pulled[:, 0], np.sum(weights * tables.values(0.8, 0.3)[:, 0], axis=1), rtol=1e-9)


def test_an_aperture_throws_an_edge_as_far_as_its_rings_say() -> None:
    """Far out a point's light falls as lambda N / (pi^3 r^3), and an edge's as 2 lambda N / (pi^3 x)."""
    step, pixel_m, spread_px = 250.0, 10e3, 0.44
    grid = np.arange(-2000e3, 2000e3, step)
    edge = (grid < 0.0).astype(float)
    tables = BlurredProfiles(edge[None, None], step, np.array([[1.0, 0.0]]) * pixel_m, Lens(diffraction_px=spread_px))
    blurred = tables.values(0.5, 0.0)[0, 0]
    far_px = np.array([5.0, 8.0, 12.0])
    wanted = 2.0 * spread_px / (np.pi**3 * far_px)
    # The edge's mirror image at the grid's end is 20 to 50 times as far: 5 %.
    np.testing.assert_allclose(on(grid, blurred, far_px * pixel_m), wanted, rtol=0.07)
    np.testing.assert_allclose(1.0 - on(grid, blurred, -far_px * pixel_m), wanted, rtol=0.07)


@pytest.mark.parametrize(
    ("name", "sigma_px"), [("ir-bolometer-160-57deg-full", 0.5), ("vis-cmos-1024-60deg-full", 0.9)]
)
def test_a_sampled_lens_behind_its_aperture_is_the_simulated_one(name: str, sigma_px: float) -> None:
    """Against sums over the simulated sensor's kernel, whose band has many wavelengths and whose square ends."""
    camera = load_camera(name)
    lens = stated_lens(camera, camera.band[0])
    assert lens is not None
    assert camera.detector is not None
    pitch_m, f_number = 1e-6 * camera.detector.pixel_pitch_um, camera.optics.f_number
    reach = lens_spread.core_reach_px(sigma_px, 0.0, lens.diffraction_px)
    kernel = lens_spread.core_kernel(sigma_px, 0.0, camera.band[0], f_number, pitch_m, reach)
    step, pixel_m = 500.0, 10e3
    grid = np.arange(-400e3, 500e3, step)
    boxes, one_aperture = np.array([[0.8, 0.6]]) * pixel_m, Lens(diffraction_px=lens.diffraction_px)
    tables = BlurredProfiles(mean_profile(grid)[None, None], step, boxes, one_aperture)
    offsets = np.meshgrid(*(part * (np.arange(20) - 9.5) / 20.0 for part in boxes[0]))
    pixel, place = (offsets[0] + offsets[1]).ravel(), np.arange(-reach, reach + 1)
    away = np.add.outer(boxes[0, 1] * place, boxes[0, 0] * place).ravel()
    at = np.array([0.0, 20e3, 30e3, 40e3, 60e3])
    wanted = [kernel.ravel() @ mean_profile(h + away[:, None] + pixel).mean(axis=1) for h in at]
    np.testing.assert_allclose(on(grid, tables.values(sigma_px, 1.0)[0, 0], at), wanted, atol=0.012)


def test_a_spline_of_half_the_places_has_the_same_heights_and_slopes() -> None:
    """Of a profile that is blurred by half a pixel, 12 and 24 places a pixel: a level apart by 1e-5."""
    pixel_m, at = 12e3, np.linspace(-20e3, 60e3, 200)
    found = []
    for step in (1000.0, 500.0):
        grid = -100e3 + step * np.arange(int(200e3 / step) + 1)
        edges = grid[:, None] + step * (np.arange(20) - 9.5) / 20.0
        tables = BlurredProfiles(mean_profile(edges).mean(axis=1)[None, None], step, np.array([[0.8, 0.6]]) * pixel_m)
        found.append(on(grid, tables.values(0.5, 0.5)[0, 0], at))
    np.testing.assert_allclose(found[0], found[1], atol=1e-5)
    share = np.linspace(0.0, 1.0, 11)
    weights, slopes = around_of(share)
    np.testing.assert_allclose(np.gradient(weights, share, axis=1)[:, 1:-1], slopes[:, 1:-1], atol=5e-3)
    np.testing.assert_allclose(AROUND @ weights, share, atol=1e-12)


def knowledge_of(seed: int, camera: CameraModel, strength: float = 1.0) -> tuple[np.ndarray, Any, LimbPose]:
    """A picture of a camera, what is known of it, and where a fit starts; ``strength`` of the air's modes in it."""
    r, cam, rng = view(seed)
    image = picture(cam, r, rng, modes=True, left=True, camera=camera, strength=strength)
    coarse = Rotation.from_rotvec(rng.normal(size=3) * TILT_SIGMA_RAD).as_matrix() @ cam
    mean = LimbPose(coarse, r + rng.normal(0.0, POSITION_SIGMA_M, 3))
    information = np.diag([TILT_SIGMA_RAD**-2] * 3 + [POSITION_SIGMA_M**-2] * 3 + [300.0**-2])
    air = KnownAir(table(modes=True, left=True), EPOCH, None, np.array([1.0, 0.0, 0.0]))
    planet = sphere(RADIUS_M)
    knowledge = ProfileKnowledge(planet, mean, information, air)
    start = start_pose(image, camera, knowledge, TILT_SIGMA_RAD)
    return image, knowledge, start


def chosen_model(seed: int, **drawn: Any) -> tuple[ProfileModel, LimbPose, np.ndarray, np.ndarray]:
    """A model with its air, its pose, own unknowns and drawn unknowns of the air."""
    image, knowledge, start = knowledge_of(seed, CAMERA)
    choose = ProfileChooser([ProfileImage(image, CAMERA, knowledge)])
    model = choose(ShotState(start, (knowledge.own,), np.zeros(0)), np.zeros(LENS), None, 1.0, None).models[0]
    own = np.array([np.log(0.6), 0.4, np.log(900.0), 10.0])
    return model, start, own, 0.3 * np.random.default_rng(5).normal(size=model.air.wave.shape[1])


def test_equations_are_those_of_what_the_pixels_show() -> None:
    """Against differences of the prediction, by every shared unknown and some of the air, half a pixel away."""
    model, start, own, air = chosen_model(3)
    rng, lens = np.random.default_rng(5), np.zeros(LENS)
    start = start.moved(np.array([2e-3, 4e-3, -0.02, 300.0, -200.0, 100.0, 50.0]))
    weights = rng.uniform(0.5, 1.5, len(model.near.values))
    look = model.look(start, lens, own, air)
    equations = model.linear(look, own, weights)
    right, right_air = equations.rights(look, weights)
    some = rng.choice(len(air), 6, replace=False)
    sizes = [1e-6] * 3 + [10.0] * 4 + [1e-6, 1e-3, 1e-3, 1e-3] + [1e-4, 1e-3, 1e-4, 1e-2] + [1e-3] * len(some)

    def residuals(place: int, size: float) -> np.ndarray:
        step, of_air = np.zeros(POSE + LENS + OWN), np.zeros(len(air))
        if place < len(step):
            step[place] = size
        else:
            of_air[some[place - len(step)]] = size
        after = model.moved(own, step[POSE + LENS :])
        return model.look(start.moved(step[:POSE]), lens + step[POSE : POSE + LENS], after, air + of_air).residuals

    rows = np.array([(residuals(k, -size) - residuals(k, size)) / (2.0 * size) for k, size in enumerate(sizes)])
    normal = (rows * weights) @ rows.T
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    mixed = equations.mixed[:, some]
    together = np.block([[equations.shared, mixed], [mixed.T, equations.air[np.ix_(some, some)]]])
    np.testing.assert_allclose(together / np.outer(scale, scale), normal / np.outer(scale, scale), atol=1e-3)
    size = scale * np.sqrt(weights @ look.residuals**2)
    wanted = (rows * weights) @ look.residuals / size
    np.testing.assert_allclose(np.concatenate([right, right_air[some]]) / size, wanted, atol=2e-4)


def test_errors_of_a_lens_move_the_limb_as_another_camera_does() -> None:
    """Distances across the limb against those of the pixels' lines of sight with that camera, to a hundredth."""
    camera = replace(CAMERA, distortion=(-0.1, *CAMERA.distortion[1:]))
    image, knowledge, start = knowledge_of(3, camera)
    lens, errors = np.zeros(LENS), np.diag([1e-4, 0.01, 0.01, 0.01])
    model = ProfileModel(image, camera, start, lens, 0.6, knowledge)
    uv = np.column_stack([model.near.columns, model.near.rows])
    axes = knowledge.ellipsoid.axes_m

    def heights(error: np.ndarray) -> np.ndarray:
        changed = miscalibrated(camera, error[0], (error[1], error[2]), error[3])
        return ray_height(unproject(changed, uv).T, start.cam_from_itrs, start.r_itrs, axes).height_m

    for k, error in enumerate(errors):
        by_distance = -model.near.by_pose[POSE - 1]
        moved = (heights(error) - heights(-error)) / 2.0 * by_distance
        found = error[k] * model.near.by_lens[k]
        assert np.abs(found - moved).max() < 0.01 * np.abs(moved).max()


@pytest.mark.parametrize("seed", [0, 2, 6])
def test_no_start_takes_it_long(seed: int) -> None:
    """A limb resolved by pixels of 8 km, blur and sharpness hard to tell apart, from up to 3 px away.

    Steps that were not looked at turned about the best blur, for 28 to 30 steps of one of each three starts.
    """
    camera = replace(CAMERA, fx=300.0, fy=300.0)
    image, knowledge, start = knowledge_of(seed, camera)
    fits = []
    for away_px in (0.0, 3.0, -3.0):
        moved = start.moved(np.array([away_px / camera.fx, away_px / camera.fy, 0.0, 0.0, 0.0, 0.0, 0.0]))
        fits.append(fit_profile(image, camera, moved, knowledge))
    assert max(len(fit.steps) for fit in fits) <= 24
    by = nadir_derivative(fits[0].pose)
    claimed = float(np.sqrt(np.trace(by @ fits[0].covariance @ by.T)))
    for fit in fits[1:]:
        assert float(np.linalg.norm(fit.pose.nadir_cam - fits[0].pose.nadir_cam)) < 0.3 * claimed


def test_a_lens_that_softens_towards_the_corners_is_in_the_claim() -> None:
    """The blur grows by a factor of 2.5 to the corners; the limb goes through the middle and out at the sides.

    The mean of three squares of two degrees of freedom is below 2.6 in 98 of 100 cases.
    """
    squares = []
    for seed in range(3):
        _, knowledge, start = knowledge_of(seed, CAMERA)
        r, cam, rng = view(seed)
        fit = fit_profile(picture(cam, r, rng, modes=True, growth=0.9), CAMERA, start, knowledge)
        true = -cam @ r / np.linalg.norm(r)
        across = np.linalg.svd(true[None])[2][1:]
        by, error = across @ nadir_derivative(fit.pose), across @ (fit.pose.nadir_cam - true)
        squares.append(float(0.5 * error @ np.linalg.solve(by @ fit.covariance @ by.T, error)))
    assert np.mean(squares) < 2.6


def test_a_floor_leaves_the_background_known() -> None:
    """Noise of 20 levels, cut off at 0 where space is: hundreds of dark pixels tell it to a tenth of one's noise."""
    image, knowledge, start = knowledge_of(1, CAMERA)
    noise = np.random.default_rng(3).normal(0.0, 20.0, image.shape)
    fit = fit_profile(np.maximum(np.rint(image - BLACK + noise), 0.0), CAMERA, start, knowledge)
    floor = fit.models[0].floor
    assert floor is not None
    assert floor.sigma == pytest.approx(20.0, rel=0.1)
    assert abs(fit.own[0][BACKGROUND]) < 0.5 * floor.sigma


def seen(seed: int, monkeypatch: pytest.MonkeyPatch) -> tuple[Observation, np.ndarray]:
    """What the estimator is given of one picture, with the table of these tests in place of the shipped one."""
    monkeypatch.setattr(known_profile, "shipped_templates", lambda kind, um: table(modes=True))
    r, cam, rng = view(seed)
    prior = Prior(
        shape="sphere",
        radius_m=RADIUS_M,
        r_itrs=r + rng.normal(0.0, POSITION_SIGMA_M, 3),
        position_sigma_m=POSITION_SIGMA_M,
        q_cam_from_itrs=(
            Rotation.from_rotvec(rng.normal(size=3) * TILT_SIGMA_RAD) * Rotation.from_matrix(cam)
        ).as_quat(),
        attitude_sigma_rad=np.full(3, TILT_SIGMA_RAD),
        epoch_utc=EPOCH,
    )
    image = picture(cam, r, rng, modes=True)
    known = Observation(image, CAMERA, full_scale=4095.0, prior=prior, band_kind="thermal", band_um=(14.0, 16.3))
    return known, -cam @ r / np.linalg.norm(r)


def test_the_estimator_claims_what_the_fit_found(monkeypatch: pytest.MonkeyPatch) -> None:
    observation, nadir = seen(3, monkeypatch)
    fit = limb_profile.ESTIMATOR.run(observation)
    assert isinstance(fit, Fit), fit
    claim = np.sqrt(np.trace(fit.total_covariance_nadir_cam))
    assert np.linalg.norm(fit.nadir_cam - nadir) < 3.0 * claim
    assert claim < 200.0 * ARCSEC
    assert fit.altitude_m is not None
    assert abs(fit.altitude_m - 600e3) < 3e3


@pytest.mark.parametrize("seed", [3, 6])
def test_saturated_pixels_tell_nothing(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the converter cuts off is no light of the air: taken for it, the nadir is off by twice the claim."""
    observation, nadir = seen(seed, monkeypatch)
    full = BLACK + 1500.0
    image = np.minimum(observation.image, full)
    assert 0.1 < np.mean(image == full) < 0.4
    prior = replace(observation.prior, accept_rad=float(np.radians(1.0)))
    fit = limb_profile.ESTIMATOR.run(replace(observation, image=image, full_scale=full, prior=prior))
    assert isinstance(fit, Fit), fit
    assert np.linalg.norm(fit.nadir_cam - nadir) < 1.5 * np.sqrt(np.trace(fit.total_covariance_nadir_cam))


@pytest.mark.parametrize(
    ("missing", "word"),
    [
        ({"r_itrs": None, "position_sigma_m": None}, "position"),
        ({"q_cam_from_itrs": None, "attitude_sigma_rad": None}, "attitude"),
        ({"epoch_utc": None}, "time"),
        ({"climate": "us_standard"}, "climate"),
    ],
)
def test_what_it_cannot_do_without_is_named(missing: dict[str, object], word: str, monkeypatch) -> None:
    observation, _ = seen(3, monkeypatch)
    answer = limb_profile.ESTIMATOR.run(replace(observation, prior=replace(observation.prior, **missing)))
    assert isinstance(answer, Refusal)
    assert answer.status is Outcome.BAD_INPUT
    assert word in answer.reason


def test_bands_and_images_that_it_cannot_use_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    observation, _ = seen(3, monkeypatch)
    noise = np.random.default_rng(1).normal(400.0, 30.0, observation.image.shape)
    nothing = limb_profile.ESTIMATOR.run(replace(observation, image=noise))
    assert isinstance(nothing, Refusal)
    assert nothing.status is Outcome.NO_LIMB
    upside_down = limb_profile.ESTIMATOR.run(replace(observation, image=observation.image.max() - observation.image))
    assert isinstance(upside_down, Refusal)
    monkeypatch.undo()
    strange = limb_profile.ESTIMATOR.run(replace(observation, band_um=(3.0, 5.0)))
    assert isinstance(strange, Refusal)
    assert strange.status is Outcome.BAD_INPUT
    assert "3 to 5 um" in strange.reason


def test_a_priors_table_takes_the_place_of_the_shipped_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer is that of the same profiles as shipped ones, to the last bit; what cannot be read is one line."""
    observation, _ = seen(3, monkeypatch)
    table(modes=True).save(tmp_path / "mine.npz")
    monkeypatch.setattr(known_profile, "shipped_templates", lambda kind, um: load_templates(tmp_path / "mine.npz"))
    expected = limb_profile.ESTIMATOR.run(observation)
    monkeypatch.undo()

    def given(name: str, **changes: object) -> Fit | Refusal:
        prior = replace(observation.prior, climate=str(tmp_path / name))
        return limb_profile.ESTIMATOR.run(replace(observation, prior=prior, **changes))

    fit = given("mine.npz")
    assert isinstance(fit, Fit), fit
    assert isinstance(expected, Fit)
    assert (fit.nadir_cam == expected.nadir_cam).all()
    (tmp_path / "damaged.npz").write_bytes((tmp_path / "mine.npz").read_bytes()[:900])
    for answer, words in (
        (given("none.npz"), ("none.npz", "No such file")),
        (given("damaged.npz"), ("damaged.npz", "damaged")),
        (given("mine.npz", band_um=(8.0, 14.0)), ("mine.npz", "14 to 16.3 um", "8 to 14 um")),
        (given("mine.npz", band_kind="solar"), ("thermal", "solar")),
    ):
        assert isinstance(answer, Refusal)
        assert answer.status is Outcome.BAD_INPUT
        assert "\n" not in answer.reason
        for word in words:
            assert word in answer.reason


def _level_image(**prior: Any) -> Observation:
    """Return an image of one level, but for three bright pixels just inside of where the prior has the limb."""
    r_itrs = np.array([A_M + 500e3, 0.0, 0.0])
    rho = np.arcsin(A_M / r_itrs[0])
    nadir = np.array([-1.0, 0.0, 0.0])
    z = np.cos(rho) * nadir + np.sin(rho) * np.array([0.0, 1.0, 0.0])
    y = nadir - (nadir @ z) * z
    y /= np.linalg.norm(y)
    q_cam_from_itrs = Rotation.from_matrix([np.cross(y, z), y, z]).as_quat()
    image = np.full((64, 64), 64.0)
    image[[33, 35, 38], [20, 29, 38]] = 70.0
    known: dict[str, Any] = {
        "r_itrs": r_itrs,
        "position_sigma_m": 1e3,
        "q_cam_from_itrs": q_cam_from_itrs,
        "attitude_sigma_rad": (3e-3, 3e-3, 3e-3),
        "epoch_utc": EPOCH,
    }
    camera = CameraModel(width=64, height=64, fx=120.0, fy=120.0, cx=31.5, cy=31.5)
    return Observation(image=image, camera=camera, prior=Prior(**known | prior), band_kind="thermal", band_um=(8, 14))


def test_a_fit_that_ran_out_of_steps_far_away_is_not_called_an_image_without_a_limb() -> None:
    """The limb is there: what is wanting is steps."""
    image, knowledge, start = knowledge_of(3, CAMERA)
    with pytest.raises(np.linalg.LinAlgError, match="no convergence in 1 steps"):
        fit_profile(image, CAMERA, start.moved(np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])), knowledge, most_steps=1)


def test_an_image_of_one_level_and_some_outliers_is_refused() -> None:
    """All pixels that are no outliers are equal: there is no variance to explain."""
    found = limb_profile.run(_level_image())
    assert isinstance(found, Refusal)
    assert found.status is Outcome.NO_LIMB


def test_a_time_before_there_was_utc_is_refused() -> None:
    found = limb_profile.run(_level_image(epoch_utc=datetime(1900, 1, 1, tzinfo=UTC)))
    assert isinstance(found, Refusal)
    assert found.status is Outcome.BAD_INPUT
    assert "1900" in found.reason
