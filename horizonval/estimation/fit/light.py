"""The brightness of pixels across the limb: the profile of an edge, the levels of sectors, the weights of pixels.

**Edge.** Inside the limb the radiance is 1; outside it falls as ``exp(-height / H)``, at once where the scale height is
zero. The lens blurs it by a Gaussian, the pixel by its square, which has the second moment 1/12 px^2 in every
direction: both together are, to third order, one Gaussian of variance ``s^2 = s_lens^2 + 1/12``. With ``x`` the
distance inside the limb and ``c`` the scale height, both in pixels, and ``g = exp(x / c + s^2 / (2 c^2)) Phi(-x / s - s
/ c)``::

    E = Phi(x / s) + g          E' = g / c           (hard limb: E = Phi(x / s), E' = phi(x / s) / s)
    dE/ds = s E''               E'' = (g / c - phi(x / s) / s) / c
    dE/dc = s phi(x / s) / c^2 - g (x c + s^2) / c^3

**Neglected.** The square's fourth cumulant, -1/120 px^4 along its sides, changes ``E`` by at most 7e-4 of the step for
a lens of 0.7 px and by 1 % for one of 0.25 px; the change is odd in ``x`` and does not move the edge. A limb bent with
the radius ``b`` px is moved by ``s^2 / (2 b)``; :mod:`.edge` takes that into account.

**Levels.** In a sector the Earth's brightness is ``B = a + a' u + (c + c' u) x + d x^2 / w``, with ``u`` from -1/2 to
1/2 along the limb, ``x`` pixels inside it, and ``w`` the width of the window. ``a'`` and ``c'`` describe the lens's
fall-off and the Sun's height along the limb, ``c`` and ``d`` shading across it.

**Noise.** The variance is linear in brightness (photons and read-out). It is estimated from the residuals in space and
on the Earth, and interpolated by the edge's level ``E``. Larger residuals across the edge (ozone, haze) add a variance
proportional to ``4 E (1 - E)``. Residuals of clouds, coasts and snow are correlated between neighbours; correlated
pixels together have the weight of one (:class:`.noise.PixelNoise`).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.noise import WEIGHINGS, PixelNoise, mean_square, weighed

OUTSIDE_PX, INSIDE_PX = 12.0, 8.0
"""Distance of a sharp limb's pixels into space and into the Earth. Separate levels of every sector, from ``w`` pixels
to either side, cost an edge of blur ``s`` the share ``s sqrt(pi) / 2 (1 / w_in + 1 / w_out)`` of its information, 14 %
here. The Earth's brightness is less uniform than space, hence the shorter distance."""
OUTSIDE_SCALES = 4.0
"""Additional distance into space for a soft limb, in scale heights; 2 % of it remain there."""
PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of a square pixel along any direction [px^2]."""
SMALLEST_SCALE = 0.05
"""Scale height, relative to the blur, below which two terms of a series are exact to 1e-4 of the step."""


@dataclass(frozen=True)
class EdgeProfile:
    """Profile at n pixels, shape (n,) each.

    ``level``: from 0 in space to 1 on the Earth. Derivatives [1/px]: ``slope`` by the distance inside the limb,
    ``by_blur``, ``by_scale`` by blur and scale height.
    """

    level: FloatArray
    slope: FloatArray
    by_blur: FloatArray
    by_scale: FloatArray


def edge_profile(x: FloatArray, blur: float | FloatArray, scale: FloatArray | None = None) -> EdgeProfile:
    """Return the levels of pixels across the limb.

    ``x``: shape (n,), distance inside the limb [px]; ``blur``: standard deviation of lens and pixel [px], one or shape
    (n,); ``scale``: shape (n,), apparent scale height [px], None for a hard limb.
    """
    z = x / blur
    bell = np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
    step = ndtr(z)
    if scale is None:
        return EdgeProfile(step, bell / blur, -z * bell / blur, np.zeros_like(x))
    c = np.maximum(scale, SMALLEST_SCALE * blur)
    y = z + blur / c
    # exp(x/c + s^2/(2c^2)) Phi(-y) = phi(z) Phi(-y) / phi(y); inside, where y is large, by the scaled function.
    inside = y > 0.0
    with np.errstate(over="ignore"):
        outer = np.exp(np.minimum(z * blur / c + 0.5 * (blur / c) ** 2, 0.0)) * ndtr(-y)
    g = np.where(inside, bell * np.sqrt(0.5 * np.pi) * erfcx(np.maximum(y, 0.0) / np.sqrt(2.0)), outer)
    soft = EdgeProfile(
        level=step + g,
        slope=g / c,
        by_blur=(blur * g / c - bell) / c,
        by_scale=blur * bell / c**2 - g * (x * c + blur * blur) / c**3,
    )
    hard = scale < SMALLEST_SCALE * blur
    if not hard.any():
        return soft
    # E = Phi + c Phi' + c^2 Phi'' + ..., by integration by parts.
    c = scale / blur
    bent = z * z - 1.0
    nearly = EdgeProfile(
        level=step + bell * c * (1.0 - c * z),
        slope=bell / blur * (1.0 - c * z + c * c * bent),
        by_blur=bell / blur * (-z + c * bent - c * c * z * (bent - 2.0)),
        by_scale=bell / blur * (1.0 - 2.0 * c * z),
    )
    return EdgeProfile(
        *(np.where(hard, getattr(nearly, one.name), getattr(soft, one.name)) for one in fields(EdgeProfile))
    )


OF_SIDE = 0.02
"""Edge level up to which, and from one minus which, pixels show the noise of space and Earth; between, the edge's."""
LIT_SHARE, BRIGHT_QUANTILE = 0.1, 0.95
"""A sector is lit whose light is at least such a share of this quantile of all of them: a tenth is below every cloud
and above what twilight leaves; chosen."""
UNSEEN = 1e9
"""Number of pixels that count as one in a sector without light, which shows no limb."""
DARKEST = 1e-3
"""Smallest ratio of the variances of space and Earth. Space may have a single grey level, known to one level only;
pixels just above it must not determine the limb alone."""

SHADING_PX = 8.0
"""Unit of the bend of the shading: it makes the levels of one size."""


def light_basis(edge: FloatArray, x: FloatArray, along: FloatArray) -> FloatArray:
    """Return the basis functions of a sector, shape (6, n): one, edge, its shading (2), and along it (2).

    ``edge``: level of the profile; ``x``: pixels inside the limb; ``along``: position in the sector, -1/2 to 1/2; (n,)
    each.
    """
    shaded = edge * x
    return np.array([np.ones_like(x), edge, shaded, edge * (x * x / SHADING_PX), edge * along, shaded * along])


def brightness(levels: FloatArray, x: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Earth's brightness and its change per pixel inside, shape (n,) each, of levels (6, n)."""
    _, level, shading, bend, slope, turn = levels
    return (
        level + (shading + turn * along) * x + bend * (x * x / SHADING_PX) + slope * along,
        shading + turn * along + bend * (2.0 * x / SHADING_PX),
    )


@dataclass(frozen=True)
class LightNoise(PixelNoise):
    """Noise of pixels across a limb, with the tails of the residuals from which it was estimated.

    Weights that follow the residuals of each look would change the levels, which are eliminated by them. Held between
    estimates, they leave a sum of squares, whose steps converge as those of Gauss and Newton.

    ``variance``: shape (n,), inverse weights; ``parts``: variance in space, on the Earth, and excess in the edge's
    middle.
    """

    parts: tuple[float, float, float] = (1.0, 1.0, 0.0)

    def weights(self, residuals: FloatArray) -> FloatArray:
        """Return the inverse variances, shape (n,)."""
        return np.asarray(1.0 / self.variance)

    def improbability(self, residuals: FloatArray) -> float:
        """Return the sum of the squared residuals (n,) in sigmas."""
        return float(np.sum(residuals * residuals / self.variance))

    def at(self, edge: FloatArray, counts: FloatArray, residuals: FloatArray) -> LightNoise:
        """Return the same noise of pixels at levels of the edge, shape (n,), means of so many each."""
        return replace(self, variance=1.0 / PixelNoise(_expected(edge, self.parts) / counts).weights(residuals))


def light_noise(
    residuals: FloatArray,
    squares: FloatArray,
    lit: NDArray[np.bool_],
    edge: FloatArray,
    counts: FloatArray,
    rounding: float,
) -> LightNoise:
    """Return the noise of pixels by their residuals.

    Shape (n,) each: ``residuals``; ``squares``, what they say of a pixel's variance; ``lit``, whether a pixel's sector
    has light; ``edge``, level of the profile; ``counts``, numbers of pixels that each is the mean of. ``rounding``:
    smallest variance of a pixel.
    """
    squares, level = squares[lit], edge[lit]
    floor = max(rounding, 1e-12 * float(np.mean(squares)) + 1e-300)
    space, earth = level < OF_SIDE, level > 1.0 - OF_SIDE
    of_space, of_earth = (mean_square(squares[there], squares) for there in (space, earth))
    line = (max(of_space, DARKEST * of_earth, floor), max(of_earth, floor), 0.0)
    between, excess = ~(space | earth), 0.0
    if between.any():
        squares, level = squares[between], level[between]
        expected, share, excess = _expected(level, line), 4.0 * level * (1.0 - level), np.inf
        for _ in range(WEIGHINGS):
            beyond = weighed(squares, expected + excess * share) - expected
            excess = max(float((beyond @ share) / (share @ share)), 0.0)
    found = LightNoise(np.ones(1), parts=(*line[:2], excess)).at(edge, counts, residuals)
    return found if lit.all() else replace(found, variance=np.where(lit, found.variance, UNSEEN * found.variance))


def inner_levels(values: FloatArray, edge: FloatArray, of_sector: FloatArray) -> FloatArray:
    """Return how much brighter than space sectors are inside the limb, shape (m,); parameters as of light_noise."""
    count = len(of_sector)
    inside = (edge > 1.0 - OF_SIDE).reshape(count, -1).astype(float)
    above = values.reshape(count, -1) - of_sector[:, :1]
    return np.asarray((inside * above).sum(axis=1) / np.maximum(inside.sum(axis=1), 1.0))


def _expected(edge: FloatArray, variance: tuple[float, float, float]) -> FloatArray:
    level = np.clip(edge, 0.0, 1.0)
    return np.asarray(variance[0] + (variance[1] - variance[0]) * level + variance[2] * 4.0 * level * (1.0 - level))
