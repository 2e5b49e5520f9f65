"""Trusted points of a limb, and the scatter of a cone through them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from horizonval.estimation.limb.cone import SLOW_PATTERNS, cone_scatter, cone_uncertainty, noise_bias, slow_error
from horizonval.geometry.horizon import fit_cone

RHO = 1.1
TILT = 1.0
AXIS = np.array([0.0, math.sin(TILT), math.cos(TILT)])
"""Nadir below the image's middle: the limb crosses the image some 20 px above it."""


def test_slow_errors_are_a_few_independent_patterns() -> None:
    """As many independent errors as there are patterns, each of so many pixels, whatever the number of points."""
    azimuth = np.linspace(0.0, 2 * np.pi, 240, endpoint=False)
    los = np.column_stack(
        [math.sin(RHO) * np.cos(azimuth), math.sin(RHO) * np.sin(azimuth), np.full(240, math.cos(RHO))]
    )
    axis, px = np.array([0.0, 0.0, 1.0]), 2e-3
    covariance = slow_error(los, axis, px, 0.3)
    # On a full circle the axis has twice the variance of a mean, the half-angle that of a mean.
    mean = (0.3 * px) ** 2 / SLOW_PATTERNS
    assert covariance == pytest.approx(np.diag([2 * mean, 2 * mean, mean]), abs=1e-6 * mean)
    assert slow_error(los[::2], axis, px, 0.3) == pytest.approx(covariance, abs=1e-6 * mean)
    assert slow_error(los, axis, 2 * px, 0.3) == pytest.approx(4 * covariance)


SIGMA = 2e-4
DRAWS = 400
Array = NDArray[np.float64]


def arc(n: int, width_rad: float) -> Array:
    """Azimuths of an arc."""
    return np.linspace(-width_rad / 2, width_rad / 2, n)


def noisy_limb(azimuth: Array, noise: Array) -> Array:
    """Lines of sight at the angle RHO from the axis (0, 0, 1), off by noise across the limb."""
    angle = RHO + noise
    return np.column_stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)])


def correlated(rng: np.random.Generator, n: int, memory: float) -> Array:
    """Stationary noise of unit variance whose autocorrelation at lag k is ``memory**k``."""
    white = rng.normal(size=n)
    white[0] /= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white))


def scatter_and_claim(n: int, width_rad: float, memory: float) -> tuple[Array, Array, Array]:
    """Covariance of drawn fits, the mean claim, both of (across x, across y, half-angle), and the lengths claimed."""
    rng = np.random.default_rng(17)
    azimuth = arc(n, width_rad)
    off, claims, lengths = [], [], []
    for _ in range(DRAWS):
        los = noisy_limb(azimuth, SIGMA * correlated(rng, n, memory))[rng.permutation(n)]
        cone = fit_cone(los)
        claim = cone_scatter(los, cone.axis_cam, cone.rho_rad)
        # The claim's own tangent directions are brought to x and y, which differ from them by a turn.
        turn = np.eye(3)
        turn[:2, :2] = claim.basis[:2]
        off.append([*cone.axis_cam[:2], cone.rho_rad - RHO])
        claims.append(turn @ claim.covariance @ turn.T)
        lengths.append(claim.correlation_length)
    return np.cov(np.array(off).T), np.mean(claims, axis=0), np.array(lengths)


@pytest.mark.parametrize(("n", "width_rad"), [(7, 6.0), (60, 2.0), (300, 1.2)])
def test_independent_noise_is_claimed_as_it_scatters(n: int, width_rad: float) -> None:
    """Also with four degrees of freedom; a variance of 400 draws has a standard error of 7 %."""
    scatter, claim, lengths = scatter_and_claim(n, width_rad, 0.0)
    assert np.diag(claim) == pytest.approx(np.diag(scatter), rel=0.25)
    # The length is measured, and cut off below at 1; a significant first lag is there by chance in 2.5 % of draws.
    assert 1.0 <= lengths.mean() < 1.2


def test_the_claim_of_independent_noise_is_least_squares() -> None:
    """The inverse of the information about (axis, half-angle), by finite differences of the limb itself."""
    azimuth = arc(7, 6.0)
    noise = SIGMA * np.array([1.0, -2.0, 0.5, 1.0, -1.0, 2.0, -1.5])
    los = noisy_limb(azimuth, noise)
    axis = np.array([0.0, 0.0, 1.0])
    claim = cone_scatter(los, axis, RHO)
    step = 1e-6
    columns = []
    for direction in claim.basis.T:
        turned = (axis + step * direction) / np.linalg.norm(axis + step * direction)
        columns.append((np.arccos(los @ turned) - np.arccos(los @ axis)) / step)
    jacobian = np.column_stack([*columns, -np.ones(7)])
    expected = (noise @ noise) / 4.0 * np.linalg.inv(jacobian.T @ jacobian)
    assert claim.covariance == pytest.approx(expected, rel=1e-3, abs=1e-4 * expected.max())
    assert claim.sigma_axis_rad == pytest.approx(np.sqrt(np.linalg.eigvalsh(expected[:2, :2]).max()), rel=1e-3)
    assert claim.sigma_rho_rad == pytest.approx(np.sqrt(expected[2, 2]), rel=1e-3)
    assert claim.covariance_axis @ axis == pytest.approx(np.zeros(3), abs=1e-20)


def test_correlated_noise_is_claimed_as_it_scatters() -> None:
    """Noise with a memory of eight points: as much is known as from a ninth or so of them."""
    memory = 0.8
    length = (1 + memory) / (1 - memory)  # 1 + 2 sum of memory^k
    scatter, claim, lengths = scatter_and_claim(400, 1.2, memory)
    # Measured autocorrelations are cut off where they become insignificant, and their mean is that of the residuals,
    # from which the fit has taken the slowest part: some 20 % short of the whole length.
    assert lengths.mean() == pytest.approx(length, rel=0.35)
    ratio = np.diag(claim) / np.diag(scatter)
    assert (ratio > 0.55).all()
    assert (ratio < 1.45).all()


def test_noise_pulls_a_short_arc_as_predicted() -> None:
    """Mean of many fits to independent noise, 20 times as large as above, against :func:`noise_bias`."""
    rng = np.random.default_rng(4)
    azimuth, sigma = arc(200, 0.7), 4e-3
    axis = np.array([0.0, 0.0, 1.0])
    off = []
    for _ in range(2000):
        cone = fit_cone(noisy_limb(azimuth, sigma * rng.normal(size=200)))
        off.append([*cone.axis_cam[:2], cone.rho_rad - RHO])
    exact = noisy_limb(azimuth, np.zeros(200))
    bias = noise_bias(exact, axis, RHO, sigma)
    basis = cone_scatter(exact, axis, RHO).basis
    predicted = np.array([*(basis @ bias[:2])[:2], bias[2]])
    error = np.std(off, axis=0) / np.sqrt(2000)
    assert (np.abs(np.mean(off, axis=0) - predicted) < 4 * error + 0.03 * np.abs(predicted)).all()
    assert (np.abs(predicted[[0, 2]]) > 10 * error[[0, 2]]).all(), "there is something to predict"


def test_the_bias_widens_the_claim_by_its_square() -> None:
    rng = np.random.default_rng(6)
    azimuth = arc(300, 0.5)
    los = noisy_limb(azimuth, 4e-3 * rng.normal(size=300))
    cone = fit_cone(los)
    whole = cone_uncertainty(los, cone.axis_cam, cone.rho_rad)
    noise = cone_scatter(los, cone.axis_cam, cone.rho_rad)
    more = whole.covariance - noise.covariance
    values = np.linalg.eigvalsh(more)
    assert values[-1] > 0
    assert np.abs(values[:-1]).max() < 1e-9 * values[-1], "an outer product"
    sigma = np.arccos(los @ cone.axis_cam).std()
    assert np.trace(more) == pytest.approx(
        (noise_bias(los, cone.axis_cam, cone.rho_rad, float(sigma)) ** 2).sum(), rel=1e-6
    )
