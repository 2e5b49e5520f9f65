"""Charge on its way through the array: smear of a frame transfer, and what spills over a full well.

**Smear.** A frame-transfer CCD has no shutter. While the image is shifted to its storage, one row in ``row_time_s``,
and before that while the last one was shifted out, every packet passes all other rows of its column and collects there
as if exposed for one row time::

    smear(r) = row_time * sum over the other rows of the column of rate

**Blooming.** Electrons beyond the full well spill along the column, half of them up and half down, until they find room
or leave the array. Down first, then up: where two overfull stretches compete for the same room the upper one gets it.
Arrays with drains (all modern CMOS) lose the excess instead.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray


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
