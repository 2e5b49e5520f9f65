"""The straight lines of a profile: their lowest points, and where the table has places."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

_BELOW_KM = (
    *(-400.0, -300.0, -220.0, -160.0, -120.0, -90.0, -65.0, -45.0, -30.0, -20.0),
    *(-14.0, -10.0, -7.0, -5.0, -3.5, -2.5, -1.5, -0.5),
)
_AROUND_GROUND_KM = (0.0, 0.5, 1.0, 1.4, 1.7, 2.0, 2.5)
_ABOVE_KM = (*range(3, 71), 73.0, 76.0, 80.0, 85.0, 90.0, 95.0)
HEIGHT_M = 1e3 * np.array([*_BELOW_KM, *_AROUND_GROUND_KM, *_ABOVE_KM])
"""Of the lines' lowest points. The air bends light so much that the ground seems to stand 1.4 to 2 km higher:
steps are fine there. Above the last is nothing."""

LATITUDE_DEG = np.linspace(-90.0, 90.0, 19)
MONTHS = np.arange(1.0, 13.0)
SUN_ZENITH_DEG = np.array([0.0, 25.0, 45.0, 60.0, 70.0, 76.0, 80.0, 83.0, 86.0, 88.0, 90.0, 92.0, 94.0, 96.0, 99.0])
SUN_AZIMUTH_DEG = np.array([0.0, 20.0, 45.0, 75.0, 105.0, 140.0, 180.0])
_KNOWN_HIGH = (0.0, 25.0, 45.0, 60.0, 69.0, 75.0, 79.0, 82.0, 84.5, 86.5)
_KNOWN_LOW = (*range(88, 94), 94.5, 96.0, 98.0, 100.0, 103.0)
KNOWN_ZENITH_DEG = np.array([*_KNOWN_HIGH, *_KNOWN_LOW])
KNOWN_AZIMUTH_DEG = np.array([0.0, 10.0, 20.0, 35.0, 50.0, 70.0, 90.0, 115.0, 145.0, 180.0])
"""Places of sunlit tables of one air that is known, whose errors no spread of airs hides: splines through them leave
0.1 % of a profile's shape up to 88 deg, 0.6 % (rms) from 88 to 95 deg, where those of the ensemble's tables leave 0.3
and 1.5 %."""


def edge_weights(height_m: FloatArray) -> FloatArray:
    """Return what heights count for when modes are chosen: kilometres of height from 30 km below the ground upwards.

    Deeper a profile is smooth, and a fit leaves its brightness free.
    """
    step = np.gradient(height_m) / 1e3
    return np.where(height_m >= -30e3, step, 0.0) * np.where(height_m < 0.0, 0.3, 1.0)
