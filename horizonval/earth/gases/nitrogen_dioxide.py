"""Absorption of sunlight by nitrogen dioxide: ``k(z, lambda) = x(z) n_air(z) sigma(lambda)``.

The cross section sigma is that of Vandaele et al. 1998 (J. Quant. Spectrosc. Radiat. Transfer 59, 171) at 220 K,
averaged over 20 nm (full width of a triangle) so that single nodes do not sample the bands of 5 to 10 nm. Between 430
and 560 nm those bands deviate by 20 to 30 % from the mean; at 294 K the means are 2 % larger at 400 to 480 nm.

The mixing ratio x is that of the AFGL reference atmosphere (Anderson et al. 1986, AFGL-TR-86-0110, as in LOWTRAN7), the
same everywhere: a vertical column of 5.5e15 per cm2, 0.4e15 of it below 10 km. In nature the stratosphere's column is
2e15 to 6e15 by latitude, season and hour; over industry the lowest 2 km hold 10e15 more. The absorption (0.3 % on a
vertical path at 440 nm, a depth of 0.1 through the limb at 20 to 25 km) is therefore uncertain by half.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import csv


def cross_section_m2(wavelength_um: float) -> float:
    """Return the cross section of one molecule, averaged over 20 nm; 0 beyond 700 nm."""
    wavelength_nm, cross_section_cm2 = csv("nitrogen_dioxide_cross_section.csv")
    return 1e-4 * float(np.interp(1e3 * wavelength_um, wavelength_nm, cross_section_cm2))


def number_density_per_m3(altitude_m: FloatArray, number_density_air: FloatArray) -> FloatArray:
    """Return molecules per m3, shape (n,); log-linear in altitude, the uppermost mixing ratio above 120 km."""
    altitude_km, ppm = csv("nitrogen_dioxide_profile.csv")
    mixing_ratio = 1e-6 * np.exp(np.interp(1e-3 * altitude_m, altitude_km, np.log(ppm)))
    return np.asarray(mixing_ratio * number_density_air)
