"""Noise that a converter cuts off at its floor, against draws."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.likelihood.profile.noise import floor_of


def cut(rng: np.random.Generator, level: float, sigma: float, n: int, lowest: int = 0) -> np.ndarray:
    return np.maximum(np.floor(rng.normal(level, sigma, n) + 0.5), lowest)


@pytest.mark.parametrize(
    ("level", "sigma", "lowest"), [(0.0, 13.0, 0), (6.0, 8.0, 0), (-4.0, 20.0, 0), (30.0, 5.0, 27)]
)
def test_the_noise_is_found_from_what_is_left_of_it(level: float, sigma: float, lowest: int) -> None:
    rng = np.random.default_rng(4)
    found = floor_of(cut(rng, level, sigma, 20_000, lowest), float(lowest))
    assert found is not None
    # 20 000 draws tell a share to 0.7 %, and the noise to 2 %
    assert found.sigma == pytest.approx(sigma, rel=0.03)
    assert found.background == pytest.approx(level, abs=0.03 * sigma)
    for shown in (level - 0.5 * sigma, level, level + sigma, level + 4.0 * sigma):
        expected, slope = found.expected(np.array([shown]))
        assert expected[0] == pytest.approx(cut(rng, shown, sigma, 200_000, lowest).mean(), abs=0.03 * sigma)
        step = 0.1 * sigma
        ends = [found.expected(np.array([shown + d]))[0][0] for d in (-step, step)]
        assert slope[0] == pytest.approx((ends[1] - ends[0]) / (2.0 * step), abs=1e-3)


def test_without_a_floor_there_is_none() -> None:
    rng = np.random.default_rng(5)
    free = np.floor(rng.normal(200.0, 8.0, 5000) + 0.5)
    assert floor_of(free, float(free.min())) is None
    assert floor_of(np.zeros(5000), 0.0) is None
    assert floor_of(cut(rng, 0.0, 8.0, 20), 0.0) is None
