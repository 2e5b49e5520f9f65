"""Shares: Clopper and Pearson's interval for independent frames, fewer frames' worth along a flight."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from horizonval.studies.trade.sample import effective_size, proportion


@pytest.mark.parametrize(("k", "n"), [(0, 12), (12, 12), (5, 12), (199, 200)])
def test_independent_frames_have_the_exact_interval(k, n):
    found = proportion(np.arange(n) < k, np.arange(n))
    exact = stats.binomtest(k, n).proportion_ci(0.95, "exact")
    assert found["interval"] == pytest.approx([exact.low, exact.high], abs=1e-12)
    lower = stats.binomtest(k, n, alternative="greater").proportion_ci(0.95, "exact").low
    upper = stats.binomtest(k, n, alternative="less").proportion_ci(0.95, "exact").high
    assert (found["lower"], found["upper"]) == pytest.approx((lower, upper), abs=1e-12)
    assert (found["n"], found["of"], found["rate"]) == (k, n, k / n)


def test_nothing_of_nothing():
    assert proportion(np.zeros(0, dtype=bool), np.zeros(0, dtype=int))["interval"] is None


def test_whole_flights_count_once():
    # Two flights answered all, two nothing: by hand, variance = 4/3 * 4 * 2.5^2 / 20^2 = 1/12, worth (1/4)/(1/12) = 3.
    flags = np.repeat([True, True, False, False], 5)
    cluster = np.repeat(np.arange(4), 5)
    assert effective_size(flags, cluster) == pytest.approx(3.0)
    few, many = proportion(flags, cluster), proportion(flags, np.arange(20))
    assert few["interval"][0] < many["interval"][0]
    assert few["interval"][1] > many["interval"][1]


def test_without_a_miss_every_flight_counts_once():
    found = proportion(np.ones(40, dtype=bool), np.repeat(np.arange(8), 5))
    assert found["effective"] == 8
    assert found["lower"] == pytest.approx(0.05 ** (1 / 8))


def test_never_more_than_there_are():
    # Every flight has the same share: they differ less than chance would have it.
    assert effective_size(np.tile([True, False], 10), np.repeat(np.arange(10), 2)) == 20


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
