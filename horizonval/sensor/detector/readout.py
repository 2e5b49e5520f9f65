"""Charge to digital numbers: smear, full well, blooming, read noise, and an ideal converter.

Electrons beyond the full well are lost. The read noise is Gaussian, the same for every pixel and independent of the
charge. ``dn = floor(black + signal / gain + 1/2)``, clipped to 0 and ``2^bits - 1``.

**Smear.** A frame-transfer CCD has no shutter. While the image is shifted to its storage, one row in ``row_time_s``,
and before that while the last one was shifted out, every packet passes all other rows of its column::

    smear(r) = row_time * sum over the other rows of the column of rate

**Blooming.** Electrons beyond the full well spill along the column, half of them up and half down, until they find room
or leave the array; down first, so that the upper of two overfull stretches gets the room between them. Arrays with
drains (all modern CMOS) lose the excess instead.

Neglected: the bend of the response just below saturation, random telegraph noise, differential non-linearity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray


def saturate(electrons: FloatArray, full_well_e: float) -> FloatArray:
    """Return the charge a pixel holds [e-], shape of ``electrons``."""
    return np.minimum(electrons, full_well_e)


def add_read_noise(electrons: FloatArray, read_noise_e: float, rng: np.random.Generator) -> FloatArray:
    """Return the charge as the converter sees it [e-], shape of ``electrons``; it can be below zero."""
    return electrons + read_noise_e * rng.standard_normal(electrons.shape)


def smear_e(rate_e_per_s: FloatArray, row_time_s: float) -> FloatArray:
    """Return the electrons every pixel collects during the transfer, shape (H, W)."""
    return row_time_s * (rate_e_per_s.sum(axis=0, keepdims=True) - rate_e_per_s)


def bloom(electrons: FloatArray, full_well_e: float) -> FloatArray:
    """Return the charge after spilling [e-], shape (H, W); nothing is above the full well."""
    excess = np.maximum(electrons - full_well_e, 0.0)
    held = electrons - excess
    columns = np.flatnonzero(excess.any(axis=0))
    if columns.size:
        part, over = held[:, columns], 0.5 * excess[:, columns]
        part = _spill(part, over, full_well_e)
        held[:, columns] = _spill(part[::-1], over[::-1], full_well_e)[::-1]
    return held


def _spill(held: FloatArray, excess: FloatArray, full_well_e: float) -> FloatArray:
    """Return the charge after every row has handed its excess to the next one."""
    held = held.copy()
    carried = np.zeros(held.shape[1])
    for row in range(held.shape[0]):
        accepted_e = np.minimum(full_well_e - held[row], carried)
        held[row] += accepted_e
        carried += excess[row] - accepted_e
    return held


def full_scale(bits: int) -> int:
    """Return the largest digital number."""
    return 2**bits - 1


def default_gain(full_well: float, bits: int, black_level_dn: float) -> float:
    """Return the signal per digital number that lays a full well on the largest digital number."""
    return full_well / (full_scale(bits) - black_level_dn)


def digitise(signal: FloatArray, gain: float, black_level_dn: float, bits: int) -> NDArray[np.uint16]:
    """Return digital numbers, shape of ``signal``; ``gain`` in units of the signal per digital number."""
    dn = np.floor(black_level_dn + signal / gain + 0.5)
    return np.clip(dn, 0, full_scale(bits)).astype(np.uint16)
