r"""Tables over the rays of one camera position that a kernel reads by cubic interpolation (Catmull and Rom).

Rows are places on an axis of rays (:mod:`horizonval.renderer.kernel.ray_coordinates`), columns azimuths from 0 to
:math:`\pi`, where what is tabulated is the same on both sides of the camera's meridian since it depends on height and
latitude alone, or else all round. A node is made when a frame first looks near it, and what it holds depends on nothing
that was looked at before.

Node values f are joined by cubics with the slopes ``(f[i + 1] - f[i - 1]) / 2``: smooth, and exact for parabolas.
Beyond the ends of rows one more node lies on the parabola through the last three; beyond those of columns they are
mirrored, or go on from the beginning.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Values, constant, joined

NodeValues: TypeAlias = Callable[[NDArray[np.int64], NDArray[np.int64]], FloatArray]
"""From rows and columns of nodes, both of shape (n,), to values (n, ...)."""

_BLOCK = 64
"""Nodes are made by multiples of this, so that NumPy's loops have no remainders, which may round otherwise."""
_ABSENT = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True)
class Neighbours:
    """The four nodes around places on an axis, and their weights."""

    index: tuple[mi.UInt32, mi.UInt32, mi.UInt32, mi.UInt32]
    weight: Values

    @classmethod
    def on_parabola(cls, place: mi.Float64, count: int) -> Neighbours:
        """Return those of places in steps from the first of ``count`` nodes, next to each other."""
        i, (a, b, c, d) = _interval(place, count)
        first, last = i == 0, i == count - 2
        # the node before the first is 3 f0 - 3 f1 + f2, and so at the other end
        start = mi.UInt32(dr.select(first, 0, dr.select(last, count - 4, i - 1)))
        low, zero = [b + 3.0 * a, c - 3.0 * a, d + a], mi.Float64(0.0)
        high = [a + d, b - 3.0 * d, c + 3.0 * d]
        weight = [
            dr.select(first, at_first, dr.select(last, at_last, inside))
            for at_first, at_last, inside in zip([*low, zero], [zero, *high], [a, b, c, d], strict=True)
        ]
        return cls((start, start + 1, start + 2, start + 3), weight)

    @classmethod
    def mirrored(cls, place: mi.Float64, count: mi.UInt32) -> Neighbours:
        """Return those of places on an axis where what lies beyond an end mirrors what lies before it."""
        i, weight = _interval(place, count)
        return cls((dr.select(i == 0, 1, i - 1), i, i + 1, dr.select(i == count - 2, i, i + 2)), weight)

    @classmethod
    def around(cls, place: mi.Float64, count: mi.UInt32) -> Neighbours:
        """Return those of places on an axis that closes on itself: the last node's neighbour is the first."""
        i, weight = _interval(place, count + 1)
        before, after = dr.select(i == 0, count - 1, i - 1), dr.select(i + 1 == count, 0, i + 1)
        return cls((before, i, after, dr.select(after + 1 == count, 0, after + 1)), weight)


def _interval(place: mi.Float64, count: mi.UInt32 | int) -> tuple[mi.UInt32, Values]:
    """Return the node before places, and the weights of four neighbours."""
    place = dr.clip(place, 0.0, mi.Float64(count) - 1.0)
    i = dr.minimum(mi.UInt32(place), count - 2)
    return i, cubic_weights(place - mi.Float64(i))


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


@dataclass(frozen=True)
class NodeGrid:
    """``rows`` nodes along an axis of rays, ``columns`` in azimuth from 0 to pi; both at least four.

    ``all_round``: the columns go from 0 once round.
    """

    rows: int
    columns: int
    all_round: bool = False

    def node_azimuths(self) -> FloatArray:
        """Return the azimuths of columns [rad]."""
        if self.all_round:
            return np.linspace(0.0, math.tau, self.columns, endpoint=False)
        return np.linspace(0.0, math.pi, self.columns)

    def across(self, azimuth: mi.Float64) -> Neighbours:
        """Return the four columns around azimuths."""
        neighbours = Neighbours.around if self.all_round else Neighbours.mirrored
        return neighbours(self.column(azimuth), self.opaque_columns())

    def opaque_columns(self) -> mi.UInt32:
        """Return ``columns`` as data, for kernels that serve all of them."""
        return dr.opaque(mi.UInt32, self.columns, 1)

    def column(self, azimuth: mi.Float64) -> mi.Float64:
        """Return the place of azimuths from -pi to pi, in steps from the first column."""
        if self.all_round:
            return dr.select(azimuth < 0.0, azimuth + math.tau, azimuth) * constant(self.columns / math.tau)
        return dr.abs(azimuth) * constant((self.columns - 1) / math.pi)

    def near(self, row: mi.Float64, azimuth: mi.Float64) -> NDArray[np.bool_]:
        """Return which nodes are read for rays, shape (rows, columns)."""
        i, _ = _interval(row, self.rows)
        intervals_across = self.columns if self.all_round else self.columns - 1
        across = dr.opaque(mi.UInt32, intervals_across, 1)
        j, _ = _interval(self.column(azimuth), across + 1)
        mask = dr.zeros(mi.UInt32, (self.rows - 1) * intervals_across)
        dr.scatter(mask, mi.UInt32(1), i * across + j)
        intervals = np.array(mask).reshape(self.rows - 1, intervals_across) > 0
        padded = np.pad(intervals, 2)
        if self.all_round:
            padded[:, :2], padded[:, -2:] = padded[:, -4:-2].copy(), padded[:, 2:4].copy()
        # node k serves the intervals k - 2 to k + 1, the ends those that are mirrored there
        along = padded[:-3] | padded[1:-2] | padded[2:-1] | padded[3:]
        # at the ends of rows four nodes are read, one of them with weight 0
        along[3] |= padded[2]
        along[-4] |= padded[-3]
        near = along[:, :-3] | along[:, 1:-2] | along[:, 2:-1] | along[:, 3:]
        # all round the last of them is the first again
        return np.asarray(near[:, :-1] if self.all_round else near)


class NodeTable:
    """Values at those nodes of a grid that were looked at; each node is ``width`` numbers in the kernel's memory."""

    def __init__(self, grid: NodeGrid, width: int) -> None:
        self.grid, self.width = grid, width
        self._slot = np.full((grid.rows, grid.columns), _ABSENT, dtype=np.uint32)
        self._made = 0
        self._values = mi.Float64()
        self._index = mi.UInt32()

    @property
    def nbytes(self) -> int:
        """Memory that the table takes."""
        return self._slot.nbytes * 2 + self._made * self.width * 8

    def cover(self, row: mi.Float64, azimuth: mi.Float64, values: NodeValues) -> None:
        """Make the nodes that rays at places ``row`` [steps] and azimuths [rad] need and that are not here yet."""
        seen = self.grid.near(row, azimuth)
        rows, columns = np.nonzero(seen & (self._slot == _ABSENT))
        count = len(rows)
        if not count:
            return
        filling = -count % _BLOCK
        made = values(*(np.pad(k, (0, filling), mode="edge") for k in (rows, columns)))
        self._slot[rows, columns] = self._made + np.arange(count, dtype=np.uint32)
        self._made += count
        more = table_of(mi.Float64, self._packed(made[:count]))
        self._values = joined([self._values, more]) if self._made > count else more
        self._index = mi.UInt32(self._slot.ravel())
        dr.eval(self._values)

    def _packed(self, values: FloatArray) -> FloatArray:
        """Return values of nodes as they lie in memory, shape (n, width)."""
        raise NotImplementedError

    def _nodes(self, row: mi.Float64, azimuth: mi.Float64) -> list[tuple[mi.UInt32, mi.Float64]]:
        """Return where the sixteen nodes around rays lie, and their weights."""
        down = Neighbours.on_parabola(row, self.grid.rows)
        columns = self.grid.opaque_columns()
        across = self.grid.across(azimuth)
        return [
            (dr.gather(mi.UInt32, self._index, i * columns + j), a * b)
            for i, a in zip(down.index, down.weight, strict=True)
            for j, b in zip(across.index, across.weight, strict=True)
        ]


class SplineTable(NodeTable):
    """Several quantities at every node. More than two are filled up to a multiple of four."""

    def __init__(self, grid: NodeGrid, quantities: int) -> None:
        super().__init__(grid, quantities if quantities <= 2 else -(-quantities // 4) * 4)
        self.quantities = quantities

    def _packed(self, values: FloatArray) -> FloatArray:
        return np.pad(values, ((0, 0), (0, self.width - self.quantities)))

    def look(self, row: mi.Float64, azimuth: mi.Float64) -> Values:
        """Return all quantities at places ``row`` [steps] and azimuths [rad]; what is below 0 counts as 0.

        Light is never negative, but the cubic through it dips below where the air ends.
        """
        total = [mi.Float64(0.0)] * self.width
        for node, weight in self._nodes(row, azimuth):
            for q, value in enumerate(gather_row(self._values, node, self.width)):
                total[q] = dr.fma(weight, value, total[q])
        return [dr.maximum(value, 0.0) for value in total[: self.quantities]]


class StationTable(NodeTable):
    """Two quantities at stations along rays.

    Of a node lie in memory both quantities of a station and of the next, for one station after the other, so that two
    gathers fetch four stations.
    """

    def __init__(self, grid: NodeGrid, stations: int) -> None:
        super().__init__(grid, 4 * stations)
        self.stations = stations

    def _packed(self, values: FloatArray) -> FloatArray:
        following = np.concatenate([values[:, 1:], values[:, -1:]], axis=1)
        return np.concatenate([values, following], axis=-1).reshape(len(values), self.width)

    def look(self, row: mi.Float64, azimuth: mi.Float64, along: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return both quantities; ``along`` from 0 at the first station to 1 at the last."""
        far = Neighbours.on_parabola(along * (self.stations - 1.0), self.stations)
        p, q = mi.Float64(0.0), mi.Float64(0.0)
        for node, weight in self._nodes(row, azimuth):
            near, last = (gather_row(self._values, node * self.stations + far.index[k], 4) for k in (0, 2))
            for f, pair, h in zip(far.weight, (near, near, last, last), (0, 2, 0, 2), strict=True):
                p = dr.fma(weight * f, pair[h], p)
                q = dr.fma(weight * f, pair[h + 1], q)
        return p, q
