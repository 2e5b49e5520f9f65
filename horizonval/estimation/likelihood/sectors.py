"""Unknowns along the limb: modes of its height, and sectors of azimuth with separate levels.

**Modes.** Along the limb the height differs from its mean by a random function of azimuth with the covariance ``K(phi)
= s^2 exp(-phi^2 / (2 l^2))`` (:mod:`horizonval.earth.limb_heights`). On ``m`` nodes ``K = V diag(w) V^T``, and
(Karhunen and Loeve) ::

    height(phi_j) = sum over modes of  z_i sqrt(w_i) V_ji,      z_i ~ N(0, 1)

The fit therefore knows which changes along the arc may not be taken for a tilt, and its covariance includes them.

A sphere fitted to the oblate Earth has a second relief. The limb of a planet of flattening ``f`` differs from a
sphere's by ``-f R (u . pole)^2``, with ``u`` from the centre to the point of the limb; its covariance over all poles
(:mod:`horizonval.earth.limb_heights`) is added to ``K``.

Modes that together hold less than :data:`LEFT_OUT` of the variance are left out; between nodes the modes are linear.

**Sectors.** In a sector the pixels are ``A (mu + d)`` with ``A`` of :func:`.light.light_basis`: background, amplitude,
and shading. ``mu`` is the mean of all sectors (the shading has none), and ``d`` a sector's difference with the prior
``N(0, T)``. ``T`` is the scatter of the sectors' levels beyond their noise: evenly lit limbs keep the precision of one
common level. All levels enter linearly, and are eliminated from the normal equations at every step (Schur's
complement), with ``G = A^T W A`` and ``H = (G + T^-1)^-1`` of each sector::

    N_xx = sum J^T W J - J^T W A H A^T W J,    N_xm = sum J^T W A (1 - H G),    N_mm = sum G - G H G
    N = N_xx - N_xm N_mm^-1 N_mx

``N`` is the information on the unknowns that all sectors share, with unknown levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, oblate_limbs

LEFT_OUT = 1e-3
"""Neglected share of the heights' variance: 3 % of their standard deviation, in waves too short to act as a tilt."""
NODES_PER_LENGTH = 2.0
"""Per correlation length: a Gaussian covariance sampled at half of its length loses 2e-4 of its variance between."""
MOST_NODES = 96
"""Largest number of nodes: a circle of 6.3 rad at 0.13 rad. Shorter reliefs are averaged over a node, as a tilt
does."""


OBLATE_LENGTH_RAD = 0.5
"""Correlation length for the nodes of an ellipsoid's limb, two waves round a circle."""


def relief_nodes(span_rad: float, shortest_rad: float) -> FloatArray:
    """Return azimuths [rad], shape (m,), from 0 to the span, close enough for a relief of that correlation length."""
    count = int(np.clip(np.ceil(NODES_PER_LENGTH * span_rad / shortest_rad) + 1, 3, MOST_NODES))
    return np.linspace(0.0, span_rad, count)


def relief_modes(
    span_rad: float, reliefs: tuple[Relief, ...], flattened_m: float = 0.0, rho_rad: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return nodes of azimuth [rad], shape (m,), and the modes there [m], shape (k, m).

    ``span_rad``: azimuth of the limb in view; ``reliefs``: independent contributions, none without modes;
    ``flattened_m``: flattening times radius of a planet fitted as a sphere, else 0; ``rho_rad``: its angular radius,
    for the flattening.
    """
    if not reliefs and flattened_m == 0.0:
        return np.array([0.0, span_rad]), np.zeros((0, 2))
    shortest = min([relief.correlation_rad for relief in reliefs] or [OBLATE_LENGTH_RAD])
    nodes = relief_nodes(span_rad, shortest)
    width = nodes[1] - nodes[0]
    apart = np.abs(nodes[:, None] - nodes[None, :])
    apart = np.minimum(apart, 2.0 * np.pi - apart)
    heights = np.zeros_like(apart)
    for relief in reliefs:
        # The mean over the width of a node, a box of variance width^2 / 12 at both ends, in place of single points.
        square = relief.correlation_rad**2
        wide = square + width**2 / 6.0
        heights += relief.sigma_m**2 * np.sqrt(square / wide) * np.exp(-0.5 * apart**2 / wide)
    return nodes, modes_of(heights + oblate_covariance(nodes, flattened_m, rho_rad))


def oblate_covariance(nodes: FloatArray, flattened_m: float, rho_rad: float) -> FloatArray:
    """Return what the flattening makes of a sphere's limb at azimuths (m,), all poles alike [m^2], shape (m, m)."""
    if flattened_m == 0.0:
        return np.zeros((len(nodes), len(nodes)))
    limbs = oblate_limbs(np.column_stack([np.cos(nodes), np.sin(nodes)]), rho_rad, flattened_m) / np.tan(rho_rad)
    limbs -= limbs.mean()
    return np.asarray(limbs @ limbs.T / limbs.shape[1])


def modes_of(covariance: FloatArray) -> FloatArray:
    """Return the modes, shape (k, m), of a covariance of heights (m, m)."""
    variance, vectors = np.linalg.eigh(covariance)
    variance, vectors = np.maximum(variance[::-1], 0.0), vectors[:, ::-1]
    kept = int(np.searchsorted(np.cumsum(variance), (1.0 - LEFT_OUT) * variance.sum())) + 1
    return np.asarray(np.sqrt(variance[:kept])[:, None] * vectors.T[:kept])


PIXELS_ALONG = 24
"""Smallest limb length of a sector [px]: its levels are then known ten times better than one pixel's noise."""
MOST_SECTORS = 48
WIDEST_RAD = 0.2
"""Largest sector, as an angle. Lens fall-off (cosine to the fourth) then departs by up to 3 % at 45 deg from a line
along the sector; over 24 pixels of a degree it is 17 %, which displaces the limb."""
CENTRED = 2
"""Number of levels that scatter about a mean: background and amplitude, not the shading."""
SIGNIFICANT = 3.0
"""Standard deviations by which the sectors' scatter must exceed what noise makes of them to be a scatter of theirs."""
SINGULAR = 1e-12
"""Eigenvalue, relative to the largest, below which a combination of levels is undetermined."""
NO_SPREAD = 1e-6
"""Smallest spread of sectors relative to the variance of the mean level; keeps the matrices regular."""


@dataclass(frozen=True)
class Sectors:
    """A division of pixels.

    ``order``: shape (n,), pixels by azimuth from the widest gap on; ``starts``: shape (m + 1,), first index of each
    sector in that order, and the end; ``azimuth``: shape (n,), of the ordered pixels [rad], rising from 0.
    """

    order: NDArray[np.intp]
    starts: NDArray[np.intp]
    azimuth: FloatArray

    @property
    def along(self) -> FloatArray:
        """Place of the ordered pixels in their sector, from -1/2 to 1/2 of its azimuth, shape (n,)."""
        borders = self.azimuth[np.minimum(self.starts, len(self.azimuth) - 1)]
        middle, width = 0.5 * (borders[1:] + borders[:-1]), np.maximum(np.diff(borders), 1e-300)
        counts = np.diff(self.starts)
        return np.asarray((self.azimuth - np.repeat(middle, counts)) / np.repeat(width, counts))


def sectors_of(azimuth: FloatArray, limb_px: int, limb_rad: float = 0.0) -> Sectors:
    """Return sectors of equally many pixels.

    ``azimuth``: shape (n,), about the nadir [rad]; ``limb_px``, ``limb_rad``: length of the limb in view, also as an
    angle.
    """
    count = max(limb_px // PIXELS_ALONG, int(limb_rad / WIDEST_RAD))
    return divided(azimuth, int(np.clip(count, 1, MOST_SECTORS)))


def divided(azimuth: FloatArray, count: int) -> Sectors:
    """Return so many sectors of equally many pixels, of azimuths (n,) [rad]."""
    order = np.argsort(azimuth, kind="stable")
    sorted_azimuth = azimuth[order]
    gaps = np.append(np.diff(sorted_azimuth), sorted_azimuth[0] + 2.0 * np.pi - sorted_azimuth[-1])
    first = (int(np.argmax(gaps)) + 1) % len(order)
    order = np.roll(order, -first)
    along = np.mod(azimuth[order] - azimuth[order[0]], 2.0 * np.pi)
    return Sectors(order, np.linspace(0, len(order), count + 1).astype(np.intp), along)


@dataclass(frozen=True)
class Levels:
    """Levels of the sectors.

    ``of_sector``: shape (m, k); ``spread_information``: shape (k,), inverse variance about their mean; ``penalty``: sum
    of squared departures over that variance.
    """

    of_sector: FloatArray
    spread_information: FloatArray
    penalty: float


def solve_levels(
    basis: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.intp],
    spread_information: FloatArray | None = None,
) -> Levels:
    """Return the most probable levels of every sector, their spread about the mean estimated with them or given.

    ``basis``: shape (k, n), of the ordered pixels; those of background and amplitude first; ``values``, ``weights``:
    shape (n,); ``starts``: shape (m + 1,); ``spread_information``: shape (k,).
    """
    k = len(basis)
    together = np.concatenate([basis, values[None]]) * np.sqrt(weights)
    all_grams = _grams(together, starts)
    grams, right = all_grams[:, :k, :k], all_grams[:, :k, k]
    if spread_information is None:
        inverse, vectors = _inverse_parts(grams)
        along = np.einsum("ikj,ik->ij", vectors, right)
        free = np.einsum("ijk,ik->ij", vectors, inverse * along)
        spread_information = 1.0 / _spread(free, np.einsum("ijk,ik->ij", vectors**2, inverse))
    information = spread_information
    own = np.linalg.inv(grams + np.diag(information))
    held = np.eye(k) - grams @ own
    mean = np.zeros(k)
    pull = np.einsum("ijk,ik->j", held, right)[:CENTRED]
    mean[:CENTRED] = np.linalg.lstsq((held @ grams).sum(axis=0)[:CENTRED, :CENTRED], pull, rcond=None)[0]
    departure = np.einsum("ijk,ik->ij", own, right - grams @ mean)
    return Levels(mean + departure, information, float((departure**2 @ information).sum()))


def _inverse_parts(matrices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues and vectors of the pseudo-inverse of symmetric matrices (..., k, k)."""
    values, vectors = np.linalg.eigh(matrices)
    size = np.abs(values)
    determined = size > SINGULAR * size.max(axis=-1, keepdims=True)
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
    excess = np.where(excess > SIGNIFICANT * np.sqrt(2.0 * freedom), excess, 0.0)
    scale = total - np.where(centred, (weight**2).sum(axis=0) / total, 0.0)
    spread = np.maximum(excess, 0.0) / np.where(scale > 0.0, scale, np.inf)
    return np.asarray(np.maximum(spread, NO_SPREAD / total))


def eliminated(
    jacobian: FloatArray,
    basis: FloatArray,
    residuals: FloatArray,
    weights: FloatArray,
    starts: NDArray[np.intp],
    levels: Levels,
) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix (p, p) and right side (p,) of the shared unknowns, the levels eliminated.

    ``jacobian``: shape (p, n); ``basis``: shape (k, n); ``residuals``, ``weights``: shape (n,), residuals from the most
    probable levels, so that these pull on nothing; ``starts``: shape (m + 1,).
    """
    p = len(jacobian)
    together = np.concatenate([jacobian, basis]) * np.sqrt(weights)
    grams = _grams(together, starts)
    cross, inner = grams[:, :p, p:], grams[:, p:, p:]
    own = np.linalg.inv(inner + np.diag(levels.spread_information))
    by_own = cross @ own
    shared = grams[:, :p, :p].sum(axis=0) - (by_own @ cross.transpose(0, 2, 1)).sum(axis=0)
    to_mean = (cross - by_own @ inner).sum(axis=0)[:, :CENTRED]
    mean = (inner - inner @ own @ inner).sum(axis=0)[:CENTRED, :CENTRED]
    inverse, vectors = _inverse_parts(mean)
    along = to_mean @ vectors
    return shared - (along * inverse) @ along.T, jacobian @ (weights * residuals)


def _grams(rows: FloatArray, starts: NDArray[np.intp]) -> FloatArray:
    """Return the products of all pairs of rows, summed over every sector, shape (m, r, r)."""
    grams = np.empty((len(starts) - 1, len(rows), len(rows)))
    for i, (first, last) in enumerate(pairwise(starts)):
        block = rows[:, first:last]
        grams[i] = block @ block.T
    return grams
