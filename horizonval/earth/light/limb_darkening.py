"""Limb darkening of the Sun: Neckel's analytical functions (Sol. Phys. 229, 13 (2005), table 1).

They are fitted to the measured continuum of Neckel and Labs (Sol. Phys. 153, 91 (1994)), 300 to 1100 nm::

    I(mu) / I(1) = A_0 + A_1 mu + ... + A_5 mu^5,      A_k = a_k0 + a_k1 / lambda + a_k5 / lambda^5

with ``mu^2 = 1 - (r / R)^2`` on the disc and the wavelength in um. At mu = 1 every set sums to one. The darkening jumps
across the Balmer limit: between 373 and 385 nm, where Neckel gives no fit, it is linear in wavelength. Beyond 1.1 um it
is constant, although the disc is flatter there (at 2 um its edge is brighter by some 10 % of the centre). Spots,
faculae and the chromosphere are neglected.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray

_RANGES = (
    (
        (0.30, 0.37298),
        ((0.35601, -0.085217, 0.0), (1.11529, 0.085217, -0.001871), (-0.67237, 0.0, 0.003589)),
        ((0.18696, 0.0, -0.002415), (0.00038, 0.0, 0.000897), (0.01373, 0.0, -0.000200)),
    ),
    (
        (0.385, 0.42257),
        ((0.09900, 0.010643, 0.0), (1.96884, -0.010643, -0.009166), (-2.80511, 0.0, 0.024873)),
        ((3.32780, 0.0, -0.029317), (-2.17878, 0.0, 0.018273), (0.58825, 0.0, -0.004663)),
    ),
    (
        (0.42257, 1.10),
        ((0.75267, -0.265577, 0.0), (0.93874, 0.265577, -0.004095), (-1.89287, 0.0, 0.012582)),
        ((2.42234, 0.0, -0.017117), (-1.71150, 0.0, 0.011977), (0.49062, 0.0, -0.003347)),
    ),
)


def coefficients(wavelength_um: float) -> tuple[float, ...]:
    """Return ``A_0 ... A_5`` of ``I(mu) / I(1) = sum A_k mu^k``; constant outside 0.30 to 1.10 um."""
    wavelength = min(max(wavelength_um, _RANGES[0][0][0]), _RANGES[-1][0][1])
    for (low, high), *_ in _RANGES:
        if low <= wavelength <= high:
            return tuple(_fit(wavelength, low))
    left, right = _RANGES[0][0][1], _RANGES[1][0][0]
    share = (wavelength - left) / (right - left)
    return tuple((1.0 - share) * _fit(left, _RANGES[0][0][0]) + share * _fit(right, _RANGES[1][0][0]))


def _fit(wavelength_um: float, low_um: float) -> FloatArray:
    rows = next(first + second for (low, _), first, second in _RANGES if low == low_um)
    return np.array(rows) @ np.array([1.0, 1.0 / wavelength_um, wavelength_um**-5])
