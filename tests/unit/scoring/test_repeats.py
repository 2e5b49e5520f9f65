"""Noise alone: fits of one frame that differ in the draw of the noise."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.observation import Fit
from horizonval.scoring.summary import mean_noise_nees, noise_nees

SIGMA = np.array([2e-4, 5e-5])


def draws(count: int, claimed: float = 1.0, bias: float = 0.0) -> list[Fit]:
    rng = np.random.default_rng(5)
    fits = []
    for _ in range(count):
        off = rng.normal(0.0, SIGMA) + bias
        nadir = np.array([off[0], off[1], 1.0])
        covariance = np.diag([*(claimed * SIGMA) ** 2, 0.0])
        fits.append(Fit(nadir / np.linalg.norm(nadir), covariance, 0.0, 0.0))
    return fits


def test_an_honest_covariance_gives_two_whatever_all_draws_are_off_by() -> None:
    """Two degrees of freedom each: the mean of 400 is 2 with a standard error of 0.1."""
    assert noise_nees(draws(400)).mean() == pytest.approx(2.0, abs=0.4)
    assert noise_nees(draws(400, bias=3e-3)).mean() == pytest.approx(2.0, abs=0.4)


def test_a_claim_of_half_the_scatter_gives_eight() -> None:
    assert noise_nees(draws(400, claimed=0.5)).mean() == pytest.approx(8.0, abs=1.6)


def test_two_draws_are_the_fewest() -> None:
    assert np.mean([noise_nees(draws(2 * k)[-2:]).mean() for k in range(1, 100)]) == pytest.approx(2.0, abs=0.7)
    with pytest.raises(ValueError, match="at least 2"):
        noise_nees(draws(1))


def test_a_claim_that_cannot_be_tested_has_no_mean() -> None:
    assert mean_noise_nees(draws(5)) == pytest.approx(noise_nees(draws(5)).mean())
    assert mean_noise_nees(draws(1)) is None
    assert mean_noise_nees(draws(5, claimed=0.0)) is None
    assert mean_noise_nees(draws(5, claimed=np.nan)) is None
    assert mean_noise_nees(draws(5, bias=np.nan)) is None
