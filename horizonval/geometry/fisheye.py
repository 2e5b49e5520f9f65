"""The fisheye lens in the plane: off-axis angles to image radii (:mod:`horizonval.spec.camera`) and back."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.spec.camera import image_radius, image_radius_slope

Coefficients = tuple[float, ...]
"""Four."""

_CELLS = 2048
_MOST_STEPS = 60


def off_axis(radius: FloatArray, k: Coefficients, limit_rad: float) -> FloatArray:
    """Return the off-axis angles [rad] that a fisheye images at some radii (in focal lengths).

    Each angle is bracketed by a table of the curve, which grows up to ``limit_rad``, and bettered by Newton steps that
    are halved towards the bracket where they would leave it. NaN for radii beyond that of ``limit_rad``.
    """
    table = np.linspace(0.0, limit_rad, _CELLS + 1)
    radii = image_radius(table, k)
    r = np.asarray(radius, float)
    good = (r >= 0.0) & (r <= radii[-1])
    valid_radius = np.where(good, r, 0.0)
    cell = np.clip(np.searchsorted(radii, valid_radius, side="right") - 1, 0, _CELLS - 1)
    low, high = table[cell], table[cell + 1]
    theta = 0.5 * (low + high)
    for _ in range(_MOST_STEPS):
        miss = image_radius(theta, k) - valid_radius
        low, high = np.where(miss <= 0.0, theta, low), np.where(miss >= 0.0, theta, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = theta - miss / image_radius_slope(theta, k)
        new = np.where((new >= low) & (new <= high), new, 0.5 * (low + high))
        done = bool(np.all(np.abs(new - theta) <= 4e-16 * (1.0 + theta)))
        theta = new
        if done:
            break
    return np.where(good, theta, np.nan)


def solid_angle_per_area(theta_rad: FloatArray, k: Coefficients) -> FloatArray:
    """Return ``dOmega / (dx dy)`` with x and y in focal lengths: ``sin(theta) / (theta_d theta_d')``; 1 on the axis."""
    area = image_radius(theta_rad, k) * image_radius_slope(theta_rad, k)
    return np.divide(np.sin(theta_rad), area, out=np.ones_like(theta_rad), where=theta_rad != 0.0)
