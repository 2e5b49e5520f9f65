"""Sectors of a limb, and the levels of light in them, which the fit's other unknowns do not need to know.

In a sector the pixels are ``A (mu + d)`` with ``A`` of :func:`.edge.light_basis`: background, amplitude, and shading.
``mu`` is the mean of all sectors (the shading has none), and ``d`` a sector's difference with the prior ``N(0, T)``.
``T`` is the scatter of the sectors' levels beyond their noise: evenly lit limbs keep the precision of one common level.
All levels enter linearly, and are eliminated from the normal equations (Schur's complement), with ``G = A^T W A`` and
``H = (G + T^-1)^-1`` of each sector::

    N_xx = sum J^T W J - J^T W A H A^T W J,    N_xm = sum J^T W A (1 - H G),    N_mm = sum G - G H G
    N = N_xx - N_xm N_mm^-1 N_mx

``N`` is the information on the unknowns that all sectors share, with unknown levels. Sectors have equally many pixels,
so that an array of n pixels is one of (m, n / m), and products of all sectors are one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray

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
    count = max(limb_px // PIXELS_ALONG, int(limb_rad / WIDEST_RAD))
    return divided(azimuth, int(np.clip(count, 1, MOST_SECTORS)))


def divided(azimuth: FloatArray, count: int) -> Sectors:
    """Return so many sectors of equally many pixels, of azimuths (n,) [rad]."""
    order, along = from_widest_gap(azimuth)
    count = min(count, len(order))
    size = len(order) // count
    kept = np.linspace(0.0, len(order) - 1.0, size * count).round().astype(np.intp)
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

    ``of_sector``: shape (m, k); ``spread_information``: shape (k,), inverse variance about their mean; ``penalty``: sum
    of squared departures over that variance; ``inverse``: shape (m, k, k), covariance of a sector's levels about it.
    """

    of_sector: FloatArray
    spread_information: FloatArray
    penalty: float
    inverse: FloatArray

    def spared(self, basis: FloatArray, weights: FloatArray, variance: FloatArray) -> FloatArray:
        """Return the mean squares of residuals over their variance, shape (n,), of which the levels have spent a part.

        ``weights``: shape (n,), with which the levels were found; ``variance``: shape (n,), of the pixels, in any unit.
        With the hat matrix ``h`` of a sector they are ``1 - 2 h_ii + sum_j h_ij^2 v_j / v_i``.
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
    basis: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    count: int,
    spread_information: FloatArray | None = None,
) -> Levels:
    """Return the most probable levels of every sector, their spread about the mean estimated with them or given.

    ``basis``: shape (k, n), of the ordered pixels; those of background and amplitude first; ``values``, ``weights``:
    shape (n,); ``count``: number of sectors; ``spread_information``: shape (k,).
    """
    k = len(basis)
    rows = _by_sector(basis * np.sqrt(weights), count)
    grams = rows @ rows.transpose(0, 2, 1)
    right = np.einsum("mkc,mc->mk", rows, (values * np.sqrt(weights)).reshape(count, -1))
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
    return Levels(mean + departure, information, float((departure**2 @ information).sum()), own)


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
    own = np.linalg.inv(inner + np.diag(spread_information))
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
