"""How much water vapour air can hold."""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

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
