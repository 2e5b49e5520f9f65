"""Black-body radiance per wavelength and wavenumber, and brightness temperature.

With ``x = h c / (lambda k T)``::

    B_lambda = 2 h c^2 / lambda^5 / (e^x - 1)

and CODATA constants from :mod:`scipy.constants`. The brightness temperature is that of a black body with the same
radiance in a band::

    L(T) = integral R(lambda) B_lambda(T) dlambda,        T_b = L^-1(radiance)

ln L is nearly linear in 1/T (Wien), so that a cubic spline of 1/T over ln L inverts it to a few microkelvin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy import constants
from scipy.interpolate import CubicSpline

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band

_C2 = constants.h * constants.c / constants.k


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


COLDEST_K, HOTTEST_K = 30.0, 8000.0
"""Range of the inverse."""
_NODES = 400


def black_body_radiance(band: Band, temperature_k: ArrayLike) -> FloatArray:
    """Return the radiance of black bodies in a thermal band [W m-2 sr-1], shape of the temperature (> 0)."""
    wavelength_um, weight_um = bands.sampled(band)
    temperature = np.asarray(temperature_k, dtype=np.float64)[..., None]
    return radiance_per_um(wavelength_um, temperature) @ weight_um


def brightness_temperature_k(band: Band, radiance: ArrayLike) -> FloatArray:
    """Return brightness temperatures [K] of band radiances [W m-2 sr-1], any shape; 0 K for no radiance.

    Clipped to COLDEST_K and HOTTEST_K. The error is below 1e-5 K.
    """
    radiance_in = np.asarray(radiance, dtype=np.float64)
    nodes_k = np.geomspace(COLDEST_K, HOTTEST_K, _NODES)
    ln_radiance = np.log(black_body_radiance(band, nodes_k))
    inverse = CubicSpline(ln_radiance, 1.0 / nodes_k)
    ln_given = np.log(np.maximum(radiance_in, np.finfo(np.float64).tiny))
    temperature = 1.0 / inverse(np.clip(ln_given, ln_radiance[0], ln_radiance[-1]))
    return np.where(radiance_in > 0.0, temperature, 0.0)
