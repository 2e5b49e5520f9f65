"""The fisheye lens as a curve: how far from the principal point an off-axis angle is imaged.

With the angle ``theta`` from the boresight and coefficients ``k1 k2 k3 k4`` (OpenCV's fisheye model; J. Kannala and
S. S. Brandt, IEEE Trans. Pattern Analysis and Machine Intelligence 28, 1335, 2006, equation 6)::

    theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)     in focal lengths

The curve may be followed up to where it turns back, and never beyond half a turn. It stands in this room because the
field of view of a camera file and the focal length of its lens are tied by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray


def image_radius(theta_rad: ArrayLike, k: Sequence[float]) -> FloatArray:
    """Return ``theta_d``, in focal lengths, of off-axis angles."""
    theta = np.asarray(theta_rad, float)
    t2 = theta * theta
    k1, k2, k3, k4 = k
    return np.asarray(theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))))


def image_radius_slope(theta_rad: ArrayLike, k: Sequence[float]) -> FloatArray:
    """Return ``d theta_d / d theta``."""
    t2 = np.asarray(theta_rad, float) ** 2
    k1, k2, k3, k4 = k
    return np.asarray(1.0 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4))))


def turning_angle(k: Sequence[float]) -> float:
    """Return the angle [rad], at most pi, up to which ``theta_d`` grows: every smaller one has an image of its own."""
    k1, k2, k3, k4 = k
    roots = np.roots([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0])
    # A double zero can hide as a slightly complex pair; there the curve stands still.
    squares = roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0.0)]
    return min(math.pi, math.sqrt(float(squares.min()))) if squares.size else math.pi
