r"""How alike a random function is at two places, if it stays alike farther along parallels than along meridians.

At a place with the unit vectors ``u`` up, ``n`` north and the lengths ``l_n`` along the meridian, ``l_e`` along the
parallel, it varies as one whose covariance is normal with the matrix ::

    S = l_e^2 1 + (l_n^2 - l_e^2) n n^T

and between two places, ``d = u_i - u_j``, with ``S_m = (S_i + S_j) / 2``::

    c_ij = |S_i|^1/4 |S_j|^1/4 |S_m|^-1/2 exp(-d^T S_m^-1 d / 2)

(C. J. Paciorek and M. J. Schervish, Environmetrics 17, 483 (2006), equation 1), a covariance whatever the lengths are.
Where they are the same everywhere it is ``exp(-d^2 / (2 l^2))``. Both places' matrices have the same form, so that with
``a = (l_ei^2 + l_ej^2) / 2``, ``b_i = (l_ni^2 - l_ei^2) / 2``, ``g = n_i . n_j``, ``p = n_i . d``, ``q = n_j . d``::

    D = (1 + b_i / a) (1 + b_j / a) - b_i b_j g^2 / a^2,      |S_m| = a^3 D
    d^T S_m^-1 d = d^2 / a - (b_i (1 + b_j / a) p^2 - 2 b_i b_j g p q / a + b_j (1 + b_i / a) q^2) / (a^2 D)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

AT_POLE = 1e-9
"""Cosine of a latitude above which a place is the pole itself, where no direction is north."""


def everywhere(lengths_rad: ArrayLike, count: int) -> FloatArray:
    """Return lengths (K,) that are the same at so many places and in all directions, shape (count, K, 2)."""
    lengths = np.asarray(lengths_rad, dtype=np.float64)
    return np.ascontiguousarray(np.broadcast_to(lengths[None, :, None], (count, len(lengths), 2)))


def correlations(lengths_rad: FloatArray, up: FloatArray, pole: FloatArray) -> FloatArray:
    """Return how alike functions are at places.

    Parameters
    ----------
    lengths_rad : ndarray, shape (n, k, 2)
        Of every place and function, along the meridian and along the parallel; angles at the Earth's centre.
    up : ndarray, shape (n, 3)
        Unit vectors from the Earth's centre, in any frame.
    pole : ndarray, shape (3,)
        The Earth's axis in the same frame.

    Returns
    -------
    ndarray, shape (k, n, n)
        Distances are chords of the unit sphere.
    """
    square = np.moveaxis(np.asarray(lengths_rad, dtype=np.float64) ** 2, 1, 0)
    north = north_of(up, pole)
    parallel = square[..., 1]
    # at a pole only the parallel's length counts
    more = 0.5 * (square[..., 0] - parallel) * north.any(axis=1)
    apart = up[:, None] - up[None, :]
    p, q = np.einsum("ix,ijx->ij", north, apart), np.einsum("jx,ijx->ij", north, apart)
    g = north @ north.T
    a = 0.5 * (parallel[:, :, None] + parallel[:, None, :])
    b = more[:, :, None] / a
    c = more[:, None, :] / a
    d = (1.0 + b) * (1.0 + c) - b * c * g**2
    along = (b * (1.0 + c) * p**2 - 2.0 * b * c * g * p * q + c * (1.0 + b) * q**2) / d
    size = parallel**2 * (parallel + 2.0 * more)
    share = (size[:, :, None] * size[:, None, :]) ** 0.25 / np.sqrt(a**3 * d)
    return np.asarray(share * np.exp(-0.5 * (np.sum(apart**2, axis=-1) - along) / a))


def lengths_along(lengths_rad: FloatArray, up: FloatArray, level: FloatArray, pole: FloatArray) -> FloatArray:
    """Return the lengths, shape (n, k), along level directions (n, 3) at places; others as of :func:`correlations`."""
    northward = np.einsum("ij,ij->i", north_of(up, pole), level)[:, None] ** 2
    inverse = northward / lengths_rad[..., 0] ** 2 + (1.0 - northward) / lengths_rad[..., 1] ** 2
    return np.asarray(1.0 / np.sqrt(inverse))


def north_of(up: FloatArray, pole: FloatArray) -> FloatArray:
    """Return unit vectors towards the north, shape (n, 3), and nothing at a pole."""
    level = pole - (up @ pole)[:, None] * up
    size = np.linalg.norm(level, axis=1, keepdims=True)
    return np.asarray(np.where(size > AT_POLE, level / np.maximum(size, AT_POLE), 0.0))
