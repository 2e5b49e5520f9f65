"""The axis of Sun angles of the diffuse field: dense where day turns into night.

With ``u`` uniform between its ends, ``mu_s = -0.05 + 0.1 sinh(u)`` runs from -0.40 (Sun 23.6 deg below the horizon) to
1: 0.3 deg at the terminator for 96 points, 3 deg with the Sun overhead.
"""

from __future__ import annotations

import math
from typing import TypeVar

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray

Mu = TypeVar("Mu", FloatArray, "mi.Float32", "mi.Float64")

SUN_LOWEST = -0.40
_MIDDLE, _SCALE = -0.05, 0.1
_FIRST = math.asinh((SUN_LOWEST - _MIDDLE) / _SCALE)
_LAST = math.asinh((1.0 - _MIDDLE) / _SCALE)


def sun_angle_cosines(count: int) -> FloatArray:
    """Return the cosines of the Sun's zenith angle, shape (count,), rising."""
    mu = _MIDDLE + _SCALE * np.sinh(np.linspace(_FIRST, _LAST, count))
    mu[0], mu[-1] = SUN_LOWEST, 1.0
    return mu


def sun_angle_position(mu: Mu, count: int) -> Mu:
    """Return the fractional index of cosines (numpy or Dr.Jit); beyond the ends they count as the ends."""
    x = (mu - _MIDDLE) / _SCALE
    scale = (count - 1) / (_LAST - _FIRST)
    if isinstance(mu, np.ndarray):
        return np.clip((np.arcsinh(x) - _FIRST) * scale, 0.0, count - 1)
    size = dr.abs(x)
    u = dr.mulsign(dr.log(size + dr.sqrt(dr.fma(size, size, 1.0))), x)
    return dr.clip((u - _FIRST) * scale, 0.0, count - 1)
