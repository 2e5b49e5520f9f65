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

    def contents(self) -> tuple[FloatArray | str, ...]:
        """Return all that the columns are: heights, pressure, temperature, and names and mixing ratios of gases."""
        gases = [entry for gas, vmr in sorted(self.vmr.items()) for entry in (gas, vmr)]
        return self.altitude_m, self.pressure_pa, self.temperature_k, *gases

    def absorption_per_m(self, bands: Sequence[int] = tuple(range(len(rrtmg.BANDS)))) -> FloatArray:
        """Return the absorption [1/m], shape (len(bands), 16, ..., n).

        ``bands`` are places in :data:`horizonval.earth.gases.rrtmg.BANDS`. Where the tables change, at 95.58 hPa,
        levels mix both so that the column stays what it is, see :meth:`upper_share`.
        """
        return rrtmg.absorption_per_m(self.pressure_pa, self.temperature_k, self.vmr, bands, self.upper_share())

    def upper_share(self) -> FloatArray:
        """Return the weight of the upper atmosphere's tables at the levels, shape (..., n).

        Values at levels, joined by straight lines, stand for the air around them: each counts what lies above 95.58 hPa
        of the triangle from its lower to its upper neighbour. A step of the absorption is so smeared over two steps of
        height and keeps its place in each column; taken at the levels themselves it would stand up to half a step too
        high or too low.
        """
        z = self.altitude_m
        ln_p = np.log(self.pressure_pa)
        # The height of the seam by the two levels around it; beyond the column's ends the line goes on.
        i = np.clip(np.sum(ln_p > rrtmg.SEAM_LN_PA, axis=-1) - 1, 0, len(z) - 2)[..., None]
        here, above = np.take_along_axis(ln_p, i, -1), np.take_along_axis(ln_p, i + 1, -1)
        seam = z[i] + (z[i + 1] - z[i]) * (here - rrtmg.SEAM_LN_PA) / (here - above)
        step = np.diff(z)
        below = np.concatenate([step[:1], step])
        over = np.concatenate([step, step[-1:]])
        up = np.clip((z + over - seam) / over, 0.0, 1.0)
        down = np.clip((seam - z + below) / below, 0.0, 1.0)
        total = below + over
        return np.where(seam >= z, over * up**2, total - below * down**2) / total

    def with_halocarbons(self) -> GasState:
        """Return the air with today's halocarbons, see :mod:`horizonval.earth.gases.halocarbons`."""
        added = {gas: np.broadcast_to(x, self.pressure_pa.shape) for gas, x in halocarbons(self.altitude_m).items()}
        return replace(self, vmr={**self.vmr, **added})

    def columns(self) -> GasState:
        """Return a single column as one of many, arrays of shape (1, n)."""
        gases = {gas: x[None, :] for gas, x in self.vmr.items()}
        return GasState(self.altitude_m, self.pressure_pa[None, :], self.temperature_k[None, :], gases)
