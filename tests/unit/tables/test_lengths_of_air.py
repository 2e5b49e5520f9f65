"""Lengths of modes, found again from coefficients that were drawn with known ones."""

from __future__ import annotations

import numpy as np

from horizonval.tables.modes import LATITUDE_DEG
from horizonval.tables.thermal import ASIDE_DEG, WEATHERS, lengths_of_air

MONTHS = 60
MERIDIAN_RAD, PARALLEL_RAD = 0.25, 0.55


def test_lengths_are_found_again() -> None:
    """720 states: a correlation of 0.9 is right to 0.007 and its length to 4 %, one of 0.8 to 3 %; three of these."""
    rng = np.random.default_rng(9)
    latitude = np.radians(LATITUDE_DEG)
    apart = 2.0 * np.sin(0.5 * np.abs(latitude[:, None] - latitude[None]))
    covariance = np.exp(-0.5 * (apart / MERIDIAN_RAD) ** 2)
    draws = rng.multivariate_normal(np.zeros(len(latitude)), covariance, (2, MONTHS, WEATHERS), method="eigh")
    turn = np.minimum(
        np.radians(ASIDE_DEG) / np.maximum(np.cos(latitude), 1e-9), np.radians(ASIDE_DEG / np.cos(np.radians(80.0)))
    )
    chord = 2.0 * np.cos(latitude) * np.sin(0.5 * turn)
    r = np.exp(-0.5 * (chord / PARALLEL_RAD) ** 2)
    at, aside = draws[0], r * draws[0] + np.sqrt(1.0 - r**2) * draws[1]
    same = np.full((MONTHS, 1, len(latitude)), 7.0)
    coefficients = np.moveaxis(np.concatenate([at, same, aside, same], axis=1), 2, 0)[..., None]
    found = lengths_of_air(coefficients)
    assert found.shape == (len(latitude), 1, 2)
    np.testing.assert_allclose(found[:, 0, 0], MERIDIAN_RAD, rtol=0.1)
    np.testing.assert_allclose(found[1:-1, 0, 1], PARALLEL_RAD, rtol=0.12)
    np.testing.assert_array_equal(found[[0, -1], 0, 1], found[[0, -1], 0, 0])
