"""Brightness temperature: how warm a black body would be that sends the same radiance through a band.

The band's black-body radiance and its inverse::

    L(T) = integral R(lambda) B_lambda(T) dlambda,        T_b = L^-1(radiance)

ln L is nearly linear in 1/T (Wien), so that a cubic spline of 1/T over ln L inverts it to a few microkelvin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands, planck
from horizonval.spec.camera import Band

COLDEST_K, HOTTEST_K = 30.0, 8000.0
"""Range of the inverse: below it is as good as no light at all, above it there is nothing in the sky of a scene."""
_NODES = 400


def black_body_radiance(band: Band, temperature_k: ArrayLike) -> FloatArray:
    """Return the radiance of black bodies in a thermal band [W m-2 sr-1], shape of the temperature (> 0)."""
    wavelength_um, weight_um = bands.sampled(band)
    temperature = np.asarray(temperature_k, dtype=np.float64)[..., None]
    return planck.radiance_per_um(wavelength_um, temperature) @ weight_um


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
