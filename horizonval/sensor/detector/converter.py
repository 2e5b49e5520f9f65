"""Signal to digital numbers: an ideal converter.

``dn = floor(black + signal / gain + 1/2)``, clipped to 0 and ``2^bits - 1``. The black level keeps the lower half of
the read noise. Neglected: differential non-linearity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray


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
