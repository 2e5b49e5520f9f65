r"""Emitting air for the Monte Carlo reference: extinction and source function of every g point, and a majorant.

What the column of a thermal band says (:class:`horizonval.earth.atmosphere.emission.EmittingBand`) on even heights:
linear in height, and linear in the sine of latitude between rows. No code of the march has a part in it.

Opaque air is made less opaque where nothing of it can be seen: below the height where the optical depth straight up is
:data:`UNSEEN`, the extinction stays what it is there. The light of what lies deeper is a share of ``exp(-20)``, 2e-9,
and a path through the air above does not have to walk in steps of metres.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import constant

UNSEEN = 20.0
STEP_M = 50.0
"""Half a step of the band's own grid."""
MAJORANT_STEP_M = 1000.0


@dataclass(frozen=True)
class AirTables:
    """A band's air in the kernel's memory, Float32, g points outermost.

    ``extinction`` [1/m] and ``source`` [W m-2 sr-1]: shape (g, rows, heights), flat. ``majorant`` [1/m], shape
    (g, levels): the largest extinction at a height and above, on all rows. ``low``, ``per_row`` place the rows on the
    sine of latitude.
    """

    extinction: mi.Float32
    source: mi.Float32
    majorant: mi.Float32
    rows: int
    heights: int
    levels: int
    low: mi.Float64
    per_row: mi.Float64
    top_m: mi.Float64

    @classmethod
    def of(cls, band: EmittingBand) -> AirTables:
        """Build from a band without a map of columns."""
        top = float(band.altitude_m[-1])
        z = np.linspace(0.0, top, 1 + round(top / STEP_M))
        coarse_extinction, coarse_source = band.columns()
        extinction = _seen(_on(z, band.altitude_m, coarse_extinction), z)
        source = _on(z, band.altitude_m, coarse_source)
        above = np.maximum.accumulate(extinction.max(axis=1)[:, ::-1], axis=-1)[:, ::-1]
        level = np.arange(0.0, top + MAJORANT_STEP_M, MAJORANT_STEP_M)
        # of the node below each level: never too small
        node = np.clip((level / (z[1] - z[0])).astype(int), 0, len(z) - 1)
        rows = len(band.sin_latitude)
        low = float(band.sin_latitude[0])
        span = float(band.sin_latitude[-1]) - low
        return cls(
            table_of(mi.Float32, extinction),
            table_of(mi.Float32, source),
            table_of(mi.Float32, above[:, node] * (1.0 + 1e-5)),
            rows,
            len(z),
            len(level),
            constant(low),
            constant((rows - 1) / span if rows > 1 else 0.0),
            constant(top),
        )

    def at(self, g: mi.UInt32, height_m: mi.Float64, sine: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return extinction and source of g points at heights and sines of latitude; nothing above the top."""
        x = dr.clip(height_m * ((self.heights - 1) / self.top_m), 0.0, self.heights - 1.0)
        i = dr.minimum(mi.UInt32(x), self.heights - 2)
        up = x - mi.Float64(i)
        corners = [(g * self.rows, mi.Float64(1.0))]
        if self.rows > 1:
            y = dr.clip((sine - self.low) * self.per_row, 0.0, self.rows - 1.0)
            row = dr.minimum(mi.UInt32(y), self.rows - 2)
            north = y - mi.Float64(row)
            corners = [(g * self.rows + row, 1.0 - north), (g * self.rows + row + 1, north)]
        extinction, source = mi.Float64(0.0), mi.Float64(0.0)
        for line, share in corners:
            for k, w in ((i, share * (1.0 - up)), (i + 1, share * up)):
                place = line * self.heights + k
                extinction += w * mi.Float64(dr.gather(mi.Float32, self.extinction, place))
                source += w * mi.Float64(dr.gather(mi.Float32, self.source, place))
        return dr.select(height_m <= self.top_m, extinction, 0.0), source

    def most_above(self, g: mi.UInt32, height_m: mi.Float64) -> mi.Float64:
        """Return what no extinction at these heights and above exceeds; 0 above the top."""
        i = dr.minimum(mi.UInt32(dr.maximum(height_m, 0.0) / MAJORANT_STEP_M), self.levels - 1)
        value = mi.Float64(dr.gather(mi.Float32, self.majorant, g * self.levels + i))
        return dr.select(height_m < self.top_m, value, 0.0)


def _on(z: FloatArray, altitude_m: FloatArray, values: FloatArray) -> FloatArray:
    i = np.clip(np.searchsorted(altitude_m, z, side="right") - 1, 0, len(altitude_m) - 2)
    w = (z - altitude_m[i]) / (altitude_m[i + 1] - altitude_m[i])
    return np.asarray(values[..., i] * (1.0 - w) + values[..., i + 1] * w)


def _seen(extinction: FloatArray, z: FloatArray) -> FloatArray:
    """Return columns whose extinction stays the same below the height where nothing is seen any more."""
    layer = 0.5 * (extinction[..., 1:] + extinction[..., :-1]) * np.diff(z)
    above = np.zeros_like(extinction)
    above[..., :-1] = np.cumsum(layer[..., ::-1], axis=-1)[..., ::-1]
    deepest = np.argmax(above < UNSEEN, axis=-1)[..., None]
    there = np.take_along_axis(extinction, deepest, axis=-1)
    return np.where(np.arange(len(z)) < deepest, there, extinction)
