"""Black-body radiance: spectral per wavelength and wavenumber, and band integrals by exact series.

With ``x = h c / (lambda k T)``::

    B_lambda = 2 h c^2 / lambda^5 / (e^x - 1)
    integral of B_lambda from 0 to lambda = sigma T^4 / pi * F(x)
    F(x) = 15 / pi^4 * sum_n e^(-n x) / n (x^3 + 3 x^2 / n + 6 x / n^2 + 6 / n^3)

(Widger and Woodall, Bull. Amer. Meteor. Soc. 57, 1217 (1976)). The sum converges slowly for small x; there the power
series of the integrand t^3 / (e^t - 1) is integrated instead, with the Bernoulli numbers B_2k::

    1 - F(x) = 15 / pi^4 * (x^3 / 3 - x^4 / 8 + sum_k B_2k x^(2k+3) / ((2k)! (2k + 3)))

CODATA constants from :mod:`scipy.constants`.

Brightness temperature: how warm a black body would be that sends the same radiance through a band.

The band's black-body radiance and its inverse::

    L(T) = integral R(lambda) B_lambda(T) dlambda,        T_b = L^-1(radiance)

ln L is nearly linear in 1/T (Wien), so that a cubic spline of 1/T over ln L inverts it to a few microkelvin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants
from scipy.interpolate import CubicSpline
from scipy.special import bernoulli, factorial

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band

_C2 = constants.h * constants.c / constants.k
_SERIES_LIMIT = 2.0


def radiance_per_um(wavelength_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return B_lambda [W m-2 sr-1 um-1]; wavelength and temperature (> 0) broadcast."""
    wavelength_m = np.asarray(wavelength_um, dtype=np.float64) * 1e-6
    x = _C2 / (wavelength_m * np.asarray(temperature_k, dtype=np.float64))
    with np.errstate(over="ignore"):
        return 2e-6 * constants.h * constants.c**2 / wavelength_m**5 / np.expm1(x)


def radiance_per_wavenumber(wavenumber_per_cm: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return B_nu [W m-2 sr-1 / cm-1]; wavenumber [cm-1] and temperature (> 0) broadcast."""
    nu = np.asarray(wavenumber_per_cm, dtype=np.float64) * 100
    x = _C2 * nu / np.asarray(temperature_k, dtype=np.float64)
    with np.errstate(over="ignore"):
        return 2e2 * constants.h * constants.c**2 * nu**3 / np.expm1(x)


def fraction_below(wavelength_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the share F of a black body's radiance at wavelengths shorter than ``wavelength_um`` (0 to 1).

    Relative error below 1e-13: the sums run until their terms vanish in float64.
    """
    x = _C2 / (np.asarray(wavelength_um, dtype=np.float64) * 1e-6 * np.asarray(temperature_k, dtype=np.float64))
    large = np.maximum(x, _SERIES_LIMIT)[..., None]
    n = np.arange(1.0, 25.0)
    exponential = np.sum(np.exp(-n * large) / n * (large**3 + 3 * large**2 / n + 6 * large / n**2 + 6 / n**3), axis=-1)
    small = np.minimum(x, _SERIES_LIMIT)
    k2 = np.arange(2, 32, 2)
    power = small**3 / 3 - small**4 / 8
    power = power + np.sum(bernoulli(30)[k2] / factorial(k2) / (k2 + 3) * small[..., None] ** (k2 + 3.0), axis=-1)
    scale = 15 / np.pi**4
    return np.where(x > _SERIES_LIMIT, scale * exponential, 1 - scale * power)


def band_radiance(lo_um: ArrayLike, hi_um: ArrayLike, temperature_k: ArrayLike) -> FloatArray:
    """Return the black-body radiance [W m-2 sr-1] between two wavelengths.

    A difference of two shares: in bands narrower than 1e-4 of the wavelength the absolute accuracy of 1e-16 sigma T^4
    shows; use :func:`radiance_per_um` times the width there.
    """
    temperature = np.asarray(temperature_k, dtype=np.float64)
    total = constants.sigma * temperature**4 / np.pi
    return total * (fraction_below(hi_um, temperature) - fraction_below(lo_um, temperature))


COLDEST_K, HOTTEST_K = 30.0, 8000.0
"""Range of the inverse: below it is as good as no light at all, above it there is nothing in the sky of a scene."""
_NODES = 400


def black_body_radiance(band: Band, temperature_k: ArrayLike) -> FloatArray:
    """Return the radiance of black bodies in a thermal band [W m-2 sr-1], shape of the temperature (> 0)."""
    wavelength_um, weight_um = bands.sampled(band)
    temperature = np.asarray(temperature_k, dtype=np.float64)[..., None]
    return radiance_per_um(wavelength_um, temperature) @ weight_um


def brightness_temperature_k(band: Band, radiance: ArrayLike) -> FloatArray:
    """Return brightness temperatures [K] of band radiances [W m-2 sr-1], any shape; 0 K where there is none.

    Radiances of less than a black body of COLDEST_K or more than one of HOTTEST_K count as those. The error is below
    1e-5 K.
    """
    radiance_in = np.asarray(radiance, dtype=np.float64)
    nodes_k = np.geomspace(COLDEST_K, HOTTEST_K, _NODES)
    ln_radiance = np.log(black_body_radiance(band, nodes_k))
    inverse = CubicSpline(ln_radiance, 1.0 / nodes_k)
    ln_given = np.log(np.maximum(radiance_in, np.finfo(np.float64).tiny))
    temperature = 1.0 / inverse(np.clip(ln_given, ln_radiance[0], ln_radiance[-1]))
    return np.where(radiance_in > 0.0, temperature, 0.0)
