"""Where a limb profile has its horizon: plateau, half-plateau height, height of the steepest fall.

The plateau is the largest radiance between 10 and 24 km where that reaches 0.6 of the radiance 10 km below the hard
horizon: there the air itself is the horizon. Elsewhere it is the radiance 10 km below: the ground, seen through a
window. The half height is the largest at which the profile has half of its plateau; the steepest fall is looked for
above the ground. Between its rays a profile is a monotone cubic, for its slope a spline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

FloatArray = NDArray[np.float64]

PLATEAU_M = (10e3, 24e3)
BELOW_M = -10e3
OPAQUE = 0.6
_FINE_M = 50.0
_BISECTIONS = 30


@dataclass(frozen=True)
class Located:
    """Plateau [W m-2 sr-1], heights [m] and whether the air is the horizon, each of the profiles' shape (...)."""

    plateau: FloatArray
    half_m: FloatArray
    gradient_m: FloatArray
    opaque: NDArray[np.bool_]


def locate(height_m: ArrayLike, radiance: ArrayLike) -> Located:
    """Return the horizon of profiles.

    Parameters
    ----------
    height_m : array_like, shape (n,)
        Rising, from -10 km or below to where nothing shines any more.
    radiance : array_like, shape (..., n)
    """
    height, radiance = np.asarray(height_m, dtype=np.float64), np.asarray(radiance, dtype=np.float64)
    plateau, opaque = _plateau(height, radiance)
    return Located(plateau, highest_crossing(height, radiance, 0.5 * plateau), _steepest(height, radiance), opaque)


def highest_crossing(height_m: ArrayLike, radiance: ArrayLike, level: ArrayLike) -> FloatArray:
    """Return the largest height [m], shape (...), at which profiles (..., n) have radiances of shape (...).

    The lowest or the highest height of the rays where a profile stays below or above its level.
    """
    height, radiance = np.asarray(height_m, dtype=np.float64), np.asarray(radiance, dtype=np.float64)
    profile = radiance.reshape(-1, len(height))
    goal = np.broadcast_to(np.asarray(level, dtype=np.float64), radiance.shape[:-1]).reshape(-1)
    above = profile >= goal[:, None]
    # Between this ray, the last at or above its level, and the next the profile falls through it, once.
    last = np.where(above.any(axis=1), len(height) - 1 - np.argmax(above[:, ::-1], axis=1), 0)
    piece = np.minimum(last, len(height) - 2)
    cubic = PchipInterpolator(height, profile, axis=1).c[:, piece, np.arange(len(profile))]
    low, high = np.zeros(len(profile)), height[piece + 1] - height[piece]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        reached = ((cubic[0] * middle + cubic[1]) * middle + cubic[2]) * middle + cubic[3] >= goal
        low, high = np.where(reached, middle, low), np.where(reached, high, middle)
    return (height[piece] + 0.5 * (low + high)).reshape(radiance.shape[:-1])


def _plateau(height: FloatArray, radiance: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    curve = PchipInterpolator(height, radiance, axis=-1)
    inside = curve(np.arange(PLATEAU_M[0], PLATEAU_M[1] + 1.0, 250.0)).max(axis=-1)
    below = np.asarray(curve(BELOW_M))
    opaque = inside >= OPAQUE * below
    return np.where(opaque, inside, below), opaque


def _steepest(height: FloatArray, radiance: FloatArray) -> FloatArray:
    """Height of the steepest fall above the ground, to 50 m; there the profile is smooth, and so is its spline."""
    above = height > 0.0
    fall = CubicSpline(height[above], radiance[..., above], axis=-1).derivative()
    fine = np.arange(_FINE_M, height[-1], _FINE_M)
    return fine[np.argmin(fall(fine), axis=-1)]
