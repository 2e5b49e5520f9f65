"""Unknowns of no interest taken out of a system of normal equations, and symmetric matrices inverted.

With the information ``M = [[A, B], [B^T, D]]`` of unknowns that are kept and of others, ``A - B D^-1 B^T`` (Schur's
complement) is what is known of the first with the others free. It is found by taking out one unknown after the other::

    M' = M - m m^T / m_k,     m: column k of M

of positive definite matrices, which need no search for pivots. Libraries of linear algebra do it in less time, but
round by how many threads they run on; what is kept beside an image has to be the same bytes everywhere.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray


def without_last(information: FloatArray, kept: int) -> FloatArray:
    """Return the information on the first ``kept`` unknowns of a symmetric matrix with all others free.

    Parameters
    ----------
    information : ndarray, shape (N, N)
        Positive definite in what is taken out.
    kept : int

    Returns
    -------
    ndarray, shape (kept, kept)
    """
    left = information.copy()
    for k in range(len(left) - 1, kept - 1, -1):
        column = left[:k, k] / left[k, k]
        left[:k, :k] -= column[:, None] * left[k, :k]
    return left[:kept, :kept]


def inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a symmetric positive definite matrix, shape (N, N)."""
    count = len(matrix)
    both = np.zeros((2 * count, 2 * count))
    both[count:, count:] = matrix
    both[:count, count:] = both[count:, :count] = np.eye(count)
    found = -without_last(both, count)
    return 0.5 * (found + found.T)
