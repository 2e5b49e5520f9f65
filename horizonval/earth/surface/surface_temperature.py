r"""Temperature of sea, land and snow by latitude and month: zonal means of a climate, not of a day.

Each is ``mean + swing cos(2 pi (month - warmest) / 12)``, with mean and swing linear in latitude between the figures
below; the swing is negative where the seasons are those of the south. The sea is warmest at the end of August (in the
south of February), land at the end of the third week of July. The figures are round numbers after published
climatologies: the sea after R. W. Reynolds et al., J. Climate 15, 1609 (2002), land after P. D. Jones et al., Rev.
Geophys. 37, 173 (1999), air near the ground standing for the ground's daily mean (over dry land by day and night
together the two differ by 1 to 3 K). Over the globe, land is 1 to 2.2 K warmer in every month than NOAA's mean of the
20th century (as it is today), the sea between 60 S and 60 N within 0.5 K of ERA5's 20.3 C (1991 to 2020).

The sea is never colder than -1.8 C: sea ice is left out, on which the ground would be up to 30 K colder in winter. Land
under snow is land, but never above 273.15 K. The daily swing of land is that of its skin, from 15 K in the dry belts to
nothing at the poles, the same all year; snow and sea have none. Mountains, deserts, currents and weather are left out:
one place and day differ from the zonal mean by 5 to 15 K on land, 2 to 4 K at sea.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

ICE_POINT_K = 273.15
FREEZING_SEA_K = 271.35
SEA_WARMEST_MONTH, LAND_WARMEST_MONTH = 8.5, 7.2
"""As :func:`horizonval.earth.atmosphere.climate.month_of` counts: 7.0 is the middle of July."""

_LATITUDE_DEG = (-90, -80, -70, -60, -50, -40, -30, -20, -10, 0, 10, 20, 30, 40, 50, 60, 70, 80, 90)
_SEA_C = (-1.8, -1.8, -1.5, 0.5, 7, 14, 20.5, 25, 27, 27.5, 28, 26, 22, 15.5, 9, 5.5, 1, -1.7, -1.8)
_SEA_SWING_K = (0, 0, -0.3, -1, -1.4, -2.3, -2.8, -1.9, -1, 0, 0.6, 1.8, 4, 5, 4, 3, 2, 0.3, 0)
_LAND_C = (-49, -42, -24, -6, 6, 12, 18, 22.5, 24.5, 25, 26.5, 25.5, 19.5, 12, 5, -1.5, -11, -17, -19)
_LAND_SWING_K = (-16, -15, -11, -6, -5, -5.5, -6, -3.8, -1.2, 0, 1.5, 4.5, 8.5, 12.5, 14, 17, 18, 17, 15)
_LAND_DAY_K = (0, 0, 1, 3, 6, 9, 12, 12, 7, 6, 8, 14, 15, 11, 8, 6, 3, 1, 0)


def sea_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the temperature of the sea [K].

    Parameters
    ----------
    latitude_deg : array_like
        -90 to 90, north positive.
    month : float
        0.5 to 12.5, 7.0 the middle of July.
    """
    return np.maximum(_yearly(latitude_deg, month, _SEA_C, _SEA_SWING_K, SEA_WARMEST_MONTH), FREEZING_SEA_K)


def land_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the daily mean temperature of land without snow [K]; parameters as :func:`sea_k`."""
    return _yearly(latitude_deg, month, _LAND_C, _LAND_SWING_K, LAND_WARMEST_MONTH)


def snow_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the temperature of land under snow [K]; parameters as :func:`sea_k`."""
    return np.minimum(land_k(latitude_deg, month), ICE_POINT_K)


def land_daily_swing_k(latitude_deg: ArrayLike) -> FloatArray:
    """Return how far the skin of land is above its daily mean at its warmest [K]."""
    return np.interp(np.asarray(latitude_deg, dtype=np.float64), _LATITUDE_DEG, _LAND_DAY_K)


def _yearly(
    latitude_deg: ArrayLike, month: float, mean: tuple[float, ...], swing: tuple[float, ...], warmest: float
) -> FloatArray:
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    season = math.cos(2.0 * math.pi * (month - warmest) / 12.0)
    return ICE_POINT_K + np.interp(latitude, _LATITUDE_DEG, mean) + season * np.interp(latitude, _LATITUDE_DEG, swing)
