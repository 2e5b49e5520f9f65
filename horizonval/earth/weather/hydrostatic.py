"""Pressure over geodetic height from temperature, in hydrostatic balance, and saturation of water vapour.

With the virtual temperature ``T_v = T (1 + 0.378 x)`` of moist air (x: mole fraction of water vapour)::

    ln p(z) = ln p_0 - int_0^z  M g(phi, z') / (R T_v) dz'

T_v is linear in height between levels, for which the integral of 1 / T_v is exact. Gravity falls with height as
``g(phi, 0) (r / (r + z))^2`` with a radius r that depends on latitude (R. J. List, Smithsonian Meteorological Tables,
1951, eqs. 1 and 2 of table 168)::

    g = 9.80616 (1 - 0.0026373 cos 2 phi + 0.0000059 cos^2 2 phi),
    r = 2 g / (3.085462e-6 + 2.27e-9 cos 2 phi)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

MOLAR_MASS_KG, GAS_CONSTANT = 28.9644e-3, 8.314462618
LIGHTER_WATER = 0.378
"""1 - M_water / M_air."""


def gravity_m_s2(latitude_deg: ArrayLike, altitude_m: ArrayLike) -> FloatArray:
    """Return gravity at geodetic latitudes and heights, which broadcast."""
    twice = np.cos(2.0 * np.radians(np.asarray(latitude_deg, dtype=np.float64)))
    sea = 9.80616 * (1.0 - 0.0026373 * twice + 0.0000059 * twice**2)
    radius = 2.0 * sea / (3.085462e-6 + 2.27e-9 * twice)
    return np.asarray(sea * (radius / (radius + np.asarray(altitude_m, dtype=np.float64))) ** 2)


def pressure_pa(
    latitude_deg: FloatArray,
    altitude_m: FloatArray,
    temperature_k: FloatArray,
    water_share: FloatArray | float,
    ground_pa: FloatArray | float,
) -> FloatArray:
    """Return the pressure of columns, shape (c, k).

    ``latitude_deg``: shape (c,); ``altitude_m``: shape (k,), rising; ``temperature_k``: shape (c, k); ``water_share``:
    shape (c, k), mole fraction of water vapour; ``ground_pa``: shape (c,), at the first altitude.
    """
    virtual = temperature_k * (1.0 + LIGHTER_WATER * np.asarray(water_share))
    weight = MOLAR_MASS_KG / GAS_CONSTANT * gravity_m_s2(latitude_deg[:, None], altitude_m)
    low, high = virtual[:, :-1], virtual[:, 1:]
    ratio = high / low
    # ln(r) / (r - 1), whose limit at r = 1 cancels
    near = np.abs(ratio - 1.0) < 1e-6
    inverse = np.where(near, 1.0 - 0.5 * (ratio - 1.0), np.log(ratio) / np.where(near, 1.0, ratio - 1.0)) / low
    fall = 0.5 * (weight[:, :-1] + weight[:, 1:]) * inverse * np.diff(altitude_m)
    total = np.concatenate([np.zeros((len(fall), 1)), np.cumsum(fall, axis=1)], axis=1)
    return np.asarray(np.reshape(ground_pa, (-1, 1)) * np.exp(-total))


ICE_POINT_K = 273.15


def saturated_share(pressure_pa: FloatArray, temperature_k: FloatArray) -> FloatArray:
    """Return the mole fraction of saturated water vapour, over ice below the ice point and over water above.

    D. M. Murphy and T. Koop, Q. J. R. Meteorol. Soc. 131, 1539 (2005), eq. 7, over ice; over water the formula of
    Magnus with Sonntag's constants, 0.3 % to 45 C. At most 1.
    """
    t = np.maximum(temperature_k, 110.0)
    ice = np.exp(9.550426 - 5723.265 / t + 3.53068 * np.log(t) - 0.00728332 * t)
    celsius = np.maximum(t - ICE_POINT_K, 0.0)
    water = 611.2 * np.exp(17.62 * celsius / (243.12 + celsius))
    return np.minimum(np.where(t < ICE_POINT_K, ice, water) / pressure_pa, 1.0)
