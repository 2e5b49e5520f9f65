"""Measures against numpy on copies of the frames, exclusion angles against scoring, shares against exact intervals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from horizonval.scoring.expected import exclusion_angle_deg
from horizonval.studies.trade.sample import (
    bias_and_noise,
    cluster_draws,
    effective_size,
    exclusion_angle,
    measures_of,
    proportion,
    quantile,
    rms,
)

RANDOM = np.random.default_rng(2)
N = 40
VALUES, OTHERS = RANDOM.gamma(2.0, size=N), RANDOM.normal(size=N)
WEIGHTS = np.vstack([np.ones(N), RANDOM.integers(0, 4, size=(6, N))]).astype(float)


@pytest.mark.parametrize("line", range(len(WEIGHTS)))
def test_weights_are_copies(line):
    copies = WEIGHTS[line].astype(int)
    x, y = np.repeat(VALUES, copies), np.repeat(OTHERS, copies)
    assert rms(VALUES, WEIGHTS)[line] == pytest.approx(math.sqrt(np.mean(x**2)), rel=1e-12)
    for q in (0.0, 0.5, 0.95, 0.997, 1.0):
        assert quantile(VALUES, WEIGHTS, q)[line] == pytest.approx(np.quantile(x, q), rel=1e-12)
    bias, noise = bias_and_noise(VALUES, OTHERS, WEIGHTS)
    assert bias[line] == pytest.approx(math.hypot(x.mean(), y.mean()), rel=1e-9)
    assert noise[line] == pytest.approx(math.sqrt(x.var(ddof=1) + y.var(ddof=1)), rel=1e-9)


@pytest.mark.parametrize("line", range(len(WEIGHTS)))
def test_the_exclusion_angle_is_that_of_scoring(line):
    angle, right = RANDOM.uniform(0, 90, N), RANDOM.random(N) < 0.7
    there = WEIGHTS[line] > 0
    expected = exclusion_angle_deg(angle[there].tolist(), right[there].tolist())
    found = exclusion_angle(angle, right, WEIGHTS)[line]
    assert found == expected or (expected is None and math.isnan(found))


def test_bias_and_noise_make_the_rms(make_sample):
    sample = make_sample(VALUES / 100)
    found = measures_of(sample, cluster_draws(N, "s", 0), 0.05)
    n = N
    whole = found["bias_deg"]["value"] ** 2 + found["noise_deg"]["value"] ** 2 * (n - 1) / n
    assert found["rms_deg"]["value"] ** 2 == pytest.approx(whole, rel=1e-9)


def test_refusals_have_no_error_but_count_as_misses(make_sample):
    found = measures_of(make_sample([0.01, 0.02, np.nan, 0.9, 0.03, 0.04]), cluster_draws(6, "s", 0), 0.05)
    assert (found["n"], found["claims"], found["rms_deg"]["n"]) == (6, 5, 5)
    assert (found["availability"]["n"], found["within"]["n"], found["within"]["of"]) == (5, 4, 6)
    assert (found["false_valid"]["n"], found["false_valid"]["of"]) == (1, 5)


def test_the_interval_of_the_mean_square_holds_the_truth():
    # The bootstrap of 40 frames against the known root mean square of what they are drawn from.
    random = np.random.default_rng(11)
    draws = cluster_draws(40, "s", 0, draws=400)
    hits = 0
    for _ in range(200):
        low, high = np.percentile(rms(random.normal(size=40), draws)[1:], [2.5, 97.5])
        hits += low <= 1.0 <= high
    # Percentiles of a bootstrap of 40 hold some 92 % in place of 95 %; 170 is four standard deviations below.
    assert hits >= 170


def test_three_sigma_is_open_at_the_top_until_there_are_enough(make_sample):
    few, enough = (
        measures_of(make_sample(np.linspace(0.001, 0.4, n)), cluster_draws(n, "s", 0, draws=20), 0.05)
        for n in (1227, 1228)
    )
    assert few["three_sigma_deg"]["interval"][1] is None
    assert enough["three_sigma_deg"]["interval"][1] == pytest.approx(0.4)
    assert few["three_sigma_deg"]["value"] == pytest.approx(0.001 + 0.399 * 0.997)


def test_too_few_frames_have_no_interval(make_sample):
    found = measures_of(make_sample([0.01, 0.02, 0.03, 0.04]), cluster_draws(4, "s", 0), 0.05)
    assert found["rms_deg"]["interval"] is None
    assert found["within"]["interval"][0] == pytest.approx(0.025 ** (1 / 4))


def test_draws_follow_from_name_and_seed():
    a, b, c = cluster_draws(7, "s", 0), cluster_draws(7, "s", 0), cluster_draws(7, "s", 1)
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    assert np.all(a.sum(axis=1) == 7)
    assert np.all(a[0] == 1)


@pytest.mark.parametrize(("k", "n"), [(0, 12), (12, 12), (5, 12), (199, 200)])
def test_independent_frames_have_the_exact_interval(k, n):
    found = proportion(np.arange(n) < k, np.arange(n))
    exact = stats.binomtest(k, n).proportion_ci(0.95, "exact")
    assert found["interval"] == pytest.approx([exact.low, exact.high], abs=1e-12)
    lower = stats.binomtest(k, n, alternative="greater").proportion_ci(0.95, "exact").low
    upper = stats.binomtest(k, n, alternative="less").proportion_ci(0.95, "exact").high
    assert (found["lower"], found["upper"]) == pytest.approx((lower, upper), abs=1e-12)
    assert (found["n"], found["of"], found["rate"]) == (k, n, k / n)


def test_whole_flights_count_once():
    # Two flights answered all, two nothing: by hand, variance = 4/3 * 4 * 2.5^2 / 20^2 = 1/12, worth (1/4)/(1/12) = 3.
    flags = np.repeat([True, True, False, False], 5)
    cluster = np.repeat(np.arange(4), 5)
    assert effective_size(flags, cluster) == pytest.approx(3.0)
    few, many = proportion(flags, cluster), proportion(flags, np.arange(20))
    assert few["interval"][0] < many["interval"][0]
    assert few["interval"][1] > many["interval"][1]


def test_the_interval_covers_the_truth_along_flights():
    # A flight is good or bad as a whole nine times of ten: taken as independent they would miss far more often.
    random = np.random.default_rng(5)
    truth, hits, naive = 0.7, 0, 0
    cluster = np.repeat(np.arange(30), 6)
    for _ in range(200):
        flight = np.repeat(random.random(30) < truth, 6)
        own = random.random(180) < truth
        flags = np.where(random.random(180) < 0.9, flight, own)
        low, high = proportion(flags, cluster)["interval"]
        hits += low <= truth <= high
        low, high = proportion(flags, np.arange(180))["interval"]
        naive += low <= truth <= high
    assert hits >= 184  # 95 % of 200, less three standard deviations of a count (3.1 each)
    assert naive < 150
