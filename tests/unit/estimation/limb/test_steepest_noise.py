"""Noise carried through the search for the steepest place, against repeated draws of a formula's picture."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import ndtr

from horizonval.estimation.limb.cone import limb_directions
from horizonval.estimation.limb.steepest import NEEDED_PX, noise_covariance, pixel_variance, to_steepest
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

SIZE = 128
CAMERA = CameraModel(width=SIZE, height=SIZE, fx=111.0, fy=111.0, cx=63.5, cy=63.5)
RHO = math.radians(66.0)
NADIR = np.array([math.sin(1.1) * math.sin(0.3), math.sin(1.1) * math.cos(0.3), math.cos(1.1)])
DARK, BRIGHT, FULL = 32.0, 600.0, 1023.0
READ_DN, GAIN = 1.5, 0.07
"""Standard deviation in the dark [DN]; variance by DN of signal: a full well of 13 500 electrons over ten bits."""


def picture(bright_inside: bool = True) -> np.ndarray:
    depth = (RHO - off_axis_angle(unproject(CAMERA, pixel_grid(CAMERA)), NADIR)) * CAMERA.fx
    return DARK + (BRIGHT - DARK) * ndtr((depth if bright_inside else -depth) / 1.2)


def true_variance(image: np.ndarray) -> np.ndarray:
    return READ_DN**2 + GAIN * (image - DARK)


def drawn(image: np.ndarray, seed: int) -> np.ndarray:
    return image + np.random.default_rng(seed).normal(0.0, np.sqrt(true_variance(image)))


def test_the_noise_of_counted_electrons_is_read_off_beside_the_limb():
    """2 500 and 1 600 pixels: medians of squares are good to some 5 %; Immerkaer's own responses are correlated."""
    image = picture()
    found = pixel_variance(drawn(image, 1), CAMERA, NADIR, RHO, FULL)
    ratio = found / true_variance(image)
    assert np.median(ratio[image < DARK + 1.0]) == pytest.approx(1.0, abs=0.15)
    assert np.median(ratio[image > BRIGHT - 1.0]) == pytest.approx(1.0, abs=0.15)
    half = np.abs(image - 0.5 * (DARK + BRIGHT)) < 100.0
    assert np.median(ratio[half]) == pytest.approx(1.0, abs=0.2)


def test_a_black_that_is_cut_off_hides_no_noise():
    """Half of the dark pixels at the lowest level show less noise than they have: the bright side's holds for all."""
    image = drawn(picture() - DARK, 2)
    cut = np.maximum(np.random.default_rng(3).normal(picture() - DARK, 5.0), 0.0)
    assert np.median(pixel_variance(cut, CAMERA, NADIR, RHO)) == pytest.approx(25.0, rel=0.1)
    assert pixel_variance(image, CAMERA, NADIR, RHO).min() < 5.0


def test_saturated_ground_has_no_noise_to_read():
    image = drawn(picture(), 4)
    image[:, : SIZE // 2] = np.where(image[:, : SIZE // 2] > 500.0, FULL, image[:, : SIZE // 2])
    with_limit = pixel_variance(image, CAMERA, NADIR, RHO, FULL)
    bright = picture()[:, SIZE // 2 :] > BRIGHT - 1.0
    assert np.median(with_limit[:, SIZE // 2 :][bright]) == pytest.approx(READ_DN**2 + GAIN * (BRIGHT - DARK), rel=0.2)


@pytest.mark.parametrize("bright_inside", [True, False])
def test_it_is_the_covariance_of_draws(bright_inside):
    """60 draws: the sample covariance of three unknowns is good to a fifth, its ratios' extremes to a factor of 1.7."""
    image = picture(bright_inside)
    start = limb_directions(CAMERA, NADIR, RHO, NEEDED_PX)
    start, _ = to_steepest(image, CAMERA, start, NADIR, bright_inside)
    variance = true_variance(image)
    claimed = noise_covariance(image, CAMERA, start, NADIR, RHO, variance, bright_inside)
    basis = tangent_basis(NADIR)
    cones = []
    for seed in range(60):
        los, kept = to_steepest(drawn(image, 100 + seed), CAMERA, start, NADIR, bright_inside)
        assert len(kept) == len(start)
        cone = fit_cone(los)
        cones.append([*(cone.axis_cam @ basis), cone.rho_rad])
    ratios = np.linalg.eigvals(np.linalg.solve(claimed, np.cov(np.array(cones).T))).real
    assert ratios.min() > 1 / 1.7
    assert ratios.max() < 1.7


def test_points_that_determine_no_cone_raise():
    image = picture()
    los = np.repeat(limb_directions(CAMERA, NADIR, RHO, NEEDED_PX)[:1], 5, axis=0)
    with pytest.raises(np.linalg.LinAlgError):
        noise_covariance(image, CAMERA, los, NADIR, RHO, true_variance(image), True)
