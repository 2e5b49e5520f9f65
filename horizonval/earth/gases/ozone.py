"""Absorption cross section of ozone, 280 to 1000 nm (Hartley-Huggins edge, Chappuis and Wulf bands).

Up to 820 nm: 1 nm means at 220 K and 280 K of the measurements of Daumont et al. 1992, Malicet et al. 1995 and Brion et
al. 1998, linear in temperature between. They agree with the Bremen measurements to 1 % in the Chappuis band (500 to 700
nm), 4 to 6 % at 320 to 340 and 420 to 460 nm.

From 820 to 1000 nm, where the Wulf bands decrease, the cross section is the straight line that fits the logarithm of
the table from 680 to 820 nm, e-folding 67 nm. It has no structure: against the Bremen measurements means over 20 nm are
within 25 % up to 900 nm (60 % beyond, a factor 4 at 970 nm), the whole range within 2 %. Scattered sunlight there is
then within 1 % in bands of 20 nm and 0.2 % in wide ones. Beyond 1000 nm ozone is neglected (less than 0.3 %).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.tables import csv

MIN_UM, MAX_UM = 0.280, 1.0
_COLD_K, _WARM_K = 220.0, 280.0
_FIT_FROM_NM = 680.0


@cache
def _table() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return wavelength [nm] and the cross sections at 220 and 280 K [m2], by 1 nm, with the line beyond 820 nm."""
    measured_nm, cold_cm2, warm_cm2 = csv("ozone_cross_section.csv")
    fitted = measured_nm >= _FIT_FROM_NM
    # Both temperatures have the same values there.
    line = np.polyfit(measured_nm[fitted], np.log(cold_cm2[fitted]), 1)
    beyond_nm = np.arange(measured_nm[-1] + 1, MAX_UM * 1e3 + 1)
    tail_cm2 = np.exp(np.polyval(line, beyond_nm))
    cold, warm = (np.concatenate([measured, tail_cm2]) * 1e-4 for measured in (cold_cm2, warm_cm2))
    return np.concatenate([measured_nm, beyond_nm]), cold, warm


def cold_and_warm_m2(wavelength_um: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return cross sections of a molecule at 220 and 280 K [m2], linear between 1 nm means of 280 to 1000 nm."""
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    nanometre = wavelength * 1e3
    # A wavelength of 1 um must not fail over the last bit of its product with 1000.
    if nanometre.size and not (nanometre.min() >= 280 - 1e-9 and nanometre.max() <= 1000 + 1e-9):
        raise UserError(
            f"no ozone cross section at {wavelength.min():g} to {wavelength.max():g} um",
            expected=f"wavelengths within {MIN_UM:g} to {MAX_UM:g} um",
        )
    table_nm, cold, warm = _table()
    return np.interp(nanometre, table_nm, cold), np.interp(nanometre, table_nm, warm)


def at_temperature_m2(cold: ArrayLike, warm: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the cross section at a temperature from those at 220 and 280 K; everything broadcasts.

    It is constant below 220 K and above 280 K: extrapolation would become negative at 358 nm below 206 K.
    """
    low = np.asarray(cold, dtype=np.float64)
    return low + warm_share(temperature_k) * (np.asarray(warm, dtype=np.float64) - low)


def warm_share(temperature_k: ArrayLike) -> FloatArray:
    """Return the weight of the cross section at 280 K at temperatures; that at 220 K has the rest."""
    return np.clip((np.asarray(temperature_k, dtype=np.float64) - _COLD_K) / (_WARM_K - _COLD_K), 0, 1)


def cross_section_m2(wavelength_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the absorption cross section of one molecule [m2]; errors as of :func:`cold_and_warm_m2`."""
    return at_temperature_m2(*cold_and_warm_m2(wavelength_um), temperature_k)
