"""Profiles across the limb, levels by sector, and modes of the relief, each against plain sums."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from horizonval.earth.limb_heights import Relief
from horizonval.estimation.likelihood.light import PIXEL_VARIANCE, edge_profile, light_basis, weighed
from horizonval.estimation.likelihood.sectors import eliminated, relief_modes, sectors_of, solve_levels


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
    if soft is None or scale > 0.1:
        # below, the profile is held at its smallest scale height, which grows with the blur
        assert edge.by_blur == pytest.approx(by_blur, abs=1e-8)
    if soft is not None and scale > 0.1:
        by_scale = (edge_profile(x, blur, soft + h).level - edge_profile(x, blur, soft - h).level) / (2 * h)
        assert edge.by_scale == pytest.approx(by_scale, abs=1e-8)


def test_sectors_begin_after_the_widest_gap_and_hold_equally_many() -> None:
    rng = np.random.default_rng(2)
    azimuth = np.mod(rng.uniform(2.5, 4.2, 1000) + np.pi, 2 * np.pi) - np.pi
    sectors = sectors_of(azimuth, 24 * 5)
    assert len(sectors.starts) == 6
    assert np.ptp(np.diff(sectors.starts)) <= 1
    assert np.all(np.diff(sectors.azimuth) >= 0.0)
    assert sectors.azimuth[-1] == pytest.approx(1.7, abs=0.02)


def _problem(spread: float) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(4)
    starts = np.linspace(0, 900, 10).astype(np.intp)
    x = rng.uniform(-10.0, 8.0, 900)
    edge = 1.0 / (1.0 + np.exp(-2.0 * x))
    basis = np.array([np.ones(900), edge, edge * x])
    levels = np.array([20.0, 150.0, 0.0]) + spread * rng.normal(size=(9, 3)) * [5.0, 30.0, 1.0]
    values = np.einsum("ij,ij->j", basis, np.repeat(levels, np.diff(starts), axis=0).T) + rng.normal(0.0, 2.0, 900)
    jacobian = rng.normal(size=(4, 900)) * edge * (1.0 - edge)
    return basis, values, np.full(900, 0.25), starts, jacobian, levels


@pytest.mark.parametrize("spread", [0.0, 1.0])
def test_elimination_is_the_whole_system_with_its_priors(spread: float) -> None:
    """Against one dense least-squares problem of shared unknowns, mean levels and every sector's departure."""
    basis, values, weights, starts, jacobian, _ = _problem(spread)
    light = solve_levels(basis, values, weights, starts)
    of_pixel = np.repeat(light.of_sector, np.diff(starts), axis=0).T
    residuals = values - np.einsum("ij,ij->j", basis, of_pixel)
    normal, right = eliminated(jacobian, basis, residuals, weights, starts, light)
    sectors = len(starts) - 1
    whole = np.zeros((4 + 2 + 3 * sectors, 900))
    whole[:4], whole[4:6] = jacobian, basis[:2]
    for i, (first, last) in enumerate(pairwise(starts)):
        whole[6 + 3 * i : 9 + 3 * i, first:last] = basis[:, first:last]
    prior = np.diag(np.concatenate([np.zeros(6), np.tile(light.spread_information, sectors)]))
    dense = (whole * weights) @ whole.T + prior
    solution = np.linalg.solve(dense, whole @ (weights * values))
    assert np.linalg.solve(normal, right) == pytest.approx(solution[:4], rel=1e-5, abs=1e-7)
    assert np.linalg.inv(normal) == pytest.approx(np.linalg.inv(dense)[:4, :4], rel=1e-4, abs=1e-9)


def test_even_light_is_known_as_one_level_and_uneven_light_by_sector() -> None:
    basis, values, weights, starts, _, _ = _problem(0.0)
    even = solve_levels(basis, values, weights, starts).of_sector
    # 900 pixels of 2 levels: 0.1 of the background; a sector alone, a hundred pixels, three times as much
    assert np.ptp(even[:, 0]) < 0.4
    basis, values, weights, starts, _, levels = _problem(1.0)
    uneven = solve_levels(basis, values, weights, starts).of_sector
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
    starts = np.linspace(0, 4000, 11).astype(np.intp)
    x, along = rng.uniform(-10.0, 8.0, 4000), rng.uniform(-0.5, 0.5, 4000)
    edge = edge_profile(x, 0.75, None).level
    lit = np.arange(4000) >= starts[night]
    values = np.rint(lit * edge * np.maximum(rng.normal(120.0, 12.0, 4000), 0.0))
    light = weighed(light_basis(edge, x, along), values, starts)
    # By chance: three standard deviations of a variance of so many pixels.
    assert light.variance[1] == pytest.approx(12.0**2, rel=3.0 * np.sqrt(2.0 / np.sum(lit & (edge > 0.9))))
    assert np.mean(light.weights[lit] == 0.0) < 1e-3
