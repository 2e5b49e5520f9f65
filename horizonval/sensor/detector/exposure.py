"""Photons to electrons: the counting process in a pixel's photodiode, and automatic exposure.

The response of a solar band is a quantum efficiency, and its band radiance weights photons by their wavelength over
``lambda_ref`` (:mod:`horizonval.earth.spectral.bands`), so that the mean count is exactly::

    electrons = P t QE_peak lambda_ref / (h c)

Photoelectrons and dark electrons are Poisson distributed, from separate streams. The silicon is taken as linear up to
the full well; its memory of the last exposure is neglected.

An automatic exposure brings the given percentile of the pixels' expected electrons to the target share of the full
well, within its shortest and longest exposure.
"""

from __future__ import annotations

import numpy as np
from scipy import constants

from horizonval.core.arrays import FloatArray
from horizonval.spec.detector import AutoExposure


def photoelectrons(
    power_w: FloatArray, exposure_s: float, quantum_efficiency: float, reference_wavelength_m: float
) -> FloatArray:
    """Return the expected number of photoelectrons, shape (H, W)."""
    return power_w * (exposure_s * quantum_efficiency * reference_wavelength_m / (constants.h * constants.c))


def dark_current_ratio(temperature_c: float | None, reference_c: float | None, doubling_k: float) -> float:
    """Return the dark current at a temperature relative to that at the reference; 1 without temperatures."""
    if temperature_c is None or reference_c is None:
        return 1.0
    return float(2.0 ** ((temperature_c - reference_c) / doubling_k))


def count(expected: FloatArray, full_well_e: float, rng: np.random.Generator) -> FloatArray:
    """Return Poisson counts, shape of ``expected``.

    Expected counts above 100 full wells (the Sun) are returned as they are: the generator stays inside the range of its
    integers. The pixel saturates either way, and what spills over is right within 3 %, for wells of 10 000
    electrons within 0.1 %.
    """
    limit = 100 * full_well_e + 1000
    return np.where(expected > limit, expected, rng.poisson(np.minimum(expected, limit)))


def exposure_s(rate_e_per_s: FloatArray, full_well_e: float, rule: AutoExposure) -> float:
    """Return the exposure [s] for expected rates of electrons, dark current included, shape (H, W)."""
    rate = float(np.percentile(rate_e_per_s, rule.percentile))
    if rate * rule.max_s <= rule.target * full_well_e:
        return rule.max_s
    return max(rule.target * full_well_e / rate, rule.min_s)
