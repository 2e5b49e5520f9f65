"""Statistics of a group against numpy and scipy, from none to many values."""

from __future__ import annotations

import pytest
from scipy import stats

from horizonval.scoring.summary import proportion, upper_bound


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
