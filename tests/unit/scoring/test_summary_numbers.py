"""Statistics of a group against numpy and scipy, from none to many values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from synthetic import result_row

from horizonval.scoring.summary import mean_noise_nees, noise_nees, proportion, summarise_group, upper_bound


@pytest.mark.parametrize("n", [1, 2, 3, 30])
def test_magnitudes_and_biases_are_numpys(n: int) -> None:
    rng = np.random.default_rng(n)
    errors, rolls = rng.gamma(2.0, 30.0, n), rng.normal(5.0, 20.0, n)
    rows = [
        result_row(case=f"c{k}", nadir_error_arcsec=e, roll_error_arcsec=r, altitude_error_km=-r, nees_nadir=e / 30)
        for k, (e, r) in enumerate(zip(errors, rolls, strict=True))
    ]
    group = summarise_group([*rows, result_row(case="refused", status="dark")])
    size = group["nadir_error_arcsec"]
    assert (size["n"], size["max"]) == (n, pytest.approx(errors.max()))
    assert size["rms"] == pytest.approx(math.sqrt(np.mean(errors**2)))
    assert size["median"] == pytest.approx(np.median(errors))
    assert size["p95"] == pytest.approx(np.percentile(errors, 95))
    for name, values in (("roll_error_arcsec", rolls), ("altitude_error_km", -rolls)):
        bias = group[name]
        assert (bias["n"], bias["mean"]) == (n, pytest.approx(values.mean()))
        assert bias["std"] == (None if n == 1 else pytest.approx(values.std(ddof=1)))
    nees = group["nees_nadir"]
    low, high = stats.chi2.ppf([0.025, 0.975], 2 * n) / n
    assert (nees["mean"], nees["expected"]) == (pytest.approx(errors.mean() / 30), 2.0)
    assert nees["interval"] == pytest.approx([low, high])
    assert (group["n"], group["n_valid"], group["refusals"]) == (n + 1, n, {"dark": 1})
    assert group["pitch_error_arcsec"] == {"n": 0, "mean": None, "std": None}
    assert group["nees_nadir_total"]["interval"] is None


def test_frames_of_many_draws_weigh_by_their_degrees_of_freedom() -> None:
    """The mean of all normalised errors squared, each frame's own mean taken out."""
    rng = np.random.default_rng(3)
    draws = rng.integers(2, 9, 40)
    values = np.array([2.0 * stats.chi2.rvs(2 * (d - 1), random_state=rng) / (2 * (d - 1)) for d in draws])
    rows = [
        result_row(case=f"c{k}", nees_noise=v, noise_draws=int(d))
        for k, (v, d) in enumerate(zip(values, draws, strict=True))
    ]
    told = summarise_group(rows)["nees_noise"]
    free = int((draws - 1).sum())
    assert (told["n"], told["draws"]) == (40, int(draws.sum()))
    mean = np.average(values, weights=draws - 1)
    assert told["mean"] == pytest.approx(mean)
    assert told["interval"] == pytest.approx(stats.chi2.ppf([0.025, 0.975], 2 * free) / free)
    boots = []
    for _ in range(4000):
        chosen = rng.integers(0, 40, 40)
        boots.append(np.average(values[chosen], weights=draws[chosen] - 1))
    assert told["standard_error"] == pytest.approx(np.std(boots), rel=0.15)
    single = summarise_group(rows[:1])["nees_noise"]
    assert (single["n"], single["standard_error"]) == (1, None)
    assert summarise_group(rows[:2])["nees_noise"]["standard_error"] is not None
    none = summarise_group([result_row(), result_row(nees_noise=1.0), result_row(noise_draws=3)])["nees_noise"]
    assert (none["n"], none["draws"], none["mean"], none["interval"]) == (0, 0, None, None)


@pytest.mark.parametrize(("k", "n"), [(0, 1), (1, 1), (3, 10), (0, 300), (10, 10)])
def test_bounds_hold_the_chance_they_state(k: int, n: int) -> None:
    """At the bounds of Clopper and Pearson what was seen, or more of it, has just the chance left outside."""
    low, high = proportion(k, n)["interval"]
    if k > 0:
        assert stats.binom.sf(k - 1, n, low) == pytest.approx(0.025, rel=1e-6)
    if k < n:
        assert stats.binom.cdf(k, n, high) == pytest.approx(0.025, rel=1e-6)
        assert stats.binom.cdf(k, n, upper_bound(k, n)) == pytest.approx(0.05, rel=1e-6)
    assert proportion(k, n)["rate"] == k / n
    assert proportion(0, 0) == {"n": 0, "of": 0, "rate": None, "interval": None}
    assert upper_bound(0, 0) is None


def test_two_draws_are_enough_for_a_mean() -> None:
    from horizonval.estimation.observation import Fit

    nadirs = [np.array([1e-4, 0.0, 1.0]), np.array([-1e-4, 0.0, 1.0])]
    covariance = np.diag([1e-8, 4e-8, 0.0])
    fits = [Fit(nadir / np.linalg.norm(nadir), covariance, 0.0, 0.0) for nadir in nadirs]
    # Each is one sigma off the mean of both, which has half of the scatter in it.
    assert noise_nees(fits) == pytest.approx([2.0, 2.0])
    assert mean_noise_nees(fits) == pytest.approx(2.0)
    skew = covariance + np.array([[0, 2e-8, 0], [-2e-8, 0, 0], [0, 0, 0]])
    lopsided = [Fit(fit.nadir_cam, skew, 0.0, 0.0) for fit in fits]
    assert mean_noise_nees(lopsided) is not None
