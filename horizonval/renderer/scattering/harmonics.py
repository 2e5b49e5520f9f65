r"""Real spherical harmonics that are even about the plane of zenith and Sun.

The diffuse field of a spherical shell is symmetric about the plane that holds the local vertical and the Sun, so that
only the cosine harmonics are needed. With the polar axis up, the azimuth counted from the Sun's side, c the cosine of
the polar angle theta and the orthonormal associated Legendre functions P_lm (without Condon and Shortley's phase)::

    Y_l0 = P_l0(c),        Y_lm = sqrt(2) P_lm(c) cos(m phi)

    P_mm = sqrt((2 m + 1) / (2 m)) sin(theta) P_(m-1)(m-1),          P_00 = sqrt(1 / (4 pi))
    P_lm = sqrt((4 l^2 - 1) / (l^2 - m^2)) (c P_(l-1)m - sqrt(((l-1)^2 - m^2) / (4 (l-1)^2 - 1)) P_(l-2)m)

The recurrences hold for numpy and Dr.Jit arrays alike. Source: Holmes and Featherstone, J. Geodesy 76, 279 (2002),
eqs. 11 to 13, rescaled to unit norm over the sphere.
"""

from __future__ import annotations

import math

from horizonval.renderer.types import Number


def pairs(degree: int) -> list[tuple[int, int]]:
    """Return ``(l, m)`` of all harmonics up to a degree, in the order they are stored."""
    return [(n, m) for n in range(degree + 1) for m in range(n + 1)]


def polar_parts(degree: int, cosine: Number, sine: Number) -> dict[tuple[int, int], Number]:
    """Return the harmonics without ``cos(m phi)``, by ``(l, m)``; ``sine >= 0``."""
    p: dict[tuple[int, int], Number] = {(0, 0): cosine * 0.0 + math.sqrt(0.25 / math.pi)}
    for m in range(1, degree + 1):
        p[m, m] = math.sqrt((2 * m + 1) / (2 * m)) * sine * p[m - 1, m - 1]
    for m in range(degree + 1):
        for n in range(m + 1, degree + 1):
            value = cosine * p[n - 1, m]
            if n - 2 >= m:
                value = value - math.sqrt(((n - 1) ** 2 - m**2) / (4 * (n - 1) ** 2 - 1)) * p[n - 2, m]
            p[n, m] = math.sqrt((4 * n**2 - 1) / (n**2 - m**2)) * value
    return {(n, m): v if m == 0 else math.sqrt(2.0) * v for (n, m), v in p.items()}


def cosines(degree: int, cosine: Number) -> list[Number]:
    """Return ``cos(m phi)`` for m from 0 to ``degree`` by Chebyshev's recurrence, from ``cos(phi)``."""
    out = [cosine * 0.0 + 1.0, cosine]
    while len(out) <= degree:
        out.append(2.0 * cosine * out[-1] - out[-2])
    return out[: degree + 1]
