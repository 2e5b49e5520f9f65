"""Directions: the angle between two, vectors across one, and many spread evenly."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray

GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))
"""The angle between neighbours of a sunflower: points turned on by it, at equal steps of area, lie evenly."""


def angle_between(a: FloatArray, b: FloatArray) -> float:
    """Return the angle between two vectors, accurate at 0 and at pi.

    Parameters
    ----------
    a, b : ndarray, shape (3,)
        Of any length but zero.

    Returns
    -------
    angle : float
        [rad], from 0 to pi.

    Examples
    --------
    >>> angle_between(np.array([1.0, 0.0, 0.0]), np.array([1.0, 1e-9, 0.0]))
    1e-09
    """
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(np.dot(a, b)))


def off_axis_angle(d: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the angle [rad] of each direction, shape (..., 3), to the axis, accurate at every size.

    It comes from the arc tangent; the arc cosine would lose half the digits near the axis.
    """
    x, y, z = cross(np.moveaxis(d, -1, 0), axis)
    return np.asarray(np.arctan2(np.sqrt(x * x + y * y + z * z), d @ axis))


def cross(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the components of the cross products of vectors, shape (3, ...) each, or one of them (3,).

    What :func:`numpy.cross` says, to the bit, without the time that it takes to find out how its arrays lie.
    """
    ax, ay, az = a
    bx, by, bz = b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def rotation_vector(matrix: FloatArray) -> FloatArray:
    """Return the rotation vector [rad], shape (3,), of a rotation matrix by less than a right angle.

    Of larger turns it is SciPy's, at a hundred times the price: there the matrix's odd part is none to lean on.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3)
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
    """Return two unit vectors, shape (3, 2), that make a right-handed triad (e1, e2, axis).

    Parameters
    ----------
    axis : ndarray, shape (3,)
        Unit vector.
    """
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
