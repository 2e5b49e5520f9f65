"""Diffraction at a round, clear entrance pupil.

One wavelength is spread as the Airy pattern of radius r on the detector, N the f-number::

    p(r) = pi / (4 (lambda N)^2) (2 J1(x) / x)^2,   x = pi r / (lambda N)

with its first dark ring at ``r = 1.22 lambda N`` and 83.8 % of the light inside. Its transfer function is that of two
overlapping discs, zero from the cut-off ``1 / (lambda N)`` on::

    T(f) = 2 / pi (acos v - v sqrt(1 - v^2)),   v = lambda N f

(Born and Wolf, *Principles of Optics*, 7th ed. 1999, 8.5.2 and 9.5.2.) A band's is the mean over the wavelengths of its
response, weighted by photons for detectors that count them, of light with a flat spectrum. Far out the rings wash out,
and what is left is ``lambda N / (pi^3 r^3)`` with the mean wavelength.

Neglected: the shadow of a secondary mirror and its spider; polarisation, which matters below f/1; the change of the
f-number with the field.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.spectral import bands
from horizonval.spec.camera import Band


def wavelengths_m(band: Band) -> tuple[FloatArray, FloatArray]:
    """Return wavelengths [m] and their weights in the band, shape (n,) each, of sum 1.

    Rings of different wavelengths fall out of step, so that some hundred of them are a band.
    """
    wavelength, weight = bands.sampled(band)
    if band.kind == "solar":
        weight = weight * wavelength
    kept = weight > 0
    return wavelength[kept] * 1e-6, weight[kept] / weight[kept].sum()


def mean_wavelength_m(band: Band) -> float:
    """Return the mean wavelength of the light that the band counts [m]."""
    wavelength, weight = wavelengths_m(band)
    return float(np.sum(wavelength * weight))


def transfer(frequency: FloatArray, spread: float) -> FloatArray:
    """Return the modulation at spatial frequencies; ``spread`` is lambda N, in the inverse unit of the frequency."""
    v = np.minimum(np.abs(frequency) * spread, 1.0)
    return 2 / math.pi * (np.arccos(v) - v * np.sqrt(1 - v * v))


def band_transfer(frequency_per_m: FloatArray, band: Band, f_number: float) -> FloatArray:
    """Return the band's mean modulation, shape of ``frequency_per_m`` [1/m], any order.

    The mean is taken on 4000 frequencies up to the cut-off and is linear between them: good to 1e-6.
    """
    wavelength, weight = wavelengths_m(band)
    nodes = np.linspace(0.0, 1.0 / (wavelength.min() * f_number), 4001)
    mean = np.zeros_like(nodes)
    for one, share in zip(wavelength, weight, strict=True):
        mean += share * transfer(nodes, one * f_number)
    return np.interp(np.abs(frequency_per_m), nodes, mean)


def far_pattern(distance: FloatArray, spread: float) -> FloatArray:
    """Return the share of the light per area, rings washed out, far from the centre; ``spread`` is lambda N."""
    return spread / (math.pi**3 * distance**3)


def share_outside(half_x: float, half_y: float, spread: float) -> float:
    """Return the share of the light outside a rectangle around the pattern, wide against its core."""
    return 4 * spread / math.pi**3 * (half_y / half_x + half_x / half_y) / math.hypot(half_x, half_y)
