"""Local polynomials keep polynomials, ends included; the clamped mean does not; the rule finds a good width."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_coeffs

from horizonval.systems.e.localisation.smoothing import (
    Kernel,
    choose_kernel,
    scatter,
    smooth,
    smooth_clamped,
    smooth_extended,
    smoother_matrix,
)

TIMES = np.arange(0.0, 120.25, 0.5)
T0, REACH_S = 70.0, 110.0


def _flight() -> np.ndarray:
    tau = (TIMES - T0) / REACH_S
    line = np.array([0.3, 0.8, 0.6]) + tau[:, None] * np.array([-0.9, 0.35, 0.0])
    return line / np.linalg.norm(line, axis=1, keepdims=True)


def _noisy(sigma: float, seed: int) -> np.ndarray:
    u = _flight() + np.random.default_rng(np.random.SeedSequence(seed)).normal(0.0, sigma, (len(TIMES), 3))
    return u / np.linalg.norm(u, axis=1, keepdims=True)


@pytest.mark.parametrize("degree", [1, 3, 5])
@pytest.mark.parametrize("width_s", [1.0, 10.0, 30.0])
def test_polynomials_pass_unchanged_ends_included(degree: int, width_s: float) -> None:
    """1e-9 of the series' size: the normal equations are solved without squaring their condition."""
    series = np.polynomial.polynomial.polyval(TIMES / 60.0 - 1.0, np.arange(1.0, degree + 2.0))
    smoothed = smoother_matrix(TIMES, Kernel(degree, width_s)) @ series
    assert np.abs(smoothed - series).max() < 1e-9 * np.abs(series).max()
    beyond = (TIMES / 60.0 - 1.0) ** (degree + 1)
    # a test that could not fail: one degree more is not kept
    assert np.abs(smoother_matrix(TIMES, Kernel(degree, 30.0)) @ beyond - beyond).max() > 1e-3


def test_equal_weights_are_savitzky_and_golays() -> None:
    """With a kernel much wider than the series every weight is 1: scipy's coefficients, to the weights' 1e-6."""
    times = np.arange(11.0)
    row = smoother_matrix(times, Kernel(3, 4000.0))[5]
    assert row == pytest.approx(savgol_coeffs(11, 3, use="dot"), abs=1e-5)


def test_clamped_mean_is_drawn_inwards_at_the_ends() -> None:
    """Half of the neighbours are replaced by the end itself: the mean lags by h / sqrt(2 pi) times the rate.

    The formula is that of a constant rate and endless sampling; this flight departs from it by 2 %, 4 % are allowed.
    """
    u, width = _flight(), 5.0
    bias = np.linalg.norm(smooth_clamped(TIMES, u, width) - u, axis=1)
    rate = np.linalg.norm(np.gradient(u, TIMES, axis=0), axis=1)
    assert bias[0] == pytest.approx(rate[0] * width / np.sqrt(2.0 * np.pi), rel=0.04)
    local = np.linalg.norm(smooth(TIMES, u, Kernel(3, width)) - u, axis=1)
    assert local[[0, -1]].max() < 1e-3 * bias[[0, -1]].min()


def test_carried_on_in_a_straight_line_the_ends_keep_their_place() -> None:
    """What is left is the curvature of the path over a second, 1e-5 here; clamped ends miss by 1e-2."""
    u = _flight()
    carried, clamped = (np.linalg.norm(f(TIMES, u, 1.0) - u, axis=1) for f in (smooth_extended, smooth_clamped))
    assert carried.max() < 1e-4
    assert clamped[[0, -1]].min() > 20.0 * carried.max()


def test_scatter_is_the_noise() -> None:
    """241 measurements with two axes: 3.3 % standard deviation; 10 % is three of them."""
    assert scatter(TIMES, _noisy(1e-3, 3)) == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("sigma", [1e-5, 1e-3])
def test_the_rule_is_within_a_tenth_of_the_best_error(sigma: float) -> None:
    """1.2 of the least mean square error (1.1 of the error) among all candidates, 20 draws; the rule sees no truth."""
    best: dict[Kernel, list[float]] = {}
    chosen = []
    exact = _flight()
    for seed in range(20):
        u = _noisy(sigma, seed)
        choice = choose_kernel(TIMES, u)
        chosen.append(np.mean((smooth(TIMES, u, choice.kernel) - exact) ** 2))
        for degree in (1, 3, 5):
            for width in np.geomspace(1.0, 30.0, 16):
                kernel = Kernel(degree, float(width))
                best.setdefault(kernel, []).append(np.mean((smooth(TIMES, u, kernel) - exact) ** 2))
    assert np.mean(chosen) < 1.2 * min(np.mean(v) for v in best.values())


def test_expected_errors_are_those_found() -> None:
    """The rule's own noise figure against the scatter of 60 smoothed series.

    A wide kernel leaves few independent values in each: other sets of 60 depart by -5, 4 and 2 %; 10 % are allowed.
    """
    kernel = choose_kernel(TIMES, _noisy(1e-3, 0))
    exact = _flight()
    errors = [smooth(TIMES, _noisy(1e-3, 100 + k), kernel.kernel) - exact for k in range(60)]
    found = np.sqrt(np.mean(np.sum(np.array(errors) ** 2, axis=-1)) / 2.0)
    assert found == pytest.approx(np.hypot(kernel.noise_rad, kernel.bias_rad), rel=0.1)
