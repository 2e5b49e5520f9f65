"""Where limb profiles have their horizon: half of the plateau, steepest fall, a fixed radiance.

The first two are those of a frame's truth (:mod:`horizonval.truth.infrared_horizon.locators`), for many profiles at
once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.truth.infrared_horizon import locators

_BISECTIONS = 30


@dataclass(frozen=True)
class Horizon:
    """The horizon in profiles of shape (..., n).

    Attributes
    ----------
    kind : "opaque", "window" or "mixed"
        Whether the air is the horizon, or the ground seen through it; "mixed" where the profiles differ.
    plateau : ndarray, shape (...)
        W m-2 sr-1.
    half_m, gradient_m : ndarray, shape (...)
        Height of half the plateau, and of the steepest fall.
    """

    kind: str
    plateau: FloatArray
    half_m: FloatArray
    gradient_m: FloatArray


def locate(height_m: ArrayLike, radiance: ArrayLike) -> Horizon:
    """Return the horizon of profiles.

    Parameters
    ----------
    height_m : array_like, shape (n,)
        Rising, from below ground (-10 km among them) to where nothing shines any more.
    radiance : array_like, shape (..., n)
        Whether the air is the horizon is decided for all profiles of the same leading index together.
    """
    height, radiance = np.asarray(height_m, dtype=np.float64), np.asarray(radiance, dtype=np.float64)
    shape = radiance.shape[:-1]
    blocks = radiance.reshape(shape[0], -1, len(height))
    below = int(np.argmin(np.abs(height - locators.GROUND_RAY_M)))
    above = height > 0.0
    found = [locators.locate(height[above], block[:, above], block[:, below]) for block in blocks]
    kinds = {one.kind for one in found}
    return Horizon(
        kind=kinds.pop() if len(kinds) == 1 else "mixed",
        plateau=np.stack([one.plateau for one in found]).reshape(shape),
        half_m=np.stack([one.half_plateau_m for one in found]).reshape(shape),
        gradient_m=np.stack([one.maximum_gradient_m for one in found]).reshape(shape),
    )


def highest_crossing(height_m: ArrayLike, radiance: ArrayLike, level: ArrayLike) -> FloatArray:
    """Return the largest height [m], shape (...), at which profiles (..., n) have radiances of shape (...).

    The lowest or the highest height of the rays where a profile stays below or above its level. Between its rays a
    profile is a monotone cubic.
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
    # Never above its level: the lowest ray, not the next.
    high = np.where(above.any(axis=1), high, 0.0)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        reached = ((cubic[0] * middle + cubic[1]) * middle + cubic[2]) * middle + cubic[3] >= goal
        low, high = np.where(reached, middle, low), np.where(reached, high, middle)
    return (height[piece] + 0.5 * (low + high)).reshape(radiance.shape[:-1])
