"""Clear air for thermal bands: pressure, temperature and all gases of one column or many.

**Halocarbons** are CFC-11, CFC-12, HCFC-22 and carbon tetrachloride, the same amounts for any year: well mixed to 16
km; above, photolysis reduces their scale height to 5 km relative to the air. They raise the radiance of the US standard
limb at a tangent height of 10 km by 10 % in 8 to 14 um and 80 % in 10.5 to 12.5 um, and by less than 0.02 % in 14.0 to
16.3 um. The amounts are within 10 % from 2010 to 2035, too large before 1980. RRTMG has their cross sections at one
temperature, in bands 5, 6 and 8 only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases import rrtmg

SURFACE_VMR = {"cfc11": 219e-12, "cfc12": 490e-12, "hcfc22": 250e-12, "ccl4": 76e-12}
"""Parts of dry air, about 2022 (global network means of NOAA and AGAGE, rounded)."""
MIXED_TO_M, SCALE_HEIGHT_M = 16_000.0, 5000.0


def halocarbons(altitude_m: FloatArray) -> dict[str, FloatArray]:
    """Return the mixing ratios at altitudes, each of their shape."""
    share = np.exp(-np.maximum(np.asarray(altitude_m, dtype=np.float64) - MIXED_TO_M, 0.0) / SCALE_HEIGHT_M)
    return {gas: vmr * share for gas, vmr in SURFACE_VMR.items()}


@dataclass(frozen=True)
class GasState:
    """Columns of clear air on common altitudes (n,).

    ``pressure_pa``, ``temperature_k``: shape (..., n); ``vmr``: volume mixing ratios, shape (..., n), of the gases that
    :func:`horizonval.earth.gases.rrtmg.absorption_per_m` knows.
    """

    altitude_m: FloatArray
    pressure_pa: FloatArray
    temperature_k: FloatArray
    vmr: Mapping[str, FloatArray]

    def contents(self) -> tuple[FloatArray | str, ...]:
        """Return heights, pressure, temperature, and names and mixing ratios of gases, which define the columns."""
        gases = [entry for gas, vmr in sorted(self.vmr.items()) for entry in (gas, vmr)]
        return self.altitude_m, self.pressure_pa, self.temperature_k, *gases

    def absorption_per_m(self, bands: Sequence[int] = tuple(range(len(rrtmg.BANDS)))) -> FloatArray:
        """Return the absorption [1/m], shape (len(bands), 16, ..., n).

        ``bands`` are indices into :data:`horizonval.earth.gases.rrtmg.BANDS`. Where the tables change, at 95.58 hPa,
        levels mix both so that the column is preserved, see :meth:`upper_share`.
        """
        return rrtmg.absorption_per_m(self.pressure_pa, self.temperature_k, self.vmr, bands, self.upper_share())

    def upper_share(self) -> FloatArray:
        """Return the weight of the upper atmosphere's tables at the levels, shape (..., n).

        Values at levels, joined by straight lines, represent the air around them. The weight of a level is the part
        above 95.58 hPa of the triangle from its lower to its upper neighbour. A step of the absorption is thus smoothed
        over two steps of height and keeps its height in each column; evaluated at the levels alone it would be up to
        half a step too high or too low.
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
        """Return the air with today's halocarbons."""
        added = {gas: np.broadcast_to(x, self.pressure_pa.shape) for gas, x in halocarbons(self.altitude_m).items()}
        return replace(self, vmr={**self.vmr, **added})

    def columns(self) -> GasState:
        """Return a single column with shape (1, n)."""
        gases = {gas: x[None, :] for gas, x in self.vmr.items()}
        return GasState(self.altitude_m, self.pressure_pa[None, :], self.temperature_k[None, :], gases)
