"""The position of a soft limb, its derivatives by the pixels, and its covariance by their noise."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from horizonval.estimation.limb.cone import inwards_of
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.limb.locate import (
    PixelNoise,
    _edges_at,
    noise_covariance,
    pixel_noise,
)
from horizonval.estimation.limb.picture import LimbPoints
from horizonval.estimation.limb.pyramid import cone_frame, on_cone, trace_limb
from horizonval.geometry.camera import CameraModel, pixel_grid, project, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

CAMERA = CameraModel(width=256, height=256, fx=222.0, fy=222.0, cx=127.5, cy=127.5)
RHO = math.radians(68.0)
SCALE_PX = 2.0
"""Scale height of the air in pixels: 8 km seen from 500 km are 0.7, from nearer or with a longer lens more."""


def air(nadir: np.ndarray, full: float = 1e9) -> np.ndarray:
    """Light of an exponential layer, 1 - exp(-exp(-x)), x the height over the scale: steepest where x = 0.

    The derivative is tau exp(-tau) with tau = exp(-x), which is largest at tau = 1 (Chapman's layer, 1931).
    """
    x = (off_axis_angle(unproject(CAMERA, pixel_grid(CAMERA)), nadir) - RHO) * CAMERA.fx / SCALE_PX
    return np.minimum(50.0 + 800.0 * -np.expm1(-np.exp(np.clip(-x, -50, 50))), full)


def to_edge(image: np.ndarray, camera: CameraModel, los: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return lines of sight (n, 3) moved across the limb to the fitted edges."""
    edges = _edges_at(image, camera, los, axis)
    assert edges.good.all()
    angle = edges.shift[:, None] / camera.fx
    return np.cos(angle) * los + np.sin(angle) * inwards_of(los, axis)


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_layer_of_air_is_found_at_one_height_all_along(turn_deg):
    off, turn = math.radians(66.0), math.radians(turn_deg)
    nadir = np.array([math.sin(off) * math.sin(turn), math.sin(off) * math.cos(turn), math.cos(off)])
    image = air(nadir)
    found = find_limb(image, CAMERA)
    assert isinstance(found, LimbPoints)
    place_px = (off_axis_angle(found.los_cam, nadir) - RHO) * CAMERA.fx
    # Half of the step lies above the steepest place, by a third of the scale height, the same everywhere.
    assert place_px.mean() == pytest.approx(0.35 * SCALE_PX, abs=0.1 * SCALE_PX)
    assert np.std(place_px) < 0.04


def test_clipped_ground_moves_the_limb_by_a_fifth_of_the_scale_height():
    """Full scale at nine tenths of the ground's level: half of the step is a twentieth of it lower."""
    nadir = np.array([0.0, math.sin(1.15), math.cos(1.15)])
    los = find_limb(air(nadir), CAMERA).los_cam
    plain = to_edge(air(nadir), CAMERA, los, nadir)
    clipped = to_edge(air(nadir, full=50.0 + 0.9 * 800.0), CAMERA, los, nadir)
    moved_px = (off_axis_angle(clipped, nadir).mean() - off_axis_angle(plain, nadir).mean()) * CAMERA.fx
    assert abs(moved_px) < 0.22 * SCALE_PX


TINY = CameraModel(width=90, height=70, fx=80.0, fy=80.0, cx=44.0, cy=36.0)
SMALL_RHO = math.radians(66.0)
AXIS = np.array([math.sin(1.1) * math.sin(0.3), math.sin(1.1) * math.cos(0.3), math.cos(1.1)])


def picture(bright_inside: bool) -> np.ndarray:
    depth = (SMALL_RHO - off_axis_angle(unproject(TINY, pixel_grid(TINY)), AXIS)) * TINY.fx
    return 30.0 + 500.0 * ndtr((depth if bright_inside else -depth) / 1.3)


@pytest.mark.parametrize("sigma", [2.0, 6.0])
def test_even_noise_has_one_variance_inside_and_out(sigma: float) -> None:
    big = CameraModel(width=180, height=140, fx=160.0, fy=160.0, cx=88.0, cy=72.0)
    depth = (SMALL_RHO - off_axis_angle(unproject(big, pixel_grid(big)), AXIS)) * big.fx
    image = 30.0 + 500.0 * ndtr(depth / 1.3) + np.random.default_rng(1).normal(0.0, sigma, (140, 180))
    found = pixel_noise(image, big, AXIS, SMALL_RHO).variance(image)
    assert np.median(found[depth > 5]) == pytest.approx(sigma**2, rel=0.15)
    assert np.median(found[depth < -5]) == pytest.approx(sigma**2, rel=0.15)
    assert found.min() > 0.0


SIZE = 128
SMALL = CameraModel(width=SIZE, height=SIZE, fx=111.0, fy=111.0, cx=63.5, cy=63.5)
DARK, BRIGHT, FULL = 32.0, 600.0, 1023.0
READ_DN, GAIN = 1.5, 0.07
"""Standard deviation in the dark [DN]; variance by DN of signal: a full well of 13 500 electrons over ten bits."""
TRUE_NOISE = PixelNoise(READ_DN**2, GAIN, DARK)


def along_limb() -> np.ndarray:
    """Directions along the limb whose profiles are in view."""
    los = on_cone(cone_frame(AXIS), SMALL_RHO, trace_limb(SMALL, AXIS, SMALL_RHO, 1.0).azimuth)
    uv, _ = project(SMALL, los)
    return los[((uv >= 8) & (uv <= SIZE - 1 - 8)).all(axis=1)]


def noise_free(bright_inside: bool = True) -> np.ndarray:
    depth = (SMALL_RHO - off_axis_angle(unproject(SMALL, pixel_grid(SMALL)), AXIS)) * SMALL.fx
    return DARK + (BRIGHT - DARK) * ndtr((depth if bright_inside else -depth) / 1.2)


def true_variance(image: np.ndarray) -> np.ndarray:
    return READ_DN**2 + GAIN * (image - DARK)


def drawn(image: np.ndarray, seed: int) -> np.ndarray:
    return image + np.random.default_rng(seed).normal(0.0, np.sqrt(true_variance(image)))


def test_the_noise_of_counted_electrons_is_read_off_beside_the_limb():
    """2 500 and 1 600 pixels: medians of squares are good to some 5 %; Immerkaer's own responses are correlated."""
    image = noise_free()
    found = pixel_noise(drawn(image, 1), SMALL, AXIS, SMALL_RHO, FULL).variance(image)
    ratio = found / true_variance(image)
    assert np.median(ratio[image < DARK + 1.0]) == pytest.approx(1.0, abs=0.15)
    assert np.median(ratio[image > BRIGHT - 1.0]) == pytest.approx(1.0, abs=0.15)
    half = np.abs(image - 0.5 * (DARK + BRIGHT)) < 100.0
    assert np.median(ratio[half]) == pytest.approx(1.0, abs=0.2)


def test_a_black_that_is_cut_off_hides_no_noise():
    """Half of the dark pixels at the lowest level show less noise than they have: the bright side's holds for all."""
    image = drawn(noise_free() - DARK, 2)
    cut = np.maximum(np.random.default_rng(3).normal(noise_free() - DARK, 5.0), 0.0)
    assert np.median(pixel_noise(cut, SMALL, AXIS, SMALL_RHO).variance(cut)) == pytest.approx(25.0, rel=0.1)
    assert pixel_noise(image, SMALL, AXIS, SMALL_RHO).variance(image).min() < 5.0


def test_saturated_ground_has_no_noise_to_read():
    image = drawn(noise_free(), 4)
    image[:, : SIZE // 2] = np.where(image[:, : SIZE // 2] > 500.0, FULL, image[:, : SIZE // 2])
    with_limit = pixel_noise(image, SMALL, AXIS, SMALL_RHO, FULL).variance(noise_free())
    bright = noise_free()[:, SIZE // 2 :] > BRIGHT - 1.0
    assert np.median(with_limit[:, SIZE // 2 :][bright]) == pytest.approx(READ_DN**2 + GAIN * (BRIGHT - DARK), rel=0.2)


@pytest.mark.parametrize("bright_inside", [True, False])
def test_it_is_the_covariance_of_draws(bright_inside):
    """60 draws: the sample covariance of three unknowns is good to a fifth, its ratios' extremes to a factor of 1.7."""
    image = noise_free(bright_inside)
    start = along_limb()
    start = to_edge(image, SMALL, start, AXIS)
    claimed = noise_covariance(image, SMALL, start, AXIS, TRUE_NOISE)
    basis = tangent_basis(AXIS)
    cones = []
    for seed in range(60):
        los = to_edge(drawn(image, 100 + seed), SMALL, start, AXIS)
        cone = fit_cone(los)
        cones.append([*(cone.axis_cam @ basis), cone.rho_rad])
    ratios = np.linalg.eigvals(np.linalg.solve(claimed, np.cov(np.array(cones).T))).real
    assert ratios.min() > 1 / 1.7
    assert ratios.max() < 1.7


def test_twice_the_variance_is_twice_the_covariance():
    image = noise_free()
    los = to_edge(image, SMALL, along_limb(), AXIS)
    one, two = (
        noise_covariance(image, SMALL, los, AXIS, PixelNoise(k * READ_DN**2, k * GAIN, DARK)) for k in (1.0, 2.0)
    )
    assert two == pytest.approx(2.0 * one, rel=1e-12)
    assert np.linalg.eigvalsh(one)[0] > 0.0


def test_points_that_determine_no_cone_raise():
    image = noise_free()
    los = np.repeat(along_limb()[:1], 5, axis=0)
    with pytest.raises(np.linalg.LinAlgError):
        noise_covariance(image, SMALL, los, AXIS, TRUE_NOISE)
