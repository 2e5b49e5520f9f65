"""Tables over rays that a kernel reads by cubic interpolation (Catmull and Rom): smooth, and exact for parabolas.

Node values f are joined by cubics with the slopes ``(f[i + 1] - f[i - 1]) / 2``. Beyond the ends of an axis one more
node is made from the parabola through the last three.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Values


def cubic_weights(w: mi.Float64) -> Values:
    """Return the weights of four neighbours at ``w`` from 0 to 1 between the middle two."""
    w2 = w * w
    w3 = w2 * w
    return [
        0.5 * (2.0 * w2 - w - w3),
        0.5 * (2.0 - 5.0 * w2 + 3.0 * w3),
        0.5 * (w + 4.0 * w2 - 3.0 * w3),
        0.5 * (w3 - w2),
    ]


def with_ghosts(values: FloatArray, axis: int = 0) -> FloatArray:
    """Return the values with one more node at either end of an axis."""
    v = np.moveaxis(values, axis, 0)
    low, high = 3.0 * v[0] - 3.0 * v[1] + v[2], 3.0 * v[-1] - 3.0 * v[-2] + v[-3]
    return np.moveaxis(np.concatenate([low[None], v, high[None]]), 0, axis)


@dataclass(frozen=True)
class Azimuths:
    """Nodes in azimuth on a fixed division of the circle: ``count`` steps of ``whole`` from the node ``first`` on.

    ``count == whole`` is the full circle.
    """

    whole: int
    first: int
    count: int

    def node_azimuths(self) -> FloatArray:
        """Return the azimuths [rad] at which values are needed."""
        extra = 0 if self.count == self.whole else 3
        start = self.first - (1 if extra else 0)
        return np.asarray((start + np.arange(self.count + extra)) * (2.0 * math.pi / self.whole), dtype=np.float64)

    def padded(self, values: FloatArray) -> FloatArray:
        """Return values over :meth:`node_azimuths` (second axis) with a neighbour before and two after."""
        if self.count != self.whole:
            return values
        return np.concatenate([values[:, -1:], values, values[:, :2]], axis=1)

    @property
    def columns(self) -> int:
        """Length of the padded axis."""
        return self.count + 3

    def place(self, azimuth: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
        """Return the lowest of the four neighbours (padded index) and the weight between the middle two."""
        whole = float(self.whole)
        u = azimuth * (whole / (2.0 * math.pi)) - dr.opaque(mi.Float64, float(self.first), 1)
        u = u - whole * dr.floor(u * (1.0 / whole))
        count = dr.opaque(mi.Float64, float(self.count), 1)
        u = dr.clip(u, 0.0, count)
        j = dr.minimum(mi.UInt32(u), mi.UInt32(count) - 1)
        return j, u - mi.Float64(j)


def azimuths_in_view(azimuth: FloatArray, coarsest: int, least: int = 48) -> Azimuths:
    """Return nodes for a frame along whose outline, followed once around, rays have these azimuths.

    The circle is divided by ``coarsest`` or its doubles, so that a narrow frame has at least ``least`` steps. An
    outline that winds around nadir or zenith has all azimuths in it.
    """
    turns = np.diff(np.concatenate([azimuth, azimuth[:1]]))
    turns -= 2.0 * math.pi * np.round(turns / (2.0 * math.pi))
    along = azimuth[0] + np.concatenate([[0.0], np.cumsum(turns[:-1])])
    width = float(along.max() - along.min())
    if abs(float(turns.sum())) > 1.0 or np.abs(turns).max() > 1.0 or width > math.radians(300.0):
        return Azimuths(coarsest, 0, coarsest)
    doublings = max(0, math.ceil(math.log2(least / max(width / (2.0 * math.pi) * coarsest, 1e-3))))
    whole = coarsest << min(doublings, 8)
    per_node = whole / (2.0 * math.pi)
    first = math.floor(float(along.min()) * per_node) - 2
    count = math.ceil(float(along.max()) * per_node) + 2 - first
    return Azimuths(coarsest, 0, coarsest) if count >= whole else Azimuths(whole, first, count)


@dataclass(frozen=True)
class SplineTable:
    """Values on rows (places on an axis of rays), columns (azimuths) and several quantities.

    ``values``: Float64 of shape (rows + 2, columns, width), flat; ``width`` is the number of quantities, filled up to a
    multiple of four if there are more than two.
    """

    values: mi.Float64
    rows: int
    azimuths: Azimuths
    quantities: int
    width: int

    @classmethod
    def of(cls, values: FloatArray, azimuths: Azimuths) -> SplineTable:
        """Build from values of shape (rows, node azimuths, quantities)."""
        rows, _, quantities = values.shape
        width = quantities if quantities <= 2 else -(-quantities // 4) * 4
        padded = azimuths.padded(with_ghosts(values))
        full = np.zeros((*padded.shape[:2], width))
        full[..., :quantities] = padded
        return cls(table_of(mi.Float64, full), rows, azimuths, quantities, width)

    def look(self, row: mi.Float64, azimuth: mi.Float64) -> list[mi.Float64]:
        """Return all quantities at places ``row`` [steps] and azimuths [rad]; what is below 0 counts as 0.

        Light is never negative, but the cubic through it dips below where the air ends.
        """
        return [dr.maximum(value, 0.0) for value in self.look_signed(row, azimuth)]

    def look_signed(self, row: mi.Float64, azimuth: mi.Float64) -> list[mi.Float64]:
        """Return all quantities at places ``row`` [steps] and azimuths [rad] that may be negative."""
        i, w = row_of(row, self.rows)
        j, v = self.azimuths.place(azimuth)
        down, across = cubic_weights(w), cubic_weights(v)
        columns = dr.opaque(mi.UInt32, self.azimuths.columns, 1)
        total = [mi.Float64(0.0)] * self.width
        for a, weight_a in enumerate(down):
            start = (i + a) * columns + j
            for b, weight_b in enumerate(across):
                weight = weight_a * weight_b
                for q, value in enumerate(self._gather(start + b)):
                    total[q] = dr.fma(weight, value, total[q])
        return total[: self.quantities]

    def _gather(self, node: mi.UInt32) -> Values:
        if self.width <= 2:
            return gather_row(self.values, node, self.width)
        packets = self.width // 4
        return [v for k in range(packets) for v in gather_row(self.values, node * packets + k, 4)]


def row_of(place: mi.Float64, rows: int) -> tuple[mi.UInt32, mi.Float64]:
    """Return the lowest of the four neighbouring rows (ghost included) and the weight between the middle two."""
    i = dr.minimum(mi.UInt32(dr.maximum(place, 0.0)), rows - 2)
    return i, place - mi.Float64(i)


@dataclass(frozen=True)
class StationTable:
    """Two quantities at stations along rays, over rows and azimuths.

    ``values``: Float64 of shape (rows + 2, columns, stations + 2, 4), flat: both quantities of a station and of the
    next, so that two gathers fetch four stations.
    """

    values: mi.Float64
    rows: int
    azimuths: Azimuths
    stations: int

    @classmethod
    def of(cls, values: NDArray[np.float64], azimuths: Azimuths) -> StationTable:
        """Build from values of shape (rows, node azimuths, stations, 2)."""
        padded = with_ghosts(azimuths.padded(with_ghosts(values)), axis=2)
        following = np.concatenate([padded[:, :, 1:], padded[:, :, -1:]], axis=2)
        packed = np.concatenate([padded, following], axis=-1)
        return cls(table_of(mi.Float64, packed), len(values), azimuths, values.shape[2])

    def look(self, row: mi.Float64, azimuth: mi.Float64, along: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return both quantities; ``along`` from 0 at the first station to 1 at the last."""
        i, w = row_of(row, self.rows)
        j, v = self.azimuths.place(azimuth)
        k, u = row_of(dr.clip(along, 0.0, 1.0) * (self.stations - 1.0), self.stations)
        down, across, far = cubic_weights(w), cubic_weights(v), cubic_weights(u)
        columns = dr.opaque(mi.UInt32, self.azimuths.columns, 1)
        p, q = mi.Float64(0.0), mi.Float64(0.0)
        for a, weight_a in enumerate(down):
            for b, weight_b in enumerate(across):
                start = ((i + a) * columns + j + b) * (self.stations + 2) + k
                near, next_ = (gather_row(self.values, start + s, 4) for s in (0, 2))
                weight = weight_a * weight_b
                for f, g, h in zip(far, (near, near, next_, next_), (0, 2, 0, 2), strict=True):
                    p = dr.fma(weight * f, g[h], p)
                    q = dr.fma(weight * f, g[h + 1], q)
        return p, q
