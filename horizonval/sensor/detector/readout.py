"""Charge to converter input: what a pixel can hold, and what reading it adds.

Electrons beyond the full well are lost; the read noise of the amplifier chain is Gaussian, the same for every pixel
and independent of the charge. Neglected: the bend of the response just below saturation, and random telegraph noise
of single pixels.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray


def saturate(electrons: FloatArray, full_well_e: float) -> FloatArray:
    """Return the charge a pixel holds [e-], shape of ``electrons``."""
    return np.minimum(electrons, full_well_e)


def add_read_noise(electrons: FloatArray, read_noise_e: float, rng: np.random.Generator) -> FloatArray:
    """Return the charge as the converter sees it [e-], shape of ``electrons``; it can be below zero."""
    return electrons + read_noise_e * rng.standard_normal(electrons.shape)
