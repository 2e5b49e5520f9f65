"""Spectral responses of camera bands.

A response is a top hat or a piecewise linear table, zero outside, scaled to a peak of 1.

Solar bands have a *quantum efficiency* R (electrons per photon, relative). A band radiance counts photons as energy at
one reference wavelength, the response's mean::

    lambda_ref = integral R lambda dlambda / integral R dlambda
    L_band = integral L R (lambda / lambda_ref) dlambda                       [W m-2 sr-1]
    electrons = L_band * A Omega t * QE_peak * lambda_ref / (h c)             exactly

Only monochromatic light has this energy. A frame therefore also has the *energy radiance*, the plain integral over
wavelength::

    L_energy = integral L R dlambda                                           [W m-2 sr-1]

In 450 to 750 nm L_band is 2 % below it for sunlight from a white ground, 10 % for a limb as blue as wavelength^-4.

Thermal bands have a response per unit power: ``L_band = integral L R dlambda``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral.quadrature import composite_gauss
from horizonval.spec.camera import Band


def knots_um(band: Band) -> FloatArray:
    """Return the wavelengths between which the response is linear, trimmed to the range above zero [um]."""
    if band.lo_um is not None and band.hi_um is not None:
        return np.array([band.lo_um, band.hi_um])
    wavelength = np.array(band.wavelength_um, dtype=np.float64)
    positive = np.flatnonzero(np.array(band.response) > 0)
    return wavelength[max(positive[0] - 1, 0) : positive[-1] + 2]


def limits_um(band: Band) -> tuple[float, float]:
    """Return the wavelengths between which the response is above zero [um]."""
    knots = knots_um(band)
    return float(knots[0]), float(knots[-1])


def response(band: Band, wavelength_um: ArrayLike) -> FloatArray:
    """Return the response at wavelengths, peak 1, zero outside the band."""
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    if band.lo_um is not None and band.hi_um is not None:
        return np.where((wavelength >= band.lo_um) & (wavelength <= band.hi_um), 1.0, 0.0)
    table = np.array(band.response, dtype=np.float64)
    return np.interp(wavelength, band.wavelength_um, table / table.max(), left=0.0, right=0.0)


def sampled(band: Band, breaks_um: ArrayLike = (), order: int = 8) -> tuple[FloatArray, FloatArray]:
    """Return a fine quadrature over the band: wavelengths [um] and weights that include the response, shape (m,) each.

    ``sum(weight_um * f(wavelength_um))`` is the integral of ``R f`` over the wavelength. ``breaks_um``: further
    wavelengths where the integrand is not smooth. ``order``: points between neighbouring breaks.
    """
    knots = knots_um(band)
    extra = np.asarray(breaks_um, dtype=np.float64)
    # A few more breaks make a fine rule of a band without any.
    edges = np.unique(
        np.concatenate([knots, extra[(extra > knots[0]) & (extra < knots[-1])], np.linspace(knots[0], knots[-1], 65)])
    )
    points, weights = composite_gauss(edges, order)
    points, weights = points.ravel(), weights.ravel()
    return points, weights * response(band, points)


def width_um(band: Band) -> float:
    """Return the integral of the response [um]; for solar bands also that of the photon-weighted one."""
    return float(sampled(band)[1].sum())


def reference_wavelength_um(band: Band) -> float:
    """Return the response's mean wavelength, ``integral R lambda / integral R`` [um]."""
    wavelength, weight = sampled(band)
    return float(np.sum(weight * wavelength) / weight.sum())
