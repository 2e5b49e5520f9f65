"""The noise of pixels near a limb: a variance each, and tails that are heavier than a normal distribution's.

Stars, hot pixels and other light that no model has make residuals that noise does not. With Student's distribution of
``nu`` degrees of freedom the likelihood of a residual ``r`` and the weight that it gives a pixel are ::

    -2 ln L = (nu + 1) ln(1 + r^2 / (nu v)) + ln v,        w = (nu + 1) / (nu + r^2 / v) / v

(K. L. Lange, R. J. A. Little and J. M. G. Taylor, J. Am. Stat. Assoc. 84, 881, 1989). No pixel is left out by a rule,
and no marginal one goes in and out during a fit.

**Variance.** It is that of dark pixels plus components fitted to the squared residuals: one proportional to the level
(photons), others to squares of what a model may be wrong in. The squares count with the same weights, over what these
make of a normal residual's, so that normal noise has its own variance::

    E[w v r^2] / v = (nu + 1) (1 - sqrt(pi nu / 2) exp(nu / 2) erfc(sqrt(nu / 2)))

**Floor.** For a normally distributed pixel of mean ``mu`` and standard deviation ``s``, cut off by a converter at
``f``, the expectation is ::

    E = f + s (phi(z) + z Phi(z)),      dE / dmu = Phi(z),      z = (mu - f) / s

Space at the floor itself reads 0.4 s too high, which matters for cameras without a black level. ``s`` and the
background come from the pixels that see space only, by their share at the floor and their mean.

**Correlation.** Where neighbouring residuals are correlated (clouds, missing modes), their sums over squares scatter
more than independent residuals. The correlated part is what exceeds the noise of dark pixels; the larger its share of a
pixel's variance, the smaller the pixel's weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.special import erfcx, ndtr, ndtri

from horizonval.core.arrays import FloatArray

TAIL_FREEDOM = 10.0
"""Degrees of freedom of Student's distribution. Where the noise is normal the estimate has 0.98 of the information of
least squares; a pixel ten sigmas off has a tenth of its weight."""

OF_NORMAL = (TAIL_FREEDOM + 1.0) * float(1.0 - np.sqrt(0.5 * np.pi * TAIL_FREEDOM) * erfcx(np.sqrt(0.5 * TAIL_FREEDOM)))
"""Weighed mean square of normal residuals over their variance."""


@dataclass(frozen=True)
class PixelNoise:
    """Noise of n pixels.

    ``variance``: shape (n,), in grey levels squared; ``together``: shape (n,) or 1, number of pixels with one common
    error, which count as one.
    """

    variance: FloatArray
    together: FloatArray | float = 1.0

    def weights(self, residuals: FloatArray) -> FloatArray:
        """Return the inverse variances, shape (n,), that residuals (n,) leave to their pixels."""
        square = residuals**2 / self.variance
        return np.asarray((TAIL_FREEDOM + 1.0) / (TAIL_FREEDOM + square) / (self.variance * self.together))

    def improbability(self, residuals: FloatArray) -> float:
        """Return -2 ln likelihood of residuals (n,), up to a constant that depends on the variances alone."""
        square = residuals**2 / self.variance
        return float(np.sum((TAIL_FREEDOM + 1.0) * np.log1p(square / TAIL_FREEDOM) / self.together))


WEIGHINGS = 3
"""Rounds in which weights and variances agree, each to a tenth of the round before."""

NORMAL_QUARTILE = float(ndtri(0.75))
"""Median of the absolute value of a unit normal."""


def weighed(squares: FloatArray, variance: FloatArray | float) -> FloatArray:
    """Return squared residuals (n,) with the weights of Student's distribution, over what normal ones have of them."""
    return np.asarray(squares * ((TAIL_FREEDOM + 1.0) / OF_NORMAL / (TAIL_FREEDOM + squares / variance)))


def variance_of(
    residuals: FloatArray, level: FloatArray, parts: FloatArray, least: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return the variance of pixels, shape (n,), and the share of it beyond that of dark pixels.

    ``level``: shape (n,), predicted, of which the first component is a multiple; ``parts``: shape (k, n), the other
    components, all of any scale; ``least``: smallest variance (rounding, neglected parts of a prediction).
    """
    level = np.clip(level / max(float(level.max()), 1e-300), 0.0, 1.0)
    squares = residuals**2
    # Of these shares of the brightest level pixels give a first guess of the noise of space and Earth.
    dark, bright = (mean_square(squares[there], squares) for there in (level < 0.05, level > 0.5))
    components = np.concatenate([level[None], parts])
    components /= np.maximum(components.max(axis=1), 1e-300)[:, None]
    variance = np.maximum(dark + max(bright - dark, 0.0) * level, least)
    for _ in range(WEIGHINGS):
        beyond = _components(weighed(squares, variance) - dark, variance, components) @ components
        variance = np.maximum(dark + beyond, least)
    return variance, np.minimum(beyond / variance, 1.0)


def mean_square(squares: FloatArray, otherwise: FloatArray) -> float:
    """Return the mean of squared residuals with the weights of their own distribution."""
    # Twenty pixels give a variance to a third.
    some = squares if len(squares) > 20 else otherwise
    mean = float(np.median(some)) / NORMAL_QUARTILE**2
    if not mean > 0.0:
        mean = float(np.mean(some))
    for _ in range(WEIGHINGS):
        mean = max(mean, 1e-300)
        mean = float(np.mean(weighed(some, mean)))
    return max(mean, 1e-300)


def _components(squares: FloatArray, variance: FloatArray, parts: FloatArray) -> FloatArray:
    """Return variance components of parts (k, n), at least 0, by least squares for squared normals."""
    rows = parts / variance
    normal, pull = rows @ rows.T, rows @ (squares / variance)
    if not (np.isfinite(normal).all() and np.isfinite(pull).all()):
        raise np.linalg.LinAlgError("the residuals are not finite")
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    root = np.linalg.cholesky(normal / np.outer(size, size) + 1e-9 * np.eye(len(parts)))
    return np.asarray(nnls(root.T, np.linalg.solve(root, pull / size))[0] / size)


def correlated(columns: FloatArray, rows: FloatArray, in_sigmas: FloatArray, spacing_px: float) -> float:
    """Return how much larger the variance of residual sums over squares is than of independent ones, at least 1.

    ``columns``, ``rows``, ``in_sigmas``: shape (n,); ``spacing_px``: mean distance of the residuals. The square size is
    the one at which the ratio is largest.
    """
    most = 1.0
    for side in (4, 8, 16, 32):
        column, row = ((part / (side * spacing_px)).astype(np.intp) for part in (columns, rows))
        square = row * (int(column.max()) + 1) + column
        sums, count = np.bincount(square, in_sigmas), np.bincount(square)
        full = count > side
        most = max(most, float(np.sum(sums[full] ** 2) / max(float(np.sum(count[full])), 1.0)))
    # Independent residuals have 1.0 to 1.1. A ramp, since a step would displace the nadir.
    counts = float(np.clip((most - 1.1) / 0.2, 0.0, 1.0))
    return 1.0 + counts * (most - 1.0)


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
    # Fifty pixels give the share, and so the noise, to a seventh.
    if len(dark) < 50:
        return None
    share = float(np.mean(dark <= lowest))
    mean = float(np.mean(dark)) - lowest
    # A hundredth of the pixels at the floor, or above it, loses nothing, and determines nothing.
    if not (0.01 < share < 0.99 and mean > 0.0):
        return None
    # The floor includes values up to the middle of the next grey level.
    half_step, below, sigma = 0.5, float(ndtri(share)), mean
    for _ in range(20):
        z = half_step / sigma - below
        sigma = mean / float(np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi) + z * ndtr(z))
    if not (np.isfinite(sigma) and sigma > half_step):
        return None
    return Floor(lowest, sigma, half_step - below * sigma)
