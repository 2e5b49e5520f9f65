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
from horizonval.estimation.fit.noise import NORMAL_QUARTILE, PixelNoise
from horizonval.estimation.limb.picture import median

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


OUTLIER = 5.0
EVEN = 0.05
"""Relative standard deviation of the ground's brightness up to which it counts as uniform: detector noise and profile
misfit leave 0.01 to 0.03 in clear air, clouds 0.07 to 0.35."""
SPACE_LEVEL, EARTH_LEVEL = 0.1, 0.9
"""Edge levels below and above which the noise of space and Earth is measured."""
MIDDLE_LEVEL = 0.02
"""Edge level from which, up to one minus it, the edge's residuals are measured."""
SIGNIFICANT = 3.0
"""Standard deviations by which an excess must stand out: one that noise makes itself would only cost precision."""
FEWEST_PIXELS = 8
"""Smallest number of pixels of either side; with fewer, all residuals are used."""
LEAST_ALONE = 2
"""Smallest number of independent pixels of the Earth that a sector has."""
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
    """Noise of pixels across a limb.

    ``parts``: variance in space, on the Earth, and excess in the edge's middle; ``alike``: number of the Earth's pixels
    with one common error.
    """

    parts: tuple[float, float, float] = (1.0, 1.0, 0.0)
    alike: float = 1.0

    def weights(self, residuals: FloatArray) -> FloatArray:
        """Return the inverse variances, those of the residuals at the last estimate."""
        return np.asarray(1.0 / self.variance)

    def improbability(self, residuals: FloatArray) -> float:
        """Return the sum of squared residuals in sigmas."""
        return float(np.sum(residuals * residuals / self.variance))

    def at(self, edge: FloatArray, counts: FloatArray, residuals: FloatArray, wider=1.0) -> LightNoise:
        """Return the same noise of pixels at other levels of the edge, shape (n,), means of so many each."""
        of_pixels = PixelNoise(_expected(edge, self.parts) / counts*wider, _expected(edge, (1.0, self.alike, 0.0))/wider)
        return LightNoise(1.0 / of_pixels.weights(residuals), 1.0, self.parts, self.alike)


def light_noise(
    values: FloatArray,
    residuals: FloatArray,
    basis: FloatArray,
    of_sector: FloatArray,
    neighbours: NDArray[np.intp],
    counts: FloatArray,
    rounding: float,
    *,
    start: bool = False,
) -> LightNoise:
    """Return the noise of pixels by their residuals.

    ``values``, ``residuals``, ``counts``: shape (n,), the last numbers of pixels that each is the mean of; ``basis``:
    shape (6, n), of :func:`light_basis`; ``of_sector``: shape (m, 6), levels; ``neighbours``: shape (2, k), pairs of
    adjacent pixels; ``rounding``: smallest variance of a pixel; ``start``: whether the limb may be out of its place.
    """
    edge, count = basis[1], len(of_sector)
    each = len(values) // count
    lit = np.abs(inner_levels(values, edge, of_sector))
    seen = np.repeat(lit >= LIT_SHARE * np.quantile(lit, BRIGHT_QUANTILE), each)
    level = np.repeat(of_sector[:, 1], each)
    parts = _noise((residuals * np.sqrt(counts))[seen], edge[seen], int(seen.sum()) // each, rounding)
    depth = basis[2] / np.where(edge > EARTH_LEVEL, edge, 1.0)
    alike = _alike(residuals, level, np.where(seen, edge, 0.0), depth, neighbours, count)
    if start:
        # Before the limb is in its place the edge must not weigh less for being missed: all of the noise is wider.
        between = seen & (edge > MIDDLE_LEVEL) & (edge < 1.0 - MIDDLE_LEVEL)
        line = (parts[0], parts[1], 0.0)
        missed = residuals[between] ** 2 * counts[between] / _expected(edge[between], line)
        wider = max(float(np.mean(missed)), 1.0) if len(missed) else 1.0
        parts = line
    found = LightNoise(np.ones(1), parts=parts, alike=alike).at(edge, counts, residuals, wider if start else 1.0)
    return replace(found, variance=np.where(seen, found.variance, UNSEEN * found.variance))


def inner_levels(values: FloatArray, edge: FloatArray, of_sector: FloatArray) -> FloatArray:
    """Return how much brighter than space sectors are inside the limb, shape (m,); parameters as of light_noise."""
    count = len(of_sector)
    inside = (edge > EARTH_LEVEL).reshape(count, -1).astype(float)
    above = values.reshape(count, -1) - of_sector[:, :1]
    return np.asarray((inside * above).sum(axis=1) / np.maximum(inside.sum(axis=1), 1.0))


def _expected(edge: FloatArray, variance: tuple[float, float, float]) -> FloatArray:
    level = np.clip(edge, 0.0, 1.0)
    return np.asarray(variance[0] + (variance[1] - variance[0]) * level + variance[2] * 4.0 * level * (1.0 - level))


def _noise(residuals: FloatArray, edge: FloatArray, sectors: int, rounding: float) -> tuple[float, float, float]:
    """Return the variances in space and on the Earth, at least rounding's, and the excess at the edge."""
    floor = max(rounding, 1e-12 * float(np.mean(residuals**2)) + 1e-300)
    where = (edge < SPACE_LEVEL, edge > EARTH_LEVEL)
    space, earth = (_spread_of(residuals[there], residuals) for there in where)
    # Every sector has spent one of its pixels' freedom on the level to either side.
    counts = [float(there.sum()) for there in where]
    freedom = [max(1.0 - sectors / max(count, 1.0), 0.5) for count in counts]
    earth = max(earth / freedom[1], floor)
    line = (max(space / freedom[0], DARKEST * earth, floor), earth)
    between = (edge >= MIDDLE_LEVEL) & (edge <= 1.0 - MIDDLE_LEVEL)
    share = np.clip(edge[between], 0.0, 1.0)
    if len(share) <= FEWEST_PIXELS:
        return line[0], line[1], 0.0
    expected = _expected(share, (*line, 0.0))
    squares = residuals[between] ** 2
    inside = squares <= OUTLIER**2 * median(squares / expected) / NORMAL_QUARTILE**2 * expected
    squares, expected, share = squares[inside], expected[inside], share[inside]
    beyond = float((squares - expected).sum())
    # The square of a normal number has twice its variance squared for a variance.
    if beyond < SIGNIFICANT * float(np.sqrt(2.0 * (expected**2).sum())):
        return line[0], line[1], 0.0
    return line[0], line[1], beyond / float((4.0 * share * (1.0 - share)).sum())


def _alike(
    residuals: FloatArray,
    level: FloatArray,
    edge: FloatArray,
    depth_px: FloatArray,
    neighbours: NDArray[np.intp],
    sectors: int,
) -> float:
    """Return the number of the Earth's pixels with one common error: 1 for noise, more for clouds, coasts and snow.

    With the correlation ``q`` between neighbours a sum along a line has ``(1 + q) / (1 - q)`` times the variance of
    independent pixels. A misfit common to the whole limb is removed before. Only variations above :data:`EVEN` count.
    """
    within = np.flatnonzero(edge > EARTH_LEVEL)
    if len(within) <= FEWEST_PIXELS or not neighbours.shape[1]:
        return 1.0
    level = level[within]
    size = np.where(np.abs(level) > 0.0, level, 1.0)
    relative = residuals[within] / size
    largest = OUTLIER * median(np.abs(relative)) / NORMAL_QUARTILE
    relative = np.clip(relative, -largest, largest)
    depth = np.rint(depth_px[within]).astype(np.intp)
    depth -= depth.min()
    profile = np.bincount(depth, weights=relative) / np.maximum(np.bincount(depth), 1)
    ground = np.full(len(edge), np.nan)
    ground[within] = relative - profile[depth]
    a, b = ground[neighbours]
    seen = np.isfinite(a) & np.isfinite(b)
    a, b = a[seen], b[seen]
    share = float(np.sum(a * b)) / max(0.5 * float(np.sum(a * a + b * b)), 1e-300)
    if share < SIGNIFICANT / float(np.sqrt(max(len(a), 1))):
        return 1.0
    variance = float(np.mean(ground[within] ** 2))
    uneven = max(1.0 - EVEN**2 / variance, 0.0) if variance > 0.0 else 0.0
    most = max(len(within) / (LEAST_ALONE * sectors), 1.0)
    return 1.0 + (min(((1.0 + share) / max(1.0 - share, 1e-9)) ** 2, most) - 1.0) * uneven


def _spread_of(some: FloatArray, all_of_them: FloatArray) -> float:
    """Return the mean square of residuals that are no outliers by their quartiles."""
    size = np.abs(some if len(some) > FEWEST_PIXELS else all_of_them)
    inside = size <= OUTLIER * median(size) / NORMAL_QUARTILE
    return float(np.mean(size[inside] ** 2))
