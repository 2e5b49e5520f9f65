"""Absorption of sunlight by nitrogen dioxide: ``k(z, lambda) = x(z) n_air(z) sigma(lambda)``.

The cross section sigma is that of Vandaele et al. 1998 (J. Quant. Spectrosc. Radiat. Transfer 59, 171) at 220 K,
averaged over 20 nm (full width of a triangle): the absorption is weak enough for means, and a node that fell into one
of the bands, 5 to 10 nm wide, would not be one. Between 430 and 560 nm those bands are 20 to 30 % about the mean; at
294 K the means are 2 % larger at 400 to 480 nm.

The mixing ratio x is that of the AFGL reference atmosphere (Anderson et al. 1986, AFGL-TR-86-0110, as LOWTRAN7 has it),
the same everywhere: a vertical column of 5.5e15 per cm2, 0.4e15 of which lies below 10 km. In nature the stratosphere's
column is 2e15 to 6e15 by latitude, season and hour (least in the polar night and in the morning), so that the model is
on the high side, by two in the tropics; over industry the lowest 2 km hold 10e15 more. What is taken out of the light,
0.3 % on the way straight down and as much on the way up at 440 nm, and a depth of 0.1 along a ray through the limb at
20 to 25 km, is uncertain by half.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.tables import csv


def cross_section_m2(wavelength_um: float) -> float:
    """Return the mean cross section of one molecule over 20 nm about a wavelength; 0 beyond 700 nm."""
    wavelength_nm, cross_section_cm2 = csv("nitrogen_dioxide_cross_section.csv")
    return 1e-4 * float(np.interp(1e3 * wavelength_um, wavelength_nm, cross_section_cm2))


def number_density_per_m3(altitude_m: FloatArray, number_density_air: FloatArray) -> FloatArray:
    """Return molecules per m3, shape (n,); log-linear in altitude, the uppermost mixing ratio above 120 km."""
    altitude_km, ppm = csv("nitrogen_dioxide_profile.csv")
    mixing_ratio = 1e-6 * np.exp(np.interp(1e-3 * altitude_m, altitude_km, np.log(ppm)))
    return np.asarray(mixing_ratio * number_density_air)
