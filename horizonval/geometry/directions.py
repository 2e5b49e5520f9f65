"""Directions: the angle between two, vectors across one, and many spread evenly."""

from __future__ import annotations

import math

import numpy as np

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
    across = np.linalg.norm(np.cross(d, axis), axis=-1)
    return np.asarray(np.arctan2(across, d @ axis))


def perpendicular(n: FloatArray) -> FloatArray:
    """Return a unit vector across ``n``, shape (3,): ``n`` times the coordinate axis that lies farthest from it.

    It is the first vector of :func:`tangent_basis`, negated.
    """
    first = np.cross(n, np.eye(3)[int(np.argmin(np.abs(n)))])
    first /= np.linalg.norm(first)
    return np.asarray(first)


def tangent_basis(axis: FloatArray) -> FloatArray:
    """Return two unit vectors, shape (3, 2), that make a right-handed triad (e1, e2, axis).

    Parameters
    ----------
    axis : ndarray, shape (3,)
        Unit vector.
    """
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    e1 = np.cross(helper, axis)
    e1 /= np.linalg.norm(e1)
    return np.column_stack([e1, np.cross(axis, e1)])


def fibonacci_sphere(count: int) -> FloatArray:
    """Return unit vectors spread evenly over the sphere (Fibonacci's spiral), shape (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    turn = k * np.pi * (1.0 + 5.0**0.5)
    ring = np.sqrt(1.0 - z**2)
    return np.column_stack([ring * np.cos(turn), ring * np.sin(turn), z])
