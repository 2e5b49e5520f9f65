"""A chequered globe: two kinds of ground in squares between parallels and meridians, by turns.

The globe is cut into belts of latitude of equal height, and each belt into an even number of equal pieces of longitude,
as near to a square in its middle as whole numbers allow. Belts are counted from the south pole, pieces from 180 deg
eastwards; where the sum is even the ground is of the first kind.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray

EARTH_RADIUS_KM = 6371.0


def belt_count(square_km: float) -> int:
    """Return the number of belts."""
    return max(1, round(math.pi * EARTH_RADIUS_KM / square_km))


def piece_counts(square_km: float) -> FloatArray:
    """Return the number of pieces of every belt, from the south."""
    belts = belt_count(square_km)
    middle = ((np.arange(belts) + 0.5) / belts - 0.5) * math.pi
    return np.asarray(2.0 * np.maximum(1.0, np.rint(math.pi * EARTH_RADIUS_KM * np.cos(middle) / square_km)))


def first_squares(square_km: float, latitude_deg: FloatArray, longitude_deg: FloatArray) -> NDArray[np.bool_]:
    """Return whether places lie on squares of the first kind."""
    pieces = piece_counts(square_km)
    belt = np.clip(np.floor((latitude_deg / 180.0 + 0.5) * len(pieces)).astype(int), 0, len(pieces) - 1)
    count = pieces[belt]
    turn = np.mod(longitude_deg / 360.0 + 0.5, 1.0)
    number = belt + np.minimum(np.floor(turn * count), count - 1.0)
    return np.asarray(number % 2 == 0)
