"""Temperature of sea, land, snow and ice by latitude, height and month: zonal means of a climate.

Each is ``mean + swing cos(2 pi (month - warmest) / 12)``, with mean and swing linear in latitude between the tabulated
values; the swing is negative in the southern seasons. The sea is warmest at the end of August (in the south of
February), land at the end of the third week of July. The values are rounded after published climatologies: the sea
after R. W. Reynolds et al., J. Climate 15, 1609 (2002), land after P. D. Jones et al., Rev. Geophys. 37, 173 (1999),
with air near the ground representing the ground's daily mean (over dry land they differ by 1 to 3 K). Globally, land is
1 to 2.2 K warmer in every month than NOAA's mean of the 20th century (as it is today), the sea between 60 S and 60 N
within 0.5 K of ERA5's 20.3 C (1991 to 2020).

The daily amplitude of land is that of its skin, from 15 K in the dry belts to 0 at the poles, the same all year; snow
and sea have none. Deserts are 3 K warmer than other land of their latitude and have a third more amplitude (A.
Sharifnezhadazizi et al., J. Appl. Meteor. Climatol. 58, 1279 (2019): daily ranges of MODIS skin temperature of 25 to 35
K in deserts). Land under snow is land, but never above 273.15 K. Higher land is colder, by :data:`LAND_LAPSE_K_M`: less
than free air, as high plateaus are warm (La Paz, Addis Ababa, Lhasa: 4 to 4.7 K/km below the zonal mean).

**Ice sheets**: ``T = a(month) - b(month) h + c(month) (1 - sin |latitude|)``, h the height of the surface. In the south
a, b and c are least-squares fits to monthly mean air temperatures of six stations (READER, J. Turner et al., J. Climate
17, 2890 (2004): Amundsen-Scott, Vostok, Byrd, Halley, McMurdo, Dumont d'Urville), with residuals of 3 K (Halley 5 K;
Byrd 5 to 8 K from March to October). In the north they are rounded after Summit's monthly means and the lapse rates of
K. Steffen and J. Box, J. Geophys. Res. 106, 33951 (2001). That snow is 1 to 2 K colder than the air 2 m above it in
winter is neglected.

**Sea ice** is interpolated from its edge to the pack: in the north between ice near the open sea and the Arctic Ocean
at 85 deg (I. G. Rigor, R. L. Colony, S. Martin, J. Climate 13, 896 (2000)), in the south between 58 and 77 deg
(McMurdo's monthly means). Leads in it are water of -1.8 C.

Mountains finer than a degree, currents and weather are neglected: single places and days differ by 5 to 15 K on land, 2
to 4 K at sea.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

ICE_POINT_K = 273.15
FREEZING_SEA_K = 271.35
SEA_WARMEST_MONTH, LAND_WARMEST_MONTH = 8.5, 7.2
"""As by :func:`horizonval.earth.atmosphere.climate.month_of`: 7.0 is the middle of July."""

_LATITUDE_DEG = (-90, -80, -70, -60, -50, -40, -30, -20, -10, 0, 10, 20, 30, 40, 50, 60, 70, 80, 90)
_SEA_C = (-1.8, -1.8, -1.5, 0.5, 7, 14, 20.5, 25, 27, 27.5, 28, 26, 22, 15.5, 9, 5.5, 1, -1.7, -1.8)
_SEA_SWING_K = (0, 0, -0.3, -1, -1.4, -2.3, -2.8, -1.9, -1, 0, 0.6, 1.8, 4, 5, 4, 3, 2, 0.3, 0)
_LAND_C = (-49, -42, -24, -6, 6, 12, 18, 22.5, 24.5, 25, 26.5, 25.5, 19.5, 12, 5, -1.5, -11, -17, -19)
_LAND_SWING_K = (-16, -15, -11, -6, -5, -5.5, -6, -3.8, -1.2, 0, 1.5, 4.5, 8.5, 12.5, 14, 17, 18, 17, 15)
_LAND_DAY_K = (0, 0, 1, 3, 6, 9, 12, 12, 7, 6, 8, 13, 14, 11, 8, 6, 3, 1, 0)

LAND_LAPSE_K_M = 4.5e-3
DESERT_WARMER_K, DESERT_SWING = 3.0, 4.0 / 3.0
ICE_SHEET_DEG = (55.0, 60.0)
"""Ice on land is as warm as land up to the first of these latitudes, as an ice sheet from the second on."""

_SOUTH_ICE_C = (-4.5, -10.4, -18.7, -20.1, -22.7, -25.0, -27.9, -27.7, -26.6, -19.4, -10.8, -4.6)
_SOUTH_ICE_K_KM = (8.2, 10.1, 11.6, 12.7, 12.1, 11.5, 11.2, 11.4, 11.4, 10.9, 9.4, 8.1)
_SOUTH_ICE_POLEWARD_K = (48.6, 80.0, 127.0, 87.8, 91.7, 108.3, 128.8, 120.7, 124.6, 75.6, 49.4, 38.1)
_NORTH_ICE_C = (-23.1, -24.1, -21.6, -14.3, -4.6, 0.6, 1.1, -1.4, -7.1, -15.4, -19.2, -21.1)
_NORTH_ICE_K_KM = (8.0, 8.0, 8.0, 7.5, 6.5, 5.5, 5.0, 5.5, 6.5, 7.0, 7.5, 8.0)
_NORTH_ICE_POLEWARD_K = (170, 170, 170, 150, 120, 90, 76, 90, 120, 150, 160, 170)

_ICE_EDGE_DEG = {"north": (55.0, 85.0), "south": (58.0, 77.0)}
_NORTH_SEA_ICE_C = (
    (-8, -9, -8, -4, -1, 0, 0, 0, -1, -2, -4, -7),
    (-31, -32, -31, -24, -10.5, -1.8, -0.2, -1.7, -9, -19, -27, -30),
)
_SOUTH_SEA_ICE_C = (
    (-0.5, -1, -2, -5, -8, -10, -11, -11, -9, -6, -3, -1),
    (-2.9, -9.5, -18.2, -20.7, -21.7, -23, -25.7, -26.1, -24.6, -18.9, -9.7, -3.4),
)


def sea_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the temperature of the sea [K]; ``month`` is 7.0 in the middle of July."""
    return np.maximum(_yearly(latitude_deg, month, _SEA_C, _SEA_SWING_K, SEA_WARMEST_MONTH), FREEZING_SEA_K)


def land_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the daily mean temperature of land without snow [K]."""
    return _yearly(latitude_deg, month, _LAND_C, _LAND_SWING_K, LAND_WARMEST_MONTH)


def snow_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the temperature of land under snow [K]."""
    return np.minimum(land_k(latitude_deg, month), ICE_POINT_K)


def land_daily_swing_k(latitude_deg: ArrayLike) -> FloatArray:
    """Return the amplitude of the daily variation of land's skin temperature [K]."""
    return np.interp(np.asarray(latitude_deg, dtype=np.float64), _LATITUDE_DEG, _LAND_DAY_K)


def desert_warmer_k(latitude_deg: ArrayLike) -> FloatArray:
    """Return the difference of a desert from other land in the daily mean [K]: none beyond 45 deg."""
    return DESERT_WARMER_K * np.clip((45.0 - np.abs(np.asarray(latitude_deg, dtype=np.float64))) / 10.0, 0.0, 1.0)


def ice_sheet(latitude_deg: ArrayLike, month: float) -> tuple[FloatArray, FloatArray]:
    """Return the temperature of an ice sheet at sea level [K], and its lapse rate [K/m].

    Glaciers of lower latitudes (:data:`ICE_SHEET_DEG`) are land under snow.
    """
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    poleward = 1.0 - np.sin(np.radians(np.abs(latitude)))

    def at(south: tuple[float, ...], north: tuple[float, ...]) -> FloatArray:
        return np.where(latitude < 0.0, _of_month(south, month), _of_month(north, month))

    sheet = ICE_POINT_K + at(_SOUTH_ICE_C, _NORTH_ICE_C) + poleward * at(_SOUTH_ICE_POLEWARD_K, _NORTH_ICE_POLEWARD_K)
    lapse = 1e-3 * at(_SOUTH_ICE_K_KM, _NORTH_ICE_K_KM)
    first, last = ICE_SHEET_DEG
    share = np.clip((np.abs(latitude) - first) / (last - first), 0.0, 1.0)
    glacier = snow_k(latitude, month)
    return glacier + share * (sheet - glacier), LAND_LAPSE_K_M + share * (lapse - LAND_LAPSE_K_M)


def sea_ice_k(latitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the temperature of the white surface of sea ice [K]."""
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    at = []
    for name, (edge, pack) in (("north", _NORTH_SEA_ICE_C), ("south", _SOUTH_SEA_ICE_C)):
        ends = _of_month(edge, month), _of_month(pack, month)
        at.append(np.interp(np.abs(latitude), _ICE_EDGE_DEG[name], ends))
    return ICE_POINT_K + np.where(latitude < 0.0, at[1], at[0])


def _of_month(values: tuple[float, ...], month: float) -> float:
    """Return the interpolation between values at the middles of the months, January first."""
    return float(np.interp(month, np.arange(1, 13), values, period=12.0))


def _yearly(
    latitude_deg: ArrayLike, month: float, mean: tuple[float, ...], swing: tuple[float, ...], warmest: float
) -> FloatArray:
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    season = math.cos(2.0 * math.pi * (month - warmest) / 12.0)
    return ICE_POINT_K + np.interp(latitude, _LATITUDE_DEG, mean) + season * np.interp(latitude, _LATITUDE_DEG, swing)
