r"""The light of the pixels: levels of the sectors, what they leave, and how the pixels are weighed.

The variance of the noise is a straight line in brightness, as photons and read-out make it. It is estimated from the
residuals in space and on the Earth, and interpolated by the edge's level. Pixels further off than five standard
deviations are left out (stars, hot pixels, the Moon): of Gaussian noise one of two million.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.sectors import Levels, solve_levels

OUTLIER = 5.0
SPACE_LEVEL, EARTH_LEVEL = 0.1, 0.9
"""Of the edge, from 0 to 1: below and above it the noise of space and Earth is read."""
FEWEST_PIXELS = 8
"""Of either, or all residuals stand for it."""
NORMAL_QUARTILE = 0.67448975
"""Half of a normal distribution lies within as many standard deviations."""
ROUNDS = 2
"""Of weighing: by all pixels, then without the outliers that these show."""


@dataclass(frozen=True)
class LimbLight:
    """Of n pixels in m sectors.

    Attributes
    ----------
    levels : Levels
    of_pixel : ndarray, shape (3, n)
        The levels of every pixel's sector.
    residuals, weights : ndarray, shape (n,)
        Weights are inverse variances, 0 of outliers.
    variance : tuple of float
        Of a pixel in space and on the Earth.
    """

    levels: Levels
    of_pixel: FloatArray
    residuals: FloatArray
    weights: FloatArray
    variance: tuple[float, float]


def weighed(basis: FloatArray, values: FloatArray, starts: NDArray[np.intp]) -> LimbLight:
    """Return the light with noise, outliers and the spread of the sectors estimated.

    Parameters
    ----------
    basis : ndarray, shape (3, n)
        One, profile, shading.
    values : ndarray, shape (n,)
    starts : ndarray of int, shape (m + 1,)
        Of the sectors.
    """
    edge = basis[1]
    light = solved(basis, values, starts, np.ones_like(edge), (1.0, 1.0))
    for _ in range(ROUNDS):
        variance = _noise(light.residuals, edge, len(starts) - 1)
        expected = variance[0] + (variance[1] - variance[0]) * np.clip(edge, 0.0, 1.0)
        weights = np.where(light.residuals**2 < OUTLIER**2 * expected, 1.0 / expected, 0.0)
        light = solved(basis, values, starts, weights, variance)
    return light


def solved(
    basis: FloatArray,
    values: FloatArray,
    starts: NDArray[np.intp],
    weights: FloatArray,
    variance: tuple[float, float],
    spread_information: FloatArray | None = None,
) -> LimbLight:
    """Return the light with its weights given; parameters as for :func:`weighed` and :func:`.sectors.solve_levels`."""
    levels = solve_levels(basis, values, weights, starts, spread_information)
    of_pixel = np.repeat(levels.of_sector, np.diff(starts), axis=0).T
    residuals = values - np.einsum("ij,ij->j", basis, of_pixel)
    return LimbLight(levels, of_pixel, residuals, weights, variance)


def _noise(residuals: FloatArray, edge: FloatArray, sectors: int) -> tuple[float, float]:
    """Return the variance of a pixel in space and on the Earth, of those that are no outliers by their quartiles."""
    floor = 1e-12 * float(np.mean(residuals**2)) + 1e-300
    out = []
    for there in (edge < SPACE_LEVEL, edge > EARTH_LEVEL):
        some = np.abs(residuals[there] if there.sum() > FEWEST_PIXELS else residuals)
        inside = some < OUTLIER * max(float(np.median(some)) / NORMAL_QUARTILE, floor)
        # Every sector has spent one of its pixels' freedom on the level there.
        freedom = max(float(inside.sum()) - sectors, 1.0)
        out.append(max(float((some[inside] ** 2).sum()) / freedom, floor))
    return out[0], out[1]
