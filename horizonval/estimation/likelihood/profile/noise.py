"""The noise of pixels that see the limb's profile, also where a converter cuts it off.

**Floor.** For a normally distributed pixel of mean ``mu`` and standard deviation ``s``, cut off at ``f``, the
expectation is ::

    E = f + s (phi(z) + z Phi(z)),      dE / dmu = Phi(z),      z = (mu - f) / s

Space at the floor itself reads 0.4 s too high, which matters for cameras without a black level. ``s`` and the
background come from the pixels that see space only, by their share at the floor and their mean.

**Variance.** It is that of dark pixels and three parts fitted to the residuals by least squares: one proportional to
the level (photons), one to the square of what clouds can change (the radiance of the limb's brightest height, blurred,
below the highest clouds), one to the square of the slope (errors of the lens model). It is not below the variance of
the converter's rounding and of the prediction's neglected terms. Pixels more than five standard deviations off are left
out (stars, hot pixels).

**Correlation.** Where neighbouring residuals are correlated (clouds, missing modes), their sums over squares scatter
more than independent residuals. The correlated part is what exceeds the noise of dark pixels; the larger its share of a
pixel's variance, the smaller the pixel's weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.special import ndtr, ndtri

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.pixels import NearPixels

LEAST_SHARE, MOST_SHARE = 0.01, 0.99
"""Range of the share of dark pixels at the floor: fewer lose nothing, more determine nothing."""
FEWEST = 50
"""Dark pixels: the share is then known to a seventh, and so the noise."""
ROUNDS = 20
HALF_STEP = 0.5
"""Half a grey level: the floor includes values up to the middle of the next level."""


@dataclass(frozen=True)
class Floor:
    """Lowest level that there is, the standard deviation of the noise, and what space shines above the level."""

    level: float
    sigma: float
    space: float = 0.0

    @property
    def background(self) -> float:
        """Grey level of space, without the floor."""
        return self.level + self.space

    def expected(self, level: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what pixels of these levels show in the mean, and its derivative by the level."""
        z = (level - self.level) / self.sigma
        above = ndtr(z)
        beside = self.sigma * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        return self.level + beside + (level - self.level) * above, above


def floor_of(dark: FloatArray, lowest: float) -> Floor | None:
    """Return the floor of pixels (n,) that see space, None if it clips no noise; ``lowest``: of the image."""
    if len(dark) < FEWEST:
        return None
    share = float(np.mean(dark <= lowest))
    mean = float(np.mean(dark)) - lowest
    if not (LEAST_SHARE < share < MOST_SHARE and mean > 0.0):
        return None
    below, sigma = float(ndtri(share)), mean
    for _ in range(ROUNDS):
        z = HALF_STEP / sigma - below
        sigma = mean / float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + z * ndtr(z))
    if not (np.isfinite(sigma) and sigma > HALF_STEP):
        return None
    return Floor(lowest, sigma, HALF_STEP - below * sigma)


OUTLIER = 5.0
WEIGHINGS = 3
"""Rounds in which what counts as an outlier and the noise agree."""
DARK_LEVEL, BRIGHT_LEVEL = 0.05, 0.5
FEWEST_PIXELS = 20
NORMAL_QUARTILE = 0.67448975
ALIKE_PX = (4, 8, 16, 32)
"""Sides of the squares over which residuals are summed: scales of clouds and of charge spread."""


@dataclass(frozen=True)
class PixelNoise:
    """Pixel noise, shape (n,) each.

    ``used``: not an outlier; ``by_level``: derivative of the variance by the level, 0 at the minimum variance;
    ``shown``: share of the variance beyond that of dark pixels.
    """

    variance: FloatArray
    used: NDArray[np.bool_]
    by_level: FloatArray
    shown: FloatArray

    @property
    def inverse_variance(self) -> FloatArray:
        """0 of outliers."""
        return np.where(self.used, 1.0 / self.variance, 0.0)

    def improbability(self, residuals: FloatArray, wider: FloatArray | float = 1.0) -> float:
        """Return -2 ln likelihood up to a constant; an outlier counts as a residual at the limit."""
        squares = np.minimum(residuals**2 / self.variance, OUTLIER**2)
        return float(np.sum((squares + np.log(self.variance)) / wider))

    def pull(self, residuals: FloatArray, gain: float) -> FloatArray:
        """Return the addition to the residuals for noise that depends on the level; ``gain``: residual per level."""
        beyond = np.minimum(residuals**2 / self.variance, OUTLIER**2) - 1.0
        return np.asarray(0.5 * beyond * self.by_level / gain)


def noise_of(
    residuals: FloatArray,
    level: FloatArray,
    clouds: FloatArray,
    per_px: FloatArray,
    used: np.ndarray,
    least: FloatArray | float = 0.0,
) -> PixelNoise:
    """Return the noise of pixels.

    All (n,): ``residuals``; ``level``: predicted; ``clouds``: part of it that clouds may change, in the same unit;
    ``per_px``: change of the level per pixel across the limb; ``used``: pixels of the first guess; ``least``: minimum
    variance, from the converter's steps and the neglected air.
    """
    brightest = max(float(level.max()), 1e-300)
    level = np.clip(level / brightest, 0.0, 1.0)
    squares = residuals**2
    dark, bright = (_variance(squares, there & used) for there in (level < DARK_LEVEL, level > BRIGHT_LEVEL))
    steep = per_px**2
    parts = np.array([level, (clouds / brightest) ** 2, steep / max(float(steep.max()), 1e-300)])
    expected = np.maximum(dark + max(bright - dark, 0.0) * level, least)
    for _ in range(WEIGHINGS):
        inside = squares < OUTLIER**2 * expected
        sizes = _components(squares - dark, expected, parts, inside)
        expected = np.maximum(dark + sizes @ parts, least)
    by_level = np.where(expected <= least, 0.0, sizes[0] / brightest)
    shown = np.minimum(sizes @ parts / expected, 1.0)
    return PixelNoise(expected, squares < OUTLIER**2 * expected, by_level, shown)


def alike(pixels: NearPixels, residuals: FloatArray, inverse_variance: FloatArray) -> float:
    """Return how much larger the variance of residual sums over squares is than of independent ones, at least 1.

    The square size is the one at which the ratio is largest.
    """
    root = np.sqrt(inverse_variance)
    in_sigmas, used = root * residuals, (root > 0.0).astype(np.float64)
    most = 1.0
    for side in ALIKE_PX:
        across = int(pixels.columns.max()) // side + 1
        square = (pixels.rows // side) * across + pixels.columns // side
        sums, count = np.bincount(square, in_sigmas), np.bincount(square, used)
        full = count > side
        most = max(most, float(np.sum(sums[full] ** 2) / max(float(np.sum(count[full])), 1.0)))
    return most


def _variance(squares: FloatArray, there: np.ndarray) -> float:
    """Return the mean of squared residuals that are no outliers by their quartiles."""
    some = squares[there]
    some = some if len(some) > FEWEST_PIXELS else squares
    inside = some <= OUTLIER**2 * float(np.median(some)) / NORMAL_QUARTILE**2
    return max(float(np.mean(some[inside])), 1e-300)


def _components(squares: FloatArray, expected: FloatArray, parts: FloatArray, inside: np.ndarray) -> FloatArray:
    """Return variance components of parts (k, n), at least 0, by least squares for squared normals."""
    weight = inside / expected
    rows = parts * weight
    normal, pull = rows @ rows.T, rows @ (squares * weight)
    if not (np.isfinite(normal).all() and np.isfinite(pull).all()):
        raise np.linalg.LinAlgError("the residuals have left the numbers that there are")
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    root = np.linalg.cholesky(normal / np.outer(size, size) + 1e-9 * np.eye(len(parts)))
    right = np.linalg.solve(root, pull / size)
    return np.asarray(nnls(root.T, right)[0] / size)
