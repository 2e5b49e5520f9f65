"""The interval behind a mean over draws, against Student's as scipy states it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from horizonval.systems.e.case import METHODS
from horizonval.systems.e.figures import half_width, mean


@pytest.mark.parametrize("n", [2, 5, 40])
def test_the_interval_of_a_mean_is_students(n: int) -> None:
    draws = np.random.default_rng(n).gamma(2.0, 3.0, (n, len(METHODS), 3))
    rows = {"noisy": {"rms": draws}}
    for k, method in enumerate(METHODS):
        interval = stats.ttest_1samp(draws[:, k], 0.0).confidence_interval(0.95)
        assert mean(rows, "noisy", method) == pytest.approx((interval.high + interval.low) / 2)
        assert half_width(rows, "noisy", method) == pytest.approx((interval.high - interval.low) / 2)
