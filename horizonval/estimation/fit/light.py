"""The brightness of pixels across the limb: profile of an edge, levels of sectors, noise of pixels.

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
fall-off and the Sun's height along the limb, ``c`` and ``d`` shading across it. The pixels are ``A (mu + d)`` with the
functions ``A`` of :func:`light_basis`, the mean ``mu`` of all sectors (the shading has none), and a sector's difference
``d`` with the prior ``N(0, T)``. ``T`` is the scatter of the sectors' levels beyond their noise: evenly lit limbs keep
the precision of one common level. All levels are eliminated from the normal equations (Schur's complement), with ``G =
A^T W A`` and ``H = (G + T^-1)^-1`` of each sector, which has as many pixels as any other::

    N_xx = sum J^T W J - J^T W A H A^T W J,    N_xm = sum J^T W A (1 - H G),    N_mm = sum G - G H G
    N = N_xx - N_xm N_mm^-1 N_mx

**Noise.** The variance is linear in brightness (photons and read-out): between that of space and that of the Earth by
the edge's level ``E``. Larger residuals across the edge (ozone, haze) add one proportional to ``4 E (1 - E)``. Levels
take a part of the residuals' squares: with the hat matrix ``h`` of a sector ``1 - 2 h_ii + sum_j h_ij^2 v_j / v_i`` of
the variance ``v_i`` is left.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfcx, ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.noise import WEIGHINGS, PixelNoise, correlated, mean_square, weighed

OUTSIDE_PX, INSIDE_PX = 12.0, 8.0
"""Distance of a sharp limb's pixels into space and into the Earth. Separate levels of every sector, from ``w`` pixels
to either side, cost an edge of blur ``s`` the share ``s sqrt(pi) / 2 (1 / w_in + 1 / w_out)`` of its information, 14 %
here. The Earth's brightness is less uniform than space, hence the shorter distance."""
OUTSIDE_SCALES = 4.0
"""Additional distance into space for a soft limb, in scale heights; 2 % of it remain there."""
PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of a square pixel along any direction [px^2]."""


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
    # Below this scale height two terms of a series are exact to 1e-4 of the step.
    least = 0.05 * blur
    c = np.maximum(scale, least)
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
    hard = scale < least
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


def light_basis(edge: FloatArray, x: FloatArray, along: FloatArray) -> FloatArray:
    """Return the basis functions of a sector, shape (6, n): one, edge, its shading (2), and along it (2).

    ``edge``: level of the profile; ``x``: pixels inside the limb; ``along``: position in the sector, -1/2 to 1/2; (n,)
    each. The unit of the shading's bend makes the levels of one size.
    """
    shaded = edge * x
    return np.array([np.ones_like(x), edge, shaded, edge * (x * x / INSIDE_PX), edge * along, shaded * along])


def brightness(levels: FloatArray, x: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Earth's brightness and its change per pixel inside, shape (n,) each, of levels (6, n)."""
    _, level, shading, bend, slope, turn = levels
    return (
        level + (shading + turn * along) * x + bend * (x * x / INSIDE_PX) + slope * along,
        shading + turn * along + bend * (2.0 * x / INSIDE_PX),
    )


CENTRED = 2
"""Number of levels that scatter about a mean: background and amplitude, not the shading."""
NO_SPREAD = 1e-6
"""Smallest spread of sectors relative to the variance of the mean level; keeps the matrices regular."""


@dataclass(frozen=True)
class Sectors:
    """A division of pixels.

    ``order``: shape (n,), pixels by azimuth from the widest gap on, as many in every sector; a few may be left out.
    ``count``: number of sectors; ``azimuth``: shape (n,), of the ordered pixels [rad], rising from 0.
    """

    order: NDArray[np.intp]
    count: int
    azimuth: FloatArray

    @property
    def along(self) -> FloatArray:
        """Place of the ordered pixels in their sector, from -1/2 to 1/2 of its azimuth, shape (n,)."""
        azimuth = self.azimuth.reshape(self.count, -1)
        borders = np.append(azimuth[:, 0], azimuth[-1, -1])
        middle, width = 0.5 * (borders[1:] + borders[:-1]), np.maximum(np.diff(borders), 1e-300)
        return np.asarray(((azimuth - middle[:, None]) / width[:, None]).ravel())


def sectors_of(azimuth: FloatArray, limb_px: int, limb_rad: float = 0.0) -> Sectors:
    """Return sectors of equally many pixels.

    ``azimuth``: shape (n,), about the nadir [rad]; ``limb_px``, ``limb_rad``: length of the limb in view, also as an
    angle.
    """
    # 24 px of limb make a sector's levels ten times better known than one pixel's noise. Lens fall-off (cosine to the
    # fourth) departs by up to 3 % at 45 deg from a line along a sector of 0.2 rad; by 17 %, which displaces the limb,
    # over 24 pixels of a degree.
    order, along = from_widest_gap(azimuth)
    count = min(int(np.clip(max(limb_px // 24, int(limb_rad / 0.2)), 1, 48)), len(order))
    kept = np.linspace(0.0, len(order) - 1.0, len(order) // count * count).round().astype(np.intp)
    return Sectors(order[kept], count, along[kept])


def from_widest_gap(azimuth: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """Return the order of azimuths (n,) [rad] from their widest gap on, and the azimuths so, rising from 0."""
    order = np.argsort(azimuth, kind="stable")
    ordered = azimuth[order]
    gaps = np.append(np.diff(ordered), ordered[0] + 2.0 * np.pi - ordered[-1])
    order = np.roll(order, -((int(np.argmax(gaps)) + 1) % len(order)))
    return order, np.mod(azimuth[order] - azimuth[order[0]], 2.0 * np.pi)


@dataclass(frozen=True)
class Levels:
    """Levels of the sectors.

    ``of_sector``: shape (m, k); ``penalty``: sum of squared departures from their mean over their variance about it;
    ``inverse``: shape (m, k, k), covariance of a sector's levels about it.
    """

    of_sector: FloatArray
    penalty: float
    inverse: FloatArray

    def left(self, basis: FloatArray, weights: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the share of the variance of pixels, shape (n,), that levels leave in the squared residuals.

        ``weights``: shape (n,), with which the levels were found; ``variance``: shape (n,), of the pixels, in any unit.
        """
        rows = _by_sector(basis, len(self.of_sector))
        gains = self.inverse @ rows
        noise = (rows * _by_sector(weights[None] ** 2 * variance, len(self.of_sector))) @ rows.transpose(0, 2, 1)
        own = np.einsum("mkc,mkc->mc", rows, gains).ravel() * weights
        return 1.0 - 2.0 * own + np.einsum("mkc,mkc->mc", gains, noise @ gains).ravel() / variance

    def of_pixels(self, basis: FloatArray) -> FloatArray:
        """Return what the levels make of basis functions (k, n), shape (n,)."""
        each = basis.reshape(basis.shape[0], len(self.of_sector), -1)
        return np.einsum("kmc,mk->mc", each, self.of_sector).ravel()


def solve_levels(
    basis: FloatArray, values: FloatArray, weights: FloatArray, count: int, information: FloatArray | None = None
) -> Levels:
    """Return the most probable levels of every sector.

    ``basis``: shape (k, n), of the ordered pixels; those of background and amplitude first; ``values``, ``weights``:
    shape (n,); ``count``: number of sectors; ``information``: shape (k,), inverse variance of the levels about their
    mean, None where nothing is known of it.
    """
    k = len(basis)
    if information is None:
        information = np.full(k, NO_SPREAD)
    grams, right = _equations(basis, values, weights, count)
    own = _inverse(grams + np.diag(information))
    held = np.eye(k) - grams @ own
    mean = np.zeros(k)
    pull = np.einsum("ijk,ik->j", held, right)[:CENTRED]
    mean[:CENTRED] = np.linalg.lstsq((held @ grams).sum(axis=0)[:CENTRED, :CENTRED], pull, rcond=None)[0]
    departure = np.einsum("ijk,ik->ij", own, right - grams @ mean)
    return Levels(mean + departure, float((departure**2 @ information).sum()), own)


def levels_information(basis: FloatArray, values: FloatArray, weights: FloatArray, count: int) -> FloatArray:
    """Return the inverse variance of the sectors' levels about their mean, shape (k,); as for :func:`solve_levels`."""
    grams, right = _equations(basis, values, weights, count)
    inverse, vectors = _inverse_parts(grams)
    free = (vectors @ (inverse * (right[:, None] @ vectors)[:, 0])[:, :, None])[:, :, 0]
    return 1.0 / _spread(free, (vectors**2 @ inverse[:, :, None])[:, :, 0])


def _equations(basis: FloatArray, values: FloatArray, weights: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of the levels of every sector, shapes (m, k, k) and (m, k)."""
    rows = _by_sector(basis, count)
    weighted = rows * _by_sector(weights[None], count)
    return weighted @ rows.transpose(0, 2, 1), (weighted @ values.reshape(count, -1, 1))[:, :, 0]


def eliminated(
    jacobian: FloatArray, basis: FloatArray, weights: FloatArray, count: int, spread_information: FloatArray
) -> FloatArray:
    """Return the normal matrix (p, p) of the shared unknowns, the levels eliminated.

    ``jacobian``: shape (p, n); ``basis``: shape (k, n); ``weights``: shape (n,); others as for :func:`solve_levels`.
    Residuals from the most probable levels pull on nothing, so that the right side is that of the jacobian alone.
    """
    root = np.sqrt(weights)
    rows = jacobian * root
    inner_rows = _by_sector(basis * root, count)
    inner = inner_rows @ inner_rows.transpose(0, 2, 1)
    cross = _by_sector(rows, count) @ inner_rows.transpose(0, 2, 1)
    own = _inverse(inner + np.diag(spread_information))
    by_own = cross @ own
    p, k = len(jacobian), len(basis)
    taken = by_own.transpose(1, 0, 2).reshape(p, -1) @ cross.transpose(0, 2, 1).reshape(count * k, p)
    to_mean = (cross - by_own @ inner).sum(axis=0)[:, :CENTRED]
    mean = (inner - inner @ own @ inner).sum(axis=0)[:CENTRED, :CENTRED]
    inverse, vectors = _inverse_parts(mean)
    along = to_mean @ vectors
    return np.asarray(rows @ rows.T - taken - (along * inverse) @ along.T)


def _by_sector(rows: FloatArray, count: int) -> FloatArray:
    """Return rows (r, n) of ordered pixels by sector, shape (m, r, n / m)."""
    return rows.reshape(len(rows), count, -1).transpose(1, 0, 2)


def _inverse(matrices: FloatArray) -> FloatArray:
    """Return the inverse of positive definite matrices (m, k, k) whose rows have units of their own."""
    size = np.sqrt(np.maximum(np.einsum("mkk->mk", matrices), 1e-300))
    scales = size[:, :, None] * size[:, None, :]
    return np.asarray(np.linalg.inv(matrices / scales) / scales)


def _inverse_parts(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues and vectors of the pseudo-inverse of symmetric matrices (..., k, k)."""
    values, vectors = np.linalg.eigh(matrices)
    size = np.abs(values)
    determined = size > 1e-12 * size.max(axis=-1, keepdims=True)
    return np.divide(1.0, values, out=np.zeros_like(values), where=determined), vectors


def _spread(free: FloatArray, noise_variance: FloatArray) -> FloatArray:
    """Return the variance of the sectors' levels beyond noise, shape (k,), 0 if noise explains it.

    Weighted moments (DerSimonian and Laird, Controlled Clinical Trials 7, 177, 1986).
    """
    weight = 1.0 / np.maximum(noise_variance, 1e-100)
    total = weight.sum(axis=0)
    centred = np.arange(free.shape[1]) < CENTRED
    mean = np.where(centred, (weight * free).sum(axis=0) / total, 0.0)
    freedom = len(free) - centred
    excess = (weight * (free - mean) ** 2).sum(axis=0) - freedom
    # Three standard deviations of what noise makes of them.
    excess = np.where(excess > 3.0 * np.sqrt(2.0 * freedom), excess, 0.0)
    scale = total - np.where(centred, (weight**2).sum(axis=0) / total, 0.0)
    spread = np.maximum(excess, 0.0) / np.where(scale > 0.0, scale, np.inf)
    return np.asarray(np.maximum(spread, NO_SPREAD / total))


OF_SIDE = 0.02
"""Edge level up to which, and from one minus which, pixels show the noise of space and Earth; between, the edge's."""
LIT_SHARE = 0.1
"""A sector is lit whose light is at least such a share of the 0.95 quantile of all of them: a tenth is below every
cloud and above what twilight leaves; chosen."""


@dataclass(frozen=True)
class LightNoise(PixelNoise):
    """Noise of pixels across a limb, with the tails of the residuals from which it was estimated.

    Weights that follow the residuals of each look would change the levels, which are eliminated by them. Held between
    estimates, they leave a sum of squares, whose steps converge as those of Gauss and Newton.

    ``variance``: shape (n,), inverse weights; ``parts``: variance in space, on the Earth, and excess in the edge's
    middle; ``alike``: number of the Earth's pixels with one common error (clouds, coasts).
    """

    parts: tuple[float, float, float] = (1.0, 1.0, 0.0)
    alike: float = 1.0

    def weights(self, residuals: FloatArray) -> FloatArray:
        """Return the inverse variances, shape (n,)."""
        return np.asarray(1.0 / self.variance)

    def improbability(self, residuals: FloatArray) -> float:
        """Return the sum of the squared residuals (n,) in sigmas."""
        return float(np.sum(residuals * residuals / self.variance))

    def at(self, edge: FloatArray, counts: FloatArray, residuals: FloatArray) -> LightNoise:
        """Return the same noise of pixels at levels of the edge, shape (n,), means of so many each."""
        variance = _expected(edge, self.parts)
        ground = np.maximum(1.0 - self.parts[0] / variance, 0.0)
        pixels = PixelNoise(variance / counts, 1.0 + (self.alike - 1.0) * ground)
        return replace(self, variance=1.0 / pixels.weights(residuals))


def light_noise(
    basis: FloatArray, places: FloatArray, values: FloatArray, counts: FloatArray, sectors: int, rounding: float
) -> tuple[LightNoise, FloatArray]:
    """Return the noise of pixels, by the profile alone, and the inverse variance of the sectors' levels, shape (6,).

    An estimate that leans on earlier weights runs away where the ground is uneven: the faint rim of the edge then fits
    ever better.

    ``basis``: shape (6, n), of the ordered pixels; ``places``: shape (2, n), column and row; ``values``: shape (n,);
    ``counts``: shape (n,), numbers of pixels that each is the mean of; ``rounding``: smallest variance of a pixel.
    """
    edge = basis[1]
    # An edge that is displaced must not look like noise elsewhere: pixels in its middle weigh 25 times less.
    weights = counts / (1.0 + 100.0 * edge * (1.0 - edge))
    levels = solve_levels(basis, values, weights, sectors)
    residuals = values - levels.of_pixels(basis)
    light = np.abs(inner_levels(values, edge, levels.of_sector))
    brightest = np.sort(light)[int(0.95 * (len(light) - 1))]
    lit = np.repeat(light >= LIT_SHARE * brightest, len(values) // len(light))
    left = np.maximum(levels.left(basis, weights, 1.0 / counts), 0.1)
    squares, level = (residuals**2 * counts / left)[lit], edge[lit]
    floor = max(rounding, 1e-12 * float(np.mean(squares)) + 1e-300)
    space, earth = level < OF_SIDE, level > 1.0 - OF_SIDE
    of_space, of_earth = (mean_square(squares[there], squares) for there in (space, earth))
    # Space may have a single grey level, known to one level only; pixels just above must not determine the limb alone.
    line = (max(of_space, 1e-3 * of_earth, floor), max(of_earth, floor), 0.0)
    between, excess = ~(space | earth), 0.0
    if between.any():
        squares, level = squares[between], level[between]
        expected, share, excess = _expected(level, line), 4.0 * level * (1.0 - level), np.inf
        for _ in range(WEIGHINGS):
            beyond = weighed(squares, expected + excess * share) - expected
            excess = max(float((beyond @ share) / (share @ share)), 0.0)
    # Up to 0.05 the ground is uniform: noise and misfit leave 0.01 to 0.03 in clear air, clouds 0.07 to 0.35.
    alike, uneven = 1.0, 1.0 - (0.05 * float(light[light >= LIT_SHARE * brightest].mean())) ** 2 / line[1]
    ground = np.flatnonzero(lit & (edge > 1.0 - OF_SIDE))
    if uneven > 0.0 and len(ground):
        in_sigmas = residuals[ground] * np.sqrt(PixelNoise(line[1] / counts[ground]).weights(residuals[ground]))
        columns, rows = places[:, ground]
        alike += uneven * (correlated(columns, rows, in_sigmas, float(np.sqrt(np.mean(counts)))) - 1.0)
    found = LightNoise(np.ones(1), parts=(*line[:2], excess), alike=alike).at(edge, counts, residuals)
    if not lit.all():
        # A sector without light shows no limb.
        found = replace(found, variance=np.where(lit, found.variance, 1e9 * found.variance))
    return found, levels_information(basis, values, found.weights(residuals), sectors)


def inner_levels(values: FloatArray, edge: FloatArray, of_sector: FloatArray) -> FloatArray:
    """Return how much brighter than space sectors are inside the limb, shape (m,); parameters as of light_noise."""
    count = len(of_sector)
    inside = (edge > 1.0 - OF_SIDE).reshape(count, -1).astype(float)
    above = values.reshape(count, -1) - of_sector[:, :1]
    return np.asarray((inside * above).sum(axis=1) / np.maximum(inside.sum(axis=1), 1.0))


def _expected(edge: FloatArray, variance: tuple[float, float, float]) -> FloatArray:
    level = np.clip(edge, 0.0, 1.0)
    return np.asarray(variance[0] + (variance[1] - variance[0]) * level + variance[2] * 4.0 * level * (1.0 - level))
