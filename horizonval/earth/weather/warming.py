"""Sudden stratospheric warmings: their temperature change and their frequency.

The polar stratosphere warms by some tens of kelvin within days, while the mesosphere above it cools; the warm air is
off the pole at first. With the share of latitude c (0 at 45 deg, 1 from 70 deg on) and the profile v over log-pressure
height::

    dT = W v(z) [c + 0.35 sin(c pi / 2) (cos(phi) / cos(65 deg)) cos(lambda - lambda_0 + tilt z)],
    v(z) = exp(-((z - 33 km) / 9 km)^2 / 2) - 0.5 exp(-((z - 68 km) / 9 km)^2 / 2)

W is the mean over the polar cap at its warmest, near 8 hPa. Shape and rounded values follow the composites of V.
Limpasuvan et al., J. Climate 17, 2584 (2004).

In the north six winters of ten have a major warming (A. J. Charlton and L. M. Polvani, J. Climate 20, 449 (2007)),
which lasts some 20 of 120 days: one winter day in ten. In the south it is one spring in twenty. Random warmings have W
uniform from 25 to 55 K.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray

WARM_M, COLD_M, DEEP_M = 33e3, 68e3, 9e3
COLD_SHARE, WAVE_SHARE = 0.5, 0.35
TILT_PER_M = 0.45 / 7000.0
"""Phase per height of the planetary waves of :mod:`horizonval.earth.weather.field`."""
NORTH_DAYS, SOUTH_DAYS = 0.1, 0.003
DRAWN_K = (25.0, 55.0)


def winter_pole(month: float) -> int:
    """Return 1 from November to April (north), -1 from May to October."""
    return 1 if math.cos(2.0 * math.pi * (month - 1.5) / 12.0) > 0.0 else -1


def chance(month: float) -> float:
    """Return the probability of a warming on a day of a month; 0 outside the inner months of winter."""
    pole = winter_pole(month)
    middle = 1.5 if pole > 0 else 8.5
    inner = abs((month - middle + 6.0) % 12.0 - 6.0) <= 2.0
    return (NORTH_DAYS if pole > 0 else SOUTH_DAYS) if inner else 0.0


def warmer_k(
    amplitude_k: float,
    pole: int,
    origin_rad: float,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    height_m: FloatArray,
) -> FloatArray:
    """Return dT of the module text, shape (c, k), at places (c,) and log-pressure heights (k,).

    ``pole``: 1 north, -1 south. ``origin_rad``: longitude of the warm side at the ground.
    """
    x = np.clip((pole * latitude_deg - 45.0) / 25.0, 0.0, 1.0)
    cap = x * x * (3.0 - 2.0 * x)
    vertical = np.exp(-0.5 * ((height_m - WARM_M) / DEEP_M) ** 2)
    vertical = vertical - COLD_SHARE * np.exp(-0.5 * ((height_m - COLD_M) / DEEP_M) ** 2)
    # none at the pole itself, where longitudes meet
    ring = np.sin(0.5 * math.pi * cap) * np.cos(np.radians(latitude_deg)) / math.cos(math.radians(65.0))
    phase = np.radians(longitude_deg)[:, None] - origin_rad + TILT_PER_M * height_m
    return np.asarray(amplitude_k * vertical * (cap[:, None] + WAVE_SHARE * ring[:, None] * np.cos(phase)))
