"""Rotation of the Earth between celestial, mean-equinox and Earth-fixed axes, and directions.

UT1 is taken as UTC and the pole as fixed, as in :mod:`horizonval.geometry.sun_and_moon`: both need a measured table.
UT1 - UTC is below 0.9 s. It turns every celestial direction made from Earth-fixed measurements about the pole by up to
13.5 arcsec, truth and measurement equally, so that no difference of the two changes.

``teme`` (true equator, mean equinox) is the frame of two-line elements: one turn by the mean sidereal time of 1982
about the axis leads to Earth-fixed axes (Vallado et al., "Revisiting Spacetrack Report #3", AIAA 2006-6753, appendix
C). The way on to ``gcrs`` is IAU 2006/2000A; the pole of the elements' nutation of 1980 differs from it by some 0.05
arcsec.
"""

from __future__ import annotations

import math
from datetime import datetime

import erfa
import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.geometry import clock


def itrs_from_gcrs(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take celestial components to Earth-fixed ones."""
    tt, ut1 = clock.julian_tt(epoch_utc, seconds), clock.julian_ut1(epoch_utc, seconds)
    return np.asarray(erfa.c2t06a(*tt, *ut1, 0.0, 0.0), float)


def tod_from_gcrs(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take celestial components to true equator and equinox of date."""
    return np.asarray(erfa.pnm06a(*clock.julian_tt(epoch_utc, seconds)), float)


def itrs_from_teme(epoch_utc: datetime, seconds: ArrayLike = 0.0) -> FloatArray:
    """Return matrices, shape (..., 3, 3), that take components in the frame of two-line elements to Earth-fixed."""
    sidereal = np.asarray(erfa.gmst82(*clock.julian_ut1(epoch_utc, seconds)), float)
    cos, sin = np.cos(sidereal), np.sin(sidereal)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = [np.stack(row, axis=-1) for row in ((cos, sin, zero), (-sin, cos, zero), (zero, zero, one))]
    return np.stack(rows, axis=-2)


def turn(matrices: ArrayLike, vectors: ArrayLike) -> FloatArray:
    """Return ``matrix @ vector`` item by item, shape (..., 3)."""
    return np.einsum("...ij,...j->...i", np.asarray(matrices, float), np.asarray(vectors, float))


GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""Golden angle: points at equal steps of area, each turned on by it, are spread evenly (sunflower)."""


def angle_between(a: FloatArray, b: FloatArray) -> float:
    """Return the angle [rad] between two vectors of any length, shape (3,), accurate at 0 and at pi."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(np.dot(a, b)))


def off_axis_angle(d: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the angle [rad] of each direction, shape (..., 3), to the axis, accurate at every size.

    It comes from the arc tangent; the arc cosine would lose half the digits near the axis.
    """
    x, y, z = cross(np.moveaxis(d, -1, 0), axis)
    return np.asarray(np.arctan2(np.sqrt(x * x + y * y + z * z), d @ axis))


def cross(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the components of the cross products of vectors, shape (3, ...) each, or one of them (3,).

    The bits are those of :func:`numpy.cross`, without its checks of the arrays' layout.
    """
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def rotation_vector(matrix: FloatArray) -> FloatArray:
    """Return the rotation vector [rad], shape (3,), of a rotation matrix.

    The matrix's odd part gives it up to a right angle; larger turns use SciPy, which takes a hundred times as long.
    """
    odd = 0.5 * np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    sine, cosine = math.sqrt(float(odd @ odd)), 0.5 * (float(np.trace(matrix)) - 1.0)
    if cosine <= 0.0:
        return np.asarray(Rotation.from_matrix(matrix).as_rotvec())
    return odd if sine == 0.0 else odd * (math.atan2(sine, cosine) / sine)


def perpendicular(n: FloatArray) -> FloatArray:
    """Return a unit vector across ``n``, shape (3,): ``n`` times the coordinate axis that lies farthest from it.

    It is the first vector of :func:`tangent_basis`, negated.
    """
    helper = np.zeros(3)
    helper[np.argmin(np.abs(n))] = 1.0
    first = np.array(cross(n, helper))
    return np.asarray(first / np.linalg.norm(first))


def tangent_basis(axis: FloatArray) -> FloatArray:
    """Return two unit vectors, shape (3, 2), that make a right-handed triad (e1, e2, axis) with a unit vector."""
    helper = np.zeros(3)
    helper[np.argmin(np.abs(axis))] = 1.0
    e1 = np.array(cross(helper, axis))
    e1 /= np.linalg.norm(e1)
    return np.array([e1, cross(axis, e1)]).T.copy()


def fibonacci_sphere(count: int) -> FloatArray:
    """Return unit vectors spread evenly over the sphere (Fibonacci's spiral), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = k * np.pi * (1.0 + 5.0**0.5)
    ring = np.sqrt(1.0 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
