"""Clear air as thermal bands see it: pressure, temperature and all gases of one column or many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases import rrtmg
from horizonval.earth.gases.halocarbons import halocarbons


@dataclass(frozen=True)
class GasState:
    """Columns of clear air on common altitudes.

    Attributes
    ----------
    altitude_m : ndarray, shape (n,)
    pressure_pa, temperature_k : ndarray, shape (..., n)
    vmr : mapping of str to ndarray, shape (..., n)
        Volume mixing ratios of the gases that :func:`horizonval.earth.gases.rrtmg.absorption_per_m` knows.
    """

    altitude_m: FloatArray
    pressure_pa: FloatArray
    temperature_k: FloatArray
    vmr: Mapping[str, FloatArray]

    def absorption_per_m(self, bands: Sequence[int] = tuple(range(len(rrtmg.BANDS)))) -> FloatArray:
        """Return the absorption [1/m], shape (len(bands), 16, ..., n); ``bands`` are places in the tables' list."""
        return rrtmg.absorption_per_m(self.pressure_pa, self.temperature_k, self.vmr, bands)

    def with_halocarbons(self) -> GasState:
        """Return the air with today's halocarbons, see :mod:`horizonval.earth.gases.halocarbons`."""
        added = {gas: np.broadcast_to(x, self.pressure_pa.shape) for gas, x in halocarbons(self.altitude_m).items()}
        return replace(self, vmr={**self.vmr, **added})
