"""Absorption cross section of ozone, 280 to 820 nm (Hartley-Huggins edge, Chappuis and Wulf bands).

1 nm means at 220 K and 280 K of the measurements of Daumont et al. 1992, Malicet et al. 1995 and Brion et al. 1998,
linear in temperature between the two. Accuracy against the Bremen measurements: 1 % in the Chappuis band (500 to
700 nm), 4 to 6 % at 320 to 340 and 420 to 460 nm. Beyond 820 nm nothing is shipped. The tail of the Wulf bands there
has a slant optical depth, right through the limb at 20 km, of 0.075 at 820 and 0.04 at 850 nm: without it scattered
sunlight is 4 and 2 % too bright there, and 0.2 and 0.1 % towards the nadir.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.earth.column import FloatArray
from horizonval.earth.tables import csv
from horizonval.errors import UserError

MIN_UM, MAX_UM = 0.280, 0.820
_COLD_K, _WARM_K = 220.0, 280.0


def cold_and_warm_m2(wavelength_um: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the cross sections of one molecule at 220 K and at 280 K [m2], linear between the 1 nm means.

    Raises
    ------
    UserError
        Wavelength outside the table.
    """
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    nanometre = wavelength * 1e3
    # A wavelength of 0.82 um must not fail over the last bit of its product with 1000.
    if nanometre.size and not (nanometre.min() >= 280 - 1e-9 and nanometre.max() <= 820 + 1e-9):
        raise UserError(
            f"no ozone cross section at {wavelength.min():g} to {wavelength.max():g} um",
            expected=f"wavelengths within {MIN_UM:g} to {MAX_UM:g} um",
        )
    table_nm, cold_cm2, warm_cm2 = csv("ozone_cross_section.csv")
    cold = np.interp(nanometre, table_nm, cold_cm2) * 1e-4
    warm = np.interp(nanometre, table_nm, warm_cm2) * 1e-4
    return cold, warm


def at_temperature_m2(cold: ArrayLike, warm: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the cross section at a temperature from those at 220 and 280 K; everything broadcasts.

    Held at 220 K below and at 280 K above: a straight line would fall below zero at 358 nm in the cold (from
    206 K), and there is next to no ozone outside this range of temperatures.
    """
    low = np.asarray(cold, dtype=np.float64)
    share = np.clip((np.asarray(temperature_k, dtype=np.float64) - _COLD_K) / (_WARM_K - _COLD_K), 0, 1)
    return low + share * (np.asarray(warm, dtype=np.float64) - low)


def cross_section_m2(wavelength_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the absorption cross section of one molecule [m2]; wavelength (280 to 820 nm) and temperature broadcast.

    Raises
    ------
    UserError
        Wavelength outside the table.
    """
    return at_temperature_m2(*cold_and_warm_m2(wavelength_um), temperature_k)
