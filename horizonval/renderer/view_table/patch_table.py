"""Tables over the rays of one camera position, made where they are looked at and as fine as they need to be.

The plane of place on the row axis (x from 0 to 1) and azimuth is cut into :data:`ROW_TILES` x :data:`AZIMUTH_TILES`
tiles. A tile is made, as a whole, when a frame first sees a part of it: what it holds depends on nothing that was seen
before. It is one patch of splines (:mod:`horizonval.renderer.view_table.spline_patch`), or four patches of half the
size, and so on down to :data:`FINEST`. A patch is fine enough if the spline through every second node foretells the
others within the tolerance: where the function is smooth the spline through all nodes is then better by a factor of 16,
where it has a kink by a factor of 2. Patches that are still too coarse at the end, on lines where the function jumps,
are marked as rough: rays in them are to be marched.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.once import made_once
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Values
from horizonval.renderer.view_table.spline_patch import (
    COEFFICIENTS,
    INTERVALS,
    NODES,
    coefficients_of,
    foretold,
    spline_weights,
)

ROW_TILES, AZIMUTH_TILES = 8, 8
FINEST = 5
"""Halvings of a tile, at most."""
PACKET = 4
_LEVEL_BITS = 3
_ROUGH = 1 << (2 * _LEVEL_BITS)
_NUMBER_SHIFT = 2 * _LEVEL_BITS + 1
_NOT_MADE = np.uint32(0xFFFFFFFF)


@dataclass(frozen=True)
class Tabulated:
    """What a table holds.

    Attributes
    ----------
    values : callable
        From places x in [0, 1] and azimuths [rad], each of shape (n,), to values of shape (n, quantities).
    allowed : callable
        From values (..., quantities) to the error that each may have between the nodes.
    quantities : int
        A multiple of :data:`PACKET`.
    """

    values: Callable[[FloatArray, FloatArray], FloatArray]
    allowed: Callable[[FloatArray], FloatArray]
    quantities: int


class PatchTable:
    """A table that grows; ``patches`` counts its patches, ``rays`` the values that were asked for."""

    def __init__(self, tabulated: Tabulated) -> None:
        self.tabulated = tabulated
        self.rays = 0
        self._made = np.zeros(ROW_TILES * AZIMUTH_TILES, dtype=bool)
        self._coefficients: list[NDArray[np.float32]] = []
        self._leaves = np.full((ROW_TILES << FINEST, AZIMUTH_TILES << FINEST), _NOT_MADE, dtype=np.uint32)
        self._any_rough = False
        self._pool: mi.Float32 | None = None
        self._index: mi.UInt32 | None = None

    @property
    def patches(self) -> int:
        """Return how many patches there are."""
        return sum(len(c) for c in self._coefficients)

    @property
    def size_bytes(self) -> int:
        """Return the memory of the table."""
        return self._leaves.nbytes + 2 * sum(c.nbytes for c in self._coefficients)

    def cover(self, x: mi.Float64, azimuth: mi.Float64) -> None:
        """Make the tiles that rays fall into."""
        row, column = _tile_of(x, azimuth, 0)
        seen = dr.zeros(mi.UInt32, ROW_TILES * AZIMUTH_TILES)
        dr.scatter(seen, mi.UInt32(1), row * AZIMUTH_TILES + column)
        missing = np.flatnonzero((np.array(seen) > 0) & ~self._made)
        if not missing.size:
            return
        self._made[missing] = True
        with made_once("tables"):
            self._make(np.stack([missing // AZIMUTH_TILES, missing % AZIMUTH_TILES], axis=1))
        self._pool = table_of(mi.Float32, np.concatenate(self._coefficients))
        self._index = mi.UInt32(self._leaves.ravel())

    def _make(self, tiles: NDArray[np.int64]) -> None:
        """Make tiles (n, 2): halve patches along the axes that need it until all are fine enough."""
        waiting = {(0, 0): tiles}
        while waiting:
            size = min(waiting)
            patches = waiting.pop(size)
            values = self._values_of(patches, size)
            allowed = self.tabulated.allowed(values)
            error = [(np.abs(foretold(values, axis) - values) / allowed).max(axis=(1, 2, 3)) for axis in (0, 1)]
            coarse = [(e > 1.0) & (halvings < FINEST) for e, halvings in zip(error, size, strict=True)]
            last = ~(coarse[0] | coarse[1])
            self._keep(patches[last], size, values[last], np.maximum(*error)[last] > 1.0)
            for halved in ((1, 0), (0, 1), (1, 1)):
                chosen = patches[(coarse[0] == halved[0]) & (coarse[1] == halved[1])]
                if not len(chosen):
                    continue
                parts = np.stack(np.meshgrid(*(np.arange(1 + h) for h in halved), indexing="ij"), axis=-1).reshape(
                    -1, 2
                )
                children = (chosen[:, None] * (1 + np.array(halved)) + parts).reshape(-1, 2)
                finer = (size[0] + halved[0], size[1] + halved[1])
                waiting[finer] = np.concatenate([waiting.get(finer, children[:0]), children])

    def _values_of(self, patches: NDArray[np.int64], size: tuple[int, int]) -> FloatArray:
        """Return values at the nodes of patches, shape (patches, NODES, NODES, quantities)."""
        steps = np.arange(NODES) / INTERVALS
        x = (patches[:, :1] + steps) / (ROW_TILES << size[0])
        azimuth = (patches[:, 1:] + steps) * (2.0 * math.pi / (AZIMUTH_TILES << size[1]))
        shape = (len(patches), NODES, NODES)
        every_x = np.broadcast_to(x[:, :, None], shape).ravel()
        every_azimuth = np.broadcast_to(azimuth[:, None, :], shape).ravel()
        self.rays += every_x.size
        return self.tabulated.values(every_x, every_azimuth).reshape(*shape, -1)

    def _keep(
        self, patches: NDArray[np.int64], size: tuple[int, int], values: FloatArray, rough: NDArray[np.bool_]
    ) -> None:
        if not len(patches):
            return
        first, rows, columns = self.patches, 1 << (FINEST - size[0]), 1 << (FINEST - size[1])
        for k, (i, j) in enumerate(patches):
            leaf = np.uint32((first + k) << _NUMBER_SHIFT | _ROUGH * int(rough[k]) | size[0] << _LEVEL_BITS | size[1])
            self._leaves[i * rows : (i + 1) * rows, j * columns : (j + 1) * columns] = leaf
        self._any_rough |= bool(rough.any())
        self._coefficients.append(coefficients_of(values).astype(np.float32))

    def _leaf(self, x: mi.Float64, azimuth: mi.Float64) -> mi.UInt32:
        assert self._index is not None
        row, column = _tile_of(x, azimuth, FINEST)
        return dr.gather(mi.UInt32, self._index, row * (AZIMUTH_TILES << FINEST) + column)

    def rough(self, x: mi.Float64, azimuth: mi.Float64) -> mi.Bool | None:
        """Return whether places, in tiles that are covered, lie in patches that miss the tolerance; None: nowhere."""
        return (self._leaf(x, azimuth) & _ROUGH) != 0 if self._any_rough else None

    def look(self, x: mi.Float64, azimuth: mi.Float64, packets: Sequence[int]) -> Values:
        """Return the quantities of some packets at places in tiles that are covered."""
        assert self._pool is not None
        leaf = self._leaf(x, azimuth)
        halvings = (1 << _LEVEL_BITS) - 1
        rows, columns = ROW_TILES << ((leaf >> _LEVEL_BITS) & halvings), AZIMUTH_TILES << (leaf & halvings)
        i, w = _interval(_below_one(x) * mi.Float64(rows))
        j, v = _interval(_turns(azimuth) * mi.Float64(columns))
        width = self.tabulated.quantities // PACKET
        start = (leaf >> _NUMBER_SHIFT) * (COEFFICIENTS * COEFFICIENTS) + i * COEFFICIENTS + j
        down, across = spline_weights(w), spline_weights(v)
        total = [mi.Float64(0.0)] * (PACKET * len(packets))
        for a, weight_a in enumerate(down):
            for b, weight_b in enumerate(across):
                weight = weight_a * weight_b
                node = (start + (a * COEFFICIENTS + b)) * width
                for p, packet in enumerate(packets):
                    for q, value in enumerate(gather_row(self._pool, node + packet, PACKET)):
                        k = p * PACKET + q
                        total[k] = dr.fma(weight, mi.Float64(value), total[k])
        return total


def _turns(azimuth: mi.Float64) -> mi.Float64:
    """Return azimuths in turns from 0 to below 1."""
    turns = azimuth * (0.5 / math.pi)
    return _below_one(turns - dr.floor(turns))


def _below_one(x: mi.Float64) -> mi.Float64:
    return dr.clip(x, 0.0, 1.0 - 1e-15)


def _tile_of(x: mi.Float64, azimuth: mi.Float64, level: int) -> tuple[mi.UInt32, mi.UInt32]:
    return mi.UInt32(_below_one(x) * (ROW_TILES << level)), mi.UInt32(_turns(azimuth) * (AZIMUTH_TILES << level))


def _interval(place: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
    """Return the interval within its patch, and how far into it, of places counted in patches from the axis' begin."""
    u = (place - dr.floor(place)) * INTERVALS
    i = dr.minimum(mi.UInt32(u), INTERVALS - 1)
    return i, u - mi.Float64(i)
