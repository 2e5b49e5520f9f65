"""Quadrature over spectral responses: exact weights for lumpy responses, few nodes for smooth integrands.

A band integral has the form ``integral w(x) f(x) dx`` with a jagged known weight ``w`` (response times solar spectrum)
and a smooth costly ``f`` (radiance per unit of sunlight). Gauss's rule *for the weight* w uses n values of f and is
exact for polynomials f of degree 2 n - 1. The weight is sampled on a fine composite rule; Stieltjes' procedure gives
the recurrence of its orthogonal polynomials, and the eigenvalues of their Jacobi matrix are the nodes (Golub and
Welsch, Math. Comp. 23, 221 (1969); Gautschi, *Orthogonal Polynomials*, Oxford 2004, sections 2.2 and 3.1).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import eigh_tridiagonal

from horizonval.earth.column import FloatArray


def composite_gauss(edges: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Return points and weights of Gauss-Legendre rules of ``order`` points on every interval between ``edges``.

    Returns
    -------
    points, weights : ndarray, shape (len(edges) - 1, order)
    """
    x, w = np.polynomial.legendre.leggauss(order)
    half = np.diff(edges)[:, None] / 2
    middle = (edges[:-1] + edges[1:])[:, None] / 2
    return middle + half * x, half * w


def smoothed(points: FloatArray, weights: FloatArray, values: FloatArray, nodes: FloatArray) -> FloatArray:
    """Return values at the nodes of Gauss's rule that stand for a jagged function of which f depends smoothly.

    The value of the least squares polynomial of degree n - 1 through ``values``, not the function itself: sums over the
    rule then have the right integrals of ``values`` times any polynomial of that degree, where the bare values at n
    points would hit or miss the peaks by chance. Never below zero.

    Parameters
    ----------
    points, weights, values : ndarray, shape (m,)
        The rule's measure and the function sampled on it, both >= 0.
    nodes : ndarray, shape (n,)
    """
    middle, half = (points.max() + points.min()) / 2, (points.max() - points.min()) / 2
    root, degree = np.sqrt(weights), len(nodes) - 1
    basis = np.polynomial.legendre.legvander((points - middle) / half, degree)
    coefficients = np.linalg.lstsq(basis * root[:, None], values * root, rcond=None)[0]
    return np.maximum(np.polynomial.legendre.legval((nodes - middle) / half, coefficients), 0.0)


def gauss_rule(points: FloatArray, weights: FloatArray, n: int) -> tuple[FloatArray, FloatArray]:
    """Return Gauss's n-point rule for a measure given as many weighted points.

    Parameters
    ----------
    points, weights : ndarray, shape (m,)
        The measure; weights >= 0 with at least ``n`` above zero, m well above n (Stieltjes' procedure loses
        orthogonality as n nears m).
    n : int

    Returns
    -------
    nodes : ndarray, shape (n,)
        Rising, inside the range of the points.
    node_weights : ndarray, shape (n,)
        Sum of ``weights`` in all.
    """
    used = weights > 0
    x, w = points[used], weights[used] / weights[used].sum()
    middle, half = (x.max() + x.min()) / 2, (x.max() - x.min()) / 2
    # On [-1, 1] the polynomials neither overflow nor vanish.
    t = (x - middle) / half
    alpha, beta = np.zeros(n), np.zeros(n)
    previous, current = np.zeros_like(t), np.ones_like(t)
    for k in range(n):
        alpha[k] = np.sum(w * t * current**2)
        beta[k] = 1.0 if k == 0 else np.sum(w * t * current * previous)
        following = (t - alpha[k]) * current - (beta[k] * previous if k else 0.0)
        norm = np.sqrt(np.sum(w * following**2))
        if k + 1 < n:
            previous, current = current, following / norm
    nodes, vectors = eigh_tridiagonal(alpha, beta[1:])
    return middle + half * nodes, weights.sum() * vectors[0] ** 2
