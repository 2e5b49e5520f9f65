"""Distortion of normalised image coordinates: Brown-Conrady, rational and thin prism, and its inverse.

With OpenCV's coefficients ``k1 k2 p1 p2 k3`` and ``r2 = x^2 + y^2``::

    x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)
    y' = y (1 + k1 r2 + k2 r2^2 + k3 r2^3) + p1 (r2 + 2 y^2) + 2 p2 x y

It is the gradient of a potential, so its Jacobian is symmetric; where that is positive definite the model is one to
one. With twelve coefficients, ``k4 k5 k6`` and ``s1 s2 s3 s4`` follow: the factor of x and y is divided by ``1 + k4 r2
+ k5 r2^2 + k6 r2^3``, and ``s1 r2 + s2 r2^2`` is added to x', ``s3 r2 + s4 r2^2`` to y'. Then the symmetric part of the
Jacobian must be positive definite, which makes the model one to one as well. Points beyond the largest such disc are
refused, never guessed: there the polynomial folds back over the image.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray

Coefficients = tuple[float, ...]
"""Five, or twelve with rational and thin prism terms."""


def distort(coefficients: Coefficients, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    if not any(coefficients):
        return x, y
    k1, k2, p1, p2, k3 = coefficients[:5]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    if len(coefficients) > 5:
        k4, k5, k6, s1, s2, s3, s4 = coefficients[5:]
        radial = radial / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        xp, yp = r2 * (s1 + r2 * s2), r2 * (s3 + r2 * s4)
        tangential = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return x * radial + tangential[0] + xp, y * radial + tangential[1] + yp
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def jacobian(
    coefficients: Coefficients, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return ``dx'/dx``, ``dx'/dy``, ``dy'/dx`` and ``dy'/dy``."""
    k1, k2, p1, p2, k3 = coefficients[:5]
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    if len(coefficients) > 5:
        k4, k5, k6, s1, s2, s3, s4 = coefficients[5:]
        below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
        radial = radial / below
        slope = (slope - radial * 2.0 * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / below
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    if len(coefficients) > 5:
        xp, yp = 2 * s1 + 4 * s2 * r2, 2 * s3 + 4 * s4 * r2
        return xx + xp * x, xy + xp * y, xy + yp * x, yy + yp * y
    return xx, xy, xy, yy


def denominator(coefficients: Coefficients, radius: float) -> float:
    """Return what the radial polynomial is divided by at a radius; 1 for five coefficients."""
    if len(coefficients) == 5:
        return 1.0
    k4, k5, k6 = coefficients[5:8]
    r2 = radius * radius
    return 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))


@lru_cache(maxsize=256)
def invertible_radius(coefficients: Coefficients) -> float:
    """Return the largest ``r`` such that the Jacobian is positive definite on the open disc ``sqrt(x^2 + y^2) < r``.

    A gradient map whose Jacobian is positive definite on a convex set is one to one there (strict convexity of its
    potential), so this disc can be undistorted without ambiguity. On a ray at angle ``t`` the determinant is a
    polynomial in ``r``; its first positive zero is found for 720 angles and bettered by golden section around the
    smallest. Infinite without distortion. With twelve coefficients, see :func:`_rational_radius`.
    """
    if not any(coefficients):
        return math.inf
    if len(coefficients) > 5:
        return _rational_radius(coefficients)
    k1, k2, p1, p2, k3 = coefficients

    def first_zero(angle: float) -> float:
        c, s = math.cos(angle), math.sin(angle)
        xx: FloatArray = np.array(
            [k3 * (1 + 6 * c * c), 0, k2 * (1 + 4 * c * c), 0, k1 * (1 + 2 * c * c), 2 * p1 * s + 6 * p2 * c, 1]
        )
        yy: FloatArray = np.array(
            [k3 * (1 + 6 * s * s), 0, k2 * (1 + 4 * s * s), 0, k1 * (1 + 2 * s * s), 6 * p1 * s + 2 * p2 * c, 1]
        )
        xy: FloatArray = np.array([6 * k3 * c * s, 0, 4 * k2 * c * s, 0, 2 * k1 * c * s, 2 * p1 * c + 2 * p2 * s, 0])
        determinant: FloatArray = np.polysub(np.polymul(xx, yy), np.polymul(xy, xy))
        roots = np.roots(determinant)
        real = roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0)]
        return float(real.min()) if real.size else math.inf

    step = math.pi / 360
    angles = step * np.arange(720)
    radii = [first_zero(float(t)) for t in angles]
    best = float(angles[int(np.argmin(radii))])
    smallest = min(radii)
    if math.isfinite(smallest):
        # Loaded here: it takes as long as all the rest of a small command.
        from scipy.optimize import minimize_scalar

        minimum = minimize_scalar(first_zero, bounds=(best - step, best + step), method="bounded")
        smallest = min(smallest, float(minimum.fun))
    # A double zero of the determinant can hide as a slightly complex pair; the margin keeps to the safe side of it.
    return smallest * (1.0 - 1e-9)


_WIDEST_RAD = math.radians(89.99)


def _rational_radius(coefficients: Coefficients) -> float:
    """Return the radius of the disc in which the Jacobian's symmetric part is positive definite.

    Circles are examined in 720 directions: evenly spaced in the field angle up to the first pole of the rational term,
    and close together near its complex poles. The first circle that fails is refined by bisection.
    """
    k4, k5, k6 = coefficients[5:8]
    poles = np.roots(np.array([k6, k5, k4, 1.0]))
    real = poles.real[(np.abs(poles.imag) < 1e-6 * np.abs(poles)) & (poles.real > 0.0)]
    largest = min(math.tan(_WIDEST_RAD), math.sqrt(float(real.min())) if real.size else math.inf)
    squares = [np.linspace(0.0, math.atan(largest), 4097)[1:]]
    for pole in poles[poles.real > 0.0]:
        near = pole.real + abs(pole.imag) * np.linspace(-4.0, 4.0, 33)
        squares.append(np.arctan(np.sqrt(near[near > 0.0])))
    radii = np.tan(np.sort(np.concatenate(squares)))
    radii = radii[radii <= largest]
    angles = np.linspace(0.0, 2.0 * math.pi, 720, endpoint=False)
    cosines, sines = np.cos(angles), np.sin(angles)

    def good(r: FloatArray) -> NDArray[np.bool_]:
        with np.errstate(divide="ignore", invalid="ignore"):
            xx, xy, yx, yy = jacobian(coefficients, r[:, None] * cosines, r[:, None] * sines)
        return np.asarray(((xx > 0.0) & (xx * yy > (0.5 * (xy + yx)) ** 2)).all(axis=1))

    for start in range(0, len(radii), 512):
        bad = np.flatnonzero(~good(radii[start : start + 512]))
        if bad.size:
            first = start + int(bad[0])
            low, high = (float(radii[first - 1]) if first else 0.0), float(radii[first])
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if good(np.array([middle]))[0] else (low, middle)
            # Between two directions the disc may be smaller by half the square of their distance.
            return low * (1.0 - 1e-4)
    return math.inf if largest == math.tan(_WIDEST_RAD) else largest


def _radial_table(coefficients: Coefficients, largest: float, limit: float) -> tuple[FloatArray, FloatArray]:
    """Return radii within the disc and what the radial terms alone make of them, which rises."""
    k1, k2, _, _, k3 = coefficients[:5]
    if len(coefficients) == 5:
        grid = np.linspace(0.0, min(limit, 4.0 * largest + 1.0), 1025)
        return grid, np.maximum.accumulate(grid * (1 + grid**2 * (k1 + grid**2 * (k2 + grid**2 * k3))))
    # A rational term may flatten: large radii have small images.
    grid = np.tan(np.linspace(0.0, min(math.atan(limit), _WIDEST_RAD), 4097))
    radial = distort((k1, k2, 0.0, 0.0, k3, *coefficients[5:8], 0.0, 0.0, 0.0, 0.0), grid, np.zeros_like(grid))[0]
    return grid, np.maximum.accumulate(radial)


def undistort(coefficients: Coefficients, xd: FloatArray, yd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the undistorted coordinates; NaN where no point of the invertible disc is distorted to ``(xd, yd)``."""
    if not any(coefficients):
        return xd, yd
    limit = invertible_radius(coefficients)
    rd = np.hypot(xd, yd)
    # The radial part alone, inverted by a table, is the start: inside the disc and close to the answer.
    largest = float(rd.max(initial=0.0, where=np.isfinite(rd)))
    grid, table = _radial_table(coefficients, largest, limit)
    start = np.interp(rd, table, grid)
    factor = np.divide(start, rd, out=np.ones_like(rd), where=rd > 0)
    x, y = xd * factor, yd * factor

    def residual(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        fx, fy = distort(coefficients, x, y)
        return fx - xd, fy - yd, np.hypot(fx - xd, fy - yd)

    ex, ey, size = residual(x, y)
    damping = np.ones_like(size)
    for _ in range(80):
        xx, xy, yx, yy = jacobian(coefficients, x, y)
        det = xx * yy - xy * yx
        with np.errstate(divide="ignore", invalid="ignore"):
            dx, dy = (yy * ex - xy * ey) / det, (xx * ey - yx * ex) / det
            nx, ny = x - damping * dx, y - damping * dy
            nex, ney, new_size = residual(nx, ny)
            better = (new_size < size) & (np.hypot(nx, ny) <= limit)
        x, y = np.where(better, nx, x), np.where(better, ny, y)
        ex, ey, size = np.where(better, nex, ex), np.where(better, ney, ey), np.where(better, new_size, size)
        damping = np.where(better, np.minimum(1.0, 2 * damping), damping / 2)
        # Rounding leaves 1e-16; a point that no longer gains below 1e-13 is there, one stuck above it has no inverse.
        if not np.any((damping > 1e-6) & ((size > 1e-13) | (better & (size > 4e-16)))):
            break
    good = (size <= 1e-12 * (1 + rd)) & (np.hypot(x, y) < limit)
    return np.where(good, x, np.nan), np.where(good, y, np.nan)
