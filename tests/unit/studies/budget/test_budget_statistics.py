"""Statistics of error series: two levels, knowledge errors, correlation in time; independent closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.studies.budget.statistics import correlation, knowledge_errors, two_levels


def flights(bias, white, correlated, e_fold_s, *, count=200, times=60, step_s=20.0):
    """Flights with a constant, a white and an exponentially correlated error (a first-order Markov process)."""
    rng = np.random.default_rng(7)
    r = np.exp(-step_s / e_fold_s)
    made = []
    for _ in range(count):
        slow = np.empty(times)
        slow[0] = rng.standard_normal()
        for i in range(1, times):
            slow[i] = r * slow[i - 1] + np.sqrt(1 - r * r) * rng.standard_normal()
        made.append(bias * rng.standard_normal() + correlated * slow + white * rng.standard_normal(times))
    return made, [step_s * np.arange(times)] * count


def test_two_levels_tell_flights_from_times():
    series, _ = flights(30.0, 10.0, 0.0, 1.0)
    found = two_levels(series)
    assert found["n"] == 200 * 60
    assert found["mixed"] == pytest.approx(np.hypot(30.0, 10.0), rel=0.1)
    low, high = found["interval"]
    assert low < np.hypot(30.0, 10.0) < high
    # The worst time and the worst flight are above the mean ones, by the scatter of a standard deviation.
    assert 30.0 < found["ensemble"] < 40.0
    assert 10.0 < found["temporal"] < 15.0
    assert found["tails"] is False
    assert two_levels([np.array([np.nan, 5.0])])["mean"] == 5.0
    assert two_levels([])["mixed"] is None


def test_heavy_tails_are_flagged():
    values = np.random.default_rng(1).standard_t(2.0, 4000)
    assert two_levels([values])["tails"] is True


def test_white_and_correlated_parts_are_told_apart():
    found = correlation(*flights(0.0, 20.0, 50.0, 120.0))
    assert found["white"] == pytest.approx(20.0, abs=4.0)
    assert found["correlated"] == pytest.approx(50.0, rel=0.06)
    assert found["e_fold_s"] == pytest.approx(120.0, rel=0.15)
    white = correlation(*flights(0.0, 20.0, 0.0, 1.0))
    assert white["white"] == pytest.approx(20.0, rel=0.02)
    assert white["correlated"] == 0.0


def test_frames_without_an_answer_leave_gaps():
    series, times = flights(0.0, 20.0, 50.0, 120.0)
    holes = np.random.default_rng(3).random((200, 60)) < 0.3
    for one, hole in zip(series, holes, strict=True):
        one[hole] = np.nan
    found = correlation(series, times)
    assert found["correlated"] == pytest.approx(50.0, rel=0.06)
    assert found["e_fold_s"] == pytest.approx(120.0, rel=0.2)


def test_knowledge_errors_of_a_ramp():
    """A ramp of 1 arcsec/s over windows of 100 s: means 49.5 more in each, the rest uniform with sigma 28.87."""
    times = np.arange(400.0)
    found = knowledge_errors([times.copy()], [times], 100.0)
    assert found["KDE"]["mean"] == pytest.approx(100.0)
    assert found["KRE"]["mean"] == pytest.approx(300.0)
    assert found["MKE"]["mean"] == pytest.approx(199.5)
    assert found["RKE"]["mean"] == pytest.approx(0.0, abs=1e-9)
    assert found["RKE"]["mixed"] == pytest.approx(np.sqrt((100.0**2 - 1) / 12.0), rel=2e-3)
    assert found["AKE"]["n"] == 400
