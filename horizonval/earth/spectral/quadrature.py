"""Quadrature over spectral responses: exact weights for jagged responses, few nodes for smooth integrands.

A band integral has the form ``integral w(x) f(x) dx`` with a jagged known weight ``w`` (response times solar spectrum)
and a smooth costly ``f`` (radiance per unit of sunlight). Gauss's rule *for the weight* w uses n values of f and is
exact for polynomials f of degree 2 n - 1. The weight is sampled on a fine composite rule; Stieltjes' procedure gives
the recurrence of its orthogonal polynomials, and the eigenvalues of their Jacobi matrix are the nodes (Golub and
Welsch, Math. Comp. 23, 221 (1969); Gautschi, *Orthogonal Polynomials*, Oxford 2004, sections 2.2 and 3.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.linalg import eigh_tridiagonal

from horizonval.core.arrays import FloatArray


def composite_gauss(edges: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """Return points and weights, shape (len(edges) - 1, order), of Gauss-Legendre rules between edges."""
    x, w = _legendre(order)
    half = np.diff(edges)[:, None] / 2
    middle = (edges[:-1] + edges[1:])[:, None] / 2
    return middle + half * x, half * w


@cache
def _legendre(order: int) -> tuple[FloatArray, FloatArray]:
    x, w = np.polynomial.legendre.leggauss(order)
    for values in (x, w):
        values.flags.writeable = False
    return x, w


@dataclass(frozen=True)
class Orthonormal:
    """The orthonormal polynomials, of degrees 0 to n - 1, of a measure given as many weighted points.

    Attributes
    ----------
    middle, half : float
        ``t = (x - middle) / half`` lies in [-1, 1], where polynomials neither overflow nor vanish.
    diagonal, beside : ndarray, shape (n,)
        The Jacobi matrix: ``t p_k = beside[k+1] p_(k+1) + diagonal[k] p_k + beside[k] p_(k-1)``.
    basis : ndarray, shape (n, m)
        The polynomials at the points, orthonormal for ``share``.
    share : ndarray, shape (m,)
        The measure's weights, scaled to a sum of 1.
    total : float
        Sum of the weights.
    """

    middle: float
    half: float
    diagonal: FloatArray
    beside: FloatArray
    basis: FloatArray
    share: FloatArray
    total: float

    @classmethod
    def of(cls, points: FloatArray, weights: FloatArray, n: int) -> Orthonormal:
        """Return the polynomials of a measure by Stieltjes' procedure.

        ``points``, ``weights`` (m,): the measure; weights >= 0 with at least ``n`` above zero, m well above n (the
        procedure loses orthogonality as n nears m).
        """
        share = weights / weights.sum()
        inside = points[weights > 0]
        middle, half = (inside.max() + inside.min()) / 2, (inside.max() - inside.min()) / 2
        t = (points - middle) / half
        diagonal, beside, basis = np.zeros(n), np.zeros(n), np.empty((n, len(t)))
        previous, current = np.zeros_like(t), np.ones_like(t)
        for k in range(n):
            basis[k] = current
            weighted = share * t * current
            diagonal[k] = weighted @ current
            beside[k] = weighted @ previous
            following = (t - diagonal[k]) * current - beside[k] * previous
            previous, current = current, following / np.sqrt(share @ following**2)
        return cls(middle, half, diagonal, beside, basis, share, float(weights.sum()))

    def rule(self, n: int) -> tuple[FloatArray, FloatArray]:
        """Return the rising nodes, inside the range of the points, and the weights of Gauss's rule of n nodes."""
        nodes, vectors = eigh_tridiagonal(self.diagonal[:n], self.beside[1:n])
        return self.middle + self.half * nodes, self.total * vectors[0] ** 2

    def moments(self, values: FloatArray) -> FloatArray:
        """Return the expansion of a function, sampled at the points, in the polynomials, shape (n,)."""
        return self.basis @ (self.share * values)

    def smoothed(self, moments: FloatArray, nodes: FloatArray) -> FloatArray:
        """Return smoothed values (n,), >= 0, of a jagged function at the nodes of a rule; the integrand is smooth in
        it.

        The values are those of the least-squares polynomial of degree n - 1 through the function, given by its
        :meth:`moments`. Sums over the rule then have the right integrals of the function times any polynomial of that
        degree, whereas bare values would hit or miss its peaks by chance.
        """
        t = (nodes - self.middle) / self.half
        total = np.zeros_like(t)
        previous, current = np.zeros_like(t), np.ones_like(t)
        for k in range(len(nodes)):
            total += moments[k] * current
            if k + 1 < len(nodes):
                following = (t - self.diagonal[k]) * current - self.beside[k] * previous
                previous, current = current, following / self.beside[k + 1]
        return np.maximum(total, 0.0)
