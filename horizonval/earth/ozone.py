"""Absorption cross section of ozone, 280 to 820 nm (Hartley-Huggins edge, Chappuis and Wulf bands).

1 nm means at 220 K and 280 K of the measurements of Daumont et al. 1992, Malicet et al. 1995 and Brion et al. 1998,
linear in temperature between the two. Accuracy against the Bremen measurements: 1 % in the Chappuis band (500 to
700 nm), 4 to 6 % at 320 to 340 and 420 to 460 nm. Beyond 820 nm nothing is shipped: the Wulf band's tail there is
below 2.1e-26 m2, 0.2 % of a vertical path and 2 to 3 % of a limb path at 20 km.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.earth.column import FloatArray
from horizonval.earth.tables import csv
from horizonval.errors import UserError

MIN_UM, MAX_UM = 0.280, 0.820
_COLD_K, _WARM_K = 220.0, 280.0


def cross_section_m2(wavelength_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the absorption cross section of one molecule [m2].

    Parameters
    ----------
    wavelength_um : array_like
        280 to 820 nm; linear between the 1 nm means.
    temperature_k : array_like
        Broadcasts against the wavelength. Held at 220 K below and at 280 K above: a straight line would reach zero
        near 340 nm in a cold mesosphere, and outside this range of temperatures there is next to no ozone.

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
    share = np.clip((np.asarray(temperature_k, dtype=np.float64) - _COLD_K) / (_WARM_K - _COLD_K), 0, 1)
    return cold + share * (warm - cold)
