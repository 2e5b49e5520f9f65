r"""The shipped profiles of a sunlit band as one camera sees them, and those of limbs without clouds.

The profiles (:mod:`horizonval.estimation.likelihood.templates`) are of lines by the Sun's angles at *their own* lowest
points. Lines of one camera side by side across the limb have their lowest points at other places: that of a height
``h`` lies the angle ::

    d = acos((R + h) / r) - acos(R / r)

further from an observer at the distance ``r`` from the Earth's centre than that of the ground's horizon, and the Sun
stands otherwise there. A deep disc seen from afar so has another slope than one seen from near.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.templates import LimbTemplates

EARTH_RADIUS_M = 6371008.8
ZENITHS_RAD = np.radians([0, 15, 30, 45, 55, 65, 70, 75, 80, 83, 85, 87, 88, 89, 90, 91, 92, 93, 94, 95, 96.0])
"""Beyond the last the profiles say too little, and there is too little light."""
CLOUDED = 0.75
"""Share of the ensemble's scenes that have clouds."""
FAINTEST = 0.05
"""Of the mean: what modes leave of it at least."""


def without_clouds(table: LimbTemplates) -> FloatArray:
    """Return the profiles of scenes without clouds, shape (A, B, h).

    A scene has clouds or not, with the shares ``q`` and ``1 - q``. The variable of unit variance that says so is
    ``-sqrt(q / (1 - q))`` without. Modes have one sign over all places: under a high Sun clouds are brighter, under a
    low one darker than what lies beneath, which the Sun on the air makes bright.
    """
    clear = table.mean
    for k in np.flatnonzero(np.array(table.mode_kinds) == "scene"):
        mode = table.modes[:, :, k]
        sign = 1.0 if mode[0].sum() > 0.0 else -1.0
        clear = clear - sign * math.sqrt(CLOUDED / (1.0 - CLOUDED)) * mode
    return np.asarray(np.maximum(clear, FAINTEST * table.mean))


def seen_from(table: LimbTemplates, values: FloatArray, altitude_m: float) -> FloatArray:
    """Return values (s, A, B, h) as the lines of one camera have them, by the Sun's angles at the ground's horizon."""
    zenith, azimuth = np.meshgrid(ZENITHS_RAD, table.axes[1], indexing="ij")
    up, ahead = np.cos(zenith)[..., None], (np.sin(zenith) * np.cos(azimuth))[..., None]
    side = (np.sin(zenith) * np.sin(azimuth))[..., None]
    away = EARTH_RADIUS_M + altitude_m
    turn = np.arccos(np.minimum((EARTH_RADIUS_M + table.height_m) / away, 1.0)) - math.acos(EARTH_RADIUS_M / away)
    there = np.arccos(np.clip(up * np.cos(turn) + ahead * np.sin(turn), -1.0, 1.0))
    level = np.arctan2(np.broadcast_to(side, there.shape), ahead * np.cos(turn) - up * np.sin(turn))
    (i, u), (j, v) = (_before(axis, x) for axis, x in zip(table.axes, (there, level), strict=True))
    h = np.arange(len(table.height_m))
    near = (1.0 - v) * values[:, i, j, h] + v * values[:, i, j + 1, h]
    far = (1.0 - v) * values[:, i + 1, j, h] + v * values[:, i + 1, j + 1, h]
    return np.asarray((1.0 - u) * near + u * far)


def _before(axis: FloatArray, x: FloatArray) -> tuple[np.ndarray, FloatArray]:
    i = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    return i, np.clip((x - axis[i]) / (axis[i + 1] - axis[i]), 0.0, 1.0)
