"""Zonal mean temperature by latitude, month and height, with the winters of both poles.

The blend of the AFGL climates is 17 K too warm in the lower stratosphere of the Antarctic from April to September,
compared with the real states of :mod:`horizonval.earth.weather.real_states`. Here the temperature is that of
NRLMSISE-00 (J. M. Picone et al., J. Geophys. Res. 107, 1468 (2002)), whose lower and middle atmosphere are the zonal
means of the Middle Atmosphere Program (J. J. Barnett and M. Corney, 1985, the source of CIRA-86 too) and, below 20 km,
of the National Meteorological Center; averaged over the hours of the day, by 10 deg, month and 2 km. It differs from
those states by 2 to 3 K.

The tropical tropopause of NRLMSISE-00 is 6 K too warm and it has no humidity. The AFGL blend therefore applies below a
height that falls from 14 km over the equator to the ground at the poles, with a transition over 8 km. Poleward of 68
deg in the south, and in the north in winter, the table applies down to the ground (from 55 deg on in part): there the
AFGL blend is 10 to 18 K too warm at 500 to 800 hPa, the table within 2 to 6 K. In northern summer the blend is the
better one. The inversion over the ice, 10 to 20 K in the lowest few hundred metres, is in neither. The mean pressure at
sea level is rounded: 1013 hPa with subtropical highs and the trough around the Antarctic.

**Cold poles** (:func:`with_cold_poles`): air that is a blend of climates by latitude and month takes the table's
temperature over the poles below :data:`FULL_TO_M`, with a transition over 4 km. Densities of the air do not change, and
with them sunlight and everything above; the pressure follows from the ideal gas law, and columns are hydrostatic to 6
%. The relative humidity does not change either: colder air is drier.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.tables import npz
from horizonval.earth.weather.hydrostatic import saturated_share

TABLE = "zonal_temperature.npz"
BLEND_FROM_M, BLEND_OVER_M = 14_000.0, 8_000.0
POLAR_DEG = (55.0, 68.0)
_SEA_LEVEL_DEG = (-90, -75, -65, -50, -30, 0, 30, 50, 60, 75, 90)
_SEA_LEVEL_HPA = (995, 990, 986, 1002, 1017, 1010, 1016, 1013, 1009, 1012, 1013)
"""Rounded zonal means; 1 hPa is 8 m of every height above."""


def table_temperature_k(latitude_deg: ArrayLike, month: float, altitude_m: FloatArray) -> FloatArray:
    """Return the table's temperature, shape (c, k), at latitudes (c,) and heights (k,) up to 100 km; trilinear."""
    table = npz(TABLE)
    values = np.asarray(table["temperature_k"], dtype=np.float64)
    place = (month - 1.0) % 12.0
    first = int(place)
    now = values[first % 12] * (1.0 - place + first) + values[(first + 1) % 12] * (place - first)
    latitudes = np.asarray(table["latitude_deg"], dtype=np.float64)
    x = np.clip((np.asarray(latitude_deg, dtype=np.float64) - latitudes[0]) / (latitudes[1] - latitudes[0]), 0.0, None)
    i = np.minimum(x.astype(np.intp), len(latitudes) - 2)
    w = (x - i)[:, None]
    levels = np.asarray(table["altitude_m"], dtype=np.float64)
    at = np.stack([np.interp(altitude_m, levels, row) for row in now])
    return np.asarray(at[i] * (1.0 - w) + at[i + 1] * w)


def temperature_k(
    latitude_deg: FloatArray, month: float, altitude_m: FloatArray, afgl_blend_k: FloatArray
) -> FloatArray:
    """Return the zonal mean temperature, shape (c, k), at latitudes (c,) and heights (k,).

    ``afgl_blend_k``: temperature of the AFGL climates there, shape (c, k).
    """
    start = BLEND_FROM_M * np.cos(np.radians(latitude_deg))[:, None] ** 2
    x = np.clip((altitude_m - start) / BLEND_OVER_M, 0.0, 1.0)
    share = x * x * (3.0 - 2.0 * x)
    share = share + (1.0 - share) * polar_share(latitude_deg, month)[:, None]
    return np.asarray(afgl_blend_k + share * (table_temperature_k(latitude_deg, month, altitude_m) - afgl_blend_k))


def polar_share(latitude_deg: FloatArray, month: float) -> FloatArray:
    """Return the table's share at the ground: all year in the south, by the winter's share in the north."""
    first, last = POLAR_DEG
    x = np.clip((np.abs(latitude_deg) - first) / (last - first), 0.0, 1.0)
    winter = 0.5 * (1.0 + math.cos(2.0 * math.pi * (month - 1.0) / 12.0))
    return np.asarray(x * x * (3.0 - 2.0 * x) * np.where(latitude_deg < 0.0, 1.0, winter))


def sea_level_pa(latitude_deg: ArrayLike) -> FloatArray:
    """Return the mean pressure at height 0."""
    return 100.0 * np.interp(np.asarray(latitude_deg, dtype=np.float64), _SEA_LEVEL_DEG, _SEA_LEVEL_HPA)


FULL_TO_M, NONE_FROM_M = 8e3, 12e3
"""Range around the tropopause over both poles: windows see the air below, bands of carbon dioxide that above."""


def with_cold_poles(state: GasState, latitude_deg: FloatArray, month: float) -> GasState:
    """Return columns with the cold troposphere of the poles.

    ``state``: blends of climates, arrays of shape (m, n). ``latitude_deg`` (m,). ``month`` as by
    :func:`horizonval.earth.atmosphere.climate.month_of`.
    """
    z, warm = state.altitude_m, state.temperature_k
    height = np.clip((NONE_FROM_M - z) / (NONE_FROM_M - FULL_TO_M), 0.0, 1.0)
    share = polar_share(latitude_deg, month)[:, None] * height
    kelvin = warm + share * (table_temperature_k(latitude_deg, month, z) - warm)
    pressure = state.pressure_pa * (kelvin / warm)
    drier = saturated_share(pressure, kelvin) / saturated_share(state.pressure_pa, warm)
    return replace(
        state, pressure_pa=pressure, temperature_k=kelvin, vmr={**state.vmr, "h2o": state.vmr["h2o"] * drier}
    )
