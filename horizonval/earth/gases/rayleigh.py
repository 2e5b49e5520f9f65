"""Rayleigh scattering by air: cross section of Bodhaine et al. 1999, phase function with or without depolarisation.

With the refractive index n of standard air (288.15 K, 1013.25 hPa, N_s molecules per m3), vacuum wavelength lambda and
the King factor F of the mixture::

    sigma = 24 pi^3 (n^2 - 1)^2 / (lambda^4 N_s^2 (n^2 + 2)^2) F

F follows from the depolarisation factor rho of anisotropic molecules, which also flattens the phase function
(Chandrasekhar 1950, *Radiative Transfer*, section 18; Bucholtz, Appl. Opt. 34, 2765 (1995), eqs. 5, 10 and 12)::

    F = (6 + 3 rho) / (6 - 7 rho)
    P = (1 - c/3 + c cos^2) / (4 pi),      c = 3/4 (1 - q) / (1 + 2 q),      q = rho / (2 - rho)

Source: B. A. Bodhaine, N. B. Wood, E. G. Dutton, J. R. Slusser, "On Rayleigh optical depth calculations", J. Atmos.
Oceanic Technol. 16, 1854 (1999): eq. 2 (cross section), eqs. 18 and 19 (Peck and Reeder's index, scaled with CO2), eqs.
5, 6 and 23 (King factors).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

STANDARD_NUMBER_DENSITY = 2.546899e25
"""Molecules per m3 at 288.15 K and 1013.25 hPa, the air for which the refractive index is given."""
COS2 = 0.75
"""Weight of cos^2 in the phase function without depolarisation, ``3/4 (1 + cos^2) / (4 pi)``."""


def refractive_index_minus_one(wavelength_um: ArrayLike, co2_ppm: float = 420.0) -> FloatArray:
    """Return n - 1 of dry air at 288.15 K and 1013.25 hPa (Peck and Reeder 1972, measured 0.23 to 1.69 um)."""
    s2 = np.asarray(wavelength_um, dtype=np.float64) ** -2
    at_300_ppm = (8060.51 + 2_480_990.0 / (132.274 - s2) + 17_455.7 / (39.32957 - s2)) * 1e-8
    return at_300_ppm * (1 + 0.54 * (co2_ppm * 1e-6 - 0.0003))


def refractivity(number_density: FloatArray, wavelength_um: ArrayLike) -> FloatArray:
    """Return n - 1 of air of a number density [1/m3], the mean over wavelengths; proportional to the density.

    Beyond 1.69 um it is nearly constant, 2.73e-4 at standard density; molecular bands change it by less than 1 %. Water
    vapour is neglected: it changes moist surface air by up to 0.5 %, far less above 2 km.
    """
    standard = float(np.mean(refractive_index_minus_one(wavelength_um)))
    return standard / STANDARD_NUMBER_DENSITY * number_density


def king_factor(wavelength_um: ArrayLike, co2_ppm: float = 420.0) -> FloatArray:
    """Return the King factor (6 + 3 rho) / (6 - 7 rho) of dry air, the mean over N2, O2, Ar and CO2 by volume."""
    s2 = np.asarray(wavelength_um, dtype=np.float64) ** -2
    nitrogen = 1.034 + 3.17e-4 * s2
    oxygen = 1.096 + 1.385e-3 * s2 + 1.448e-4 * s2**2
    co2_percent = co2_ppm * 1e-4
    return (78.084 * nitrogen + 20.946 * oxygen + 0.934 + co2_percent * 1.15) / (78.084 + 20.946 + 0.934 + co2_percent)


def cross_section_m2(wavelength_um: ArrayLike, co2_ppm: float = 420.0) -> FloatArray:
    """Return the scattering cross section of one molecule of dry air [m2].

    Measured from 0.23 to 1.69 um, smooth beyond towards the red. Bodhaine et al. state an accuracy of the order of
    1e-3, that of the King factor. Water vapour is neglected: it changes the index of moist surface air by less than 0.1
    %.
    """
    wavelength_m = np.asarray(wavelength_um, dtype=np.float64) * 1e-6
    n2 = (1 + refractive_index_minus_one(wavelength_um, co2_ppm)) ** 2
    lorentz = (n2 - 1) / (n2 + 2)
    return (24 * np.pi**3 * lorentz**2 / (wavelength_m**4 * STANDARD_NUMBER_DENSITY**2)) * king_factor(
        wavelength_um, co2_ppm
    )


def depolarisation(wavelength_um: ArrayLike, co2_ppm: float = 420.0) -> FloatArray:
    """Return the depolarisation factor rho of dry air for unpolarised light: 0.028 at 550 nm."""
    king = king_factor(wavelength_um, co2_ppm)
    return 6 * (king - 1) / (3 + 7 * king)


def cos2(wavelength_um: ArrayLike, co2_ppm: float = 420.0) -> FloatArray:
    """Return the weight c of cos^2 in the phase function of air: 0.719 at 550 nm, 0.75 for isotropic molecules."""
    rho = depolarisation(wavelength_um, co2_ppm)
    q = rho / (2 - rho)
    return COS2 * (1 - q) / (1 + 2 * q)


def phase_function_per_sr(cos_angle: ArrayLike, cos2: ArrayLike = COS2) -> FloatArray:
    """Return the phase function, integral over the sphere 1, at cosines of the angle of scattering."""
    c = np.asarray(cos2, dtype=np.float64)
    return (1 - c / 3 + c * np.asarray(cos_angle, dtype=np.float64) ** 2) / (4 * np.pi)
