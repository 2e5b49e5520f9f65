"""Tables over the rays of one camera position, filled where frames need them.

The plane of place on the row axis (x from 0 to 1) and azimuth is cut into patches of splines. :class:`Knots` says where
the knots are:

- even: patches of one size;
- halved: a patch is fine enough if the splines through every second of its nodes, along rows and along azimuths,
  predict the others within the tolerance. Where the function is smooth the spline through all nodes is then better by a
  factor of 16, where it has a kink by a factor of 2. Otherwise the patch is halved along the axis that needs it. Kinks
  that run along rows, at the top of the air and at the edges of layers, get narrower patches.

Patches are made when rays first fall into them; their values and divisions do not depend on earlier frames.

**A patch** has :data:`INTERVALS` intervals a side. In each direction the spline is

    s(t) = sum_k c_k B(t - k),      B the cubic B-spline on whole numbers,      k = -1 .. INTERVALS + 1

with ``s(i)`` the value at node i and, as it has two coefficients more than there are nodes, no jump of the third
derivative at the first and last inner nodes ("not a knot"). It is of fourth order up to its edges and needs no
neighbours. On an edge it depends on that edge's nodes alone, so that patches of one size join without a step.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import made_once
from horizonval.renderer.kernel.frame_geometry import RayAxis, RayCoordinates
from horizonval.renderer.tables import gather_row, table_of_parts, vectors
from horizonval.renderer.types import Number, Values, Vec

INTERVALS = 8
NODES = INTERVALS + 1
COEFFICIENTS = INTERVALS + 3
VALUES_AT_ONCE = 60_000
"""Half a megabyte of them, as a processor keeps near."""


def spline_matrix(intervals: int) -> FloatArray:
    """Return the matrix from values at nodes to coefficients, shape (intervals + 3, intervals + 1)."""
    size = intervals + 3
    rows = np.zeros((size, size))
    for i in range(intervals + 1):
        rows[i, i : i + 3] = np.array([1.0, 4.0, 1.0]) / 6.0
    # the third derivative is c(k+3) - 3 c(k+2) + 3 c(k+1) - c(k) on an interval; it does not jump
    jump = np.array([1.0, -4.0, 6.0, -4.0, 1.0])
    rows[intervals + 1, :5] = jump
    rows[intervals + 2, size - 5 :] = jump
    right = np.zeros((size, intervals + 1))
    right[: intervals + 1] = np.eye(intervals + 1)
    return np.asarray(np.linalg.solve(rows, right))


@cache
def to_coefficients() -> FloatArray:
    """Return :func:`spline_matrix` of a patch."""
    return spline_matrix(INTERVALS)


@cache
def prediction() -> FloatArray:
    """Return the matrix that makes values at every second node of a patch, from its second on, from the others."""
    half = spline_matrix(INTERVALS // 2)
    out = np.zeros((INTERVALS // 2, len(half)))
    for place in range(INTERVALS // 2):
        out[place, place : place + 4] = spline_weights(0.5)
    return out @ half


def _along(matrix: FloatArray, values: FloatArray, axis: int) -> FloatArray:
    """Return a matrix times values along an axis of (..., NODES, NODES, q), term by term: rounding must not vary."""
    shape = list(values.shape)
    shape[axis - 3] = len(matrix)
    patches, product = values.reshape(-1, *values.shape[-3:]), np.empty((math.prod(shape[:-3]), *shape[-3:]))
    few = max(VALUES_AT_ONCE // math.prod(shape[-3:]), 1)
    for first in range(0, len(patches), few):
        nodes, totals = (np.moveaxis(part[first : first + few], axis - 3, 0) for part in (patches, product))
        term = np.empty(nodes.shape[1:])
        for weights, total in zip(matrix, totals, strict=True):
            np.multiply(nodes[0], weights[0], out=total)
            for node, weight in zip(nodes[1:], weights[1:], strict=True):
                np.multiply(node, weight, out=term)
                total += term
    return product.reshape(shape)


def coefficients_of(values: FloatArray) -> FloatArray:
    """Return coefficients (..., COEFFICIENTS, COEFFICIENTS, q) of patches with values (..., NODES, NODES, q)."""
    return _along(to_coefficients(), _along(to_coefficients(), values, 0), 1)


def predicted(values: FloatArray, axis: int) -> FloatArray:
    """Return values as the splines through every second node along an axis (0, 1) have them, at the nodes between."""
    return _along(prediction(), between(values, axis, 0), axis)


def between(values: FloatArray, axis: int, first: int = 1) -> FloatArray:
    """Return the values of every second node along an axis (0, 1) of (..., NODES, NODES, q)."""
    return values[(..., *[slice(first, None, 2) if k == axis else slice(None) for k in range(2)], slice(None))]


def spline_weights(w: Number) -> list[Number]:
    """Return the weights of four neighbouring coefficients at ``w`` from 0 to 1 in an interval."""
    w2 = w * w
    w3 = w2 * w
    u = 1.0 - w
    return [
        u * u * u * (1.0 / 6.0),
        (3.0 * w3 - 6.0 * w2 + 4.0) * (1.0 / 6.0),
        (-3.0 * w3 + 3.0 * w2 + 3.0 * w + 1.0) * (1.0 / 6.0),
        w3 * (1.0 / 6.0),
    ]


PACKET = 4
MOST_VALUES = 4_000_000
"""That are marched at once; a bound on memory."""
_BLOCK = 64
"""Nodes are marched by multiples of this, so that NumPy's loops have no remainders, which may round otherwise."""
_LEVEL_BITS = 3
_NUMBER_SHIFT = 2 * _LEVEL_BITS
_NOT_MADE = np.uint32(0xFFFFFFFF)
_Patches: TypeAlias = "dict[tuple[int, int], NDArray[np.int64]]"
"""Patches by how often they are halved along rows and azimuths: their numbers along both, shape (n, 2)."""


@dataclass(frozen=True)
class Knots:
    """Where a table has knots: ``rows`` x ``azimuths`` patches all round, or over half a circle if ``mirrored``.

    ``halved``, ``rows_halved``: halvings of a patch at most, along either axis, and along rows without any along
    azimuths; 0 for even knots.
    """

    rows: int
    azimuths: int
    mirrored: bool = False
    halved: int = 0
    rows_halved: int = 0

    @property
    def finest(self) -> tuple[int, int]:
        """Numbers of the smallest patches along rows and azimuths."""
        return self.rows << self.rows_halved, self.azimuths << self.halved

    def place(self, x: mi.Float64, azimuth: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return the share of either axis, from 0 to below 1, that lies before places."""
        turns = azimuth * (0.5 / math.pi)
        turns = turns - dr.floor(turns)
        return _below_one(x), _below_one(2.0 * dr.minimum(turns, 1.0 - turns) if self.mirrored else turns)

    def smallest_at(self, x: mi.Float64, azimuth: mi.Float64) -> mi.UInt32:
        """Return the numbers of the smallest patches at places, row by row."""
        row, column = self.place(x, azimuth)
        rows, columns = (dr.opaque(mi.UInt32, n, 1) for n in self.finest)
        return mi.UInt32(row * mi.Float64(rows)) * columns + mi.UInt32(column * mi.Float64(columns))

    def node_keys(self, patches: NDArray[np.int64], size: tuple[int, int]) -> NDArray[np.int64]:
        """Return numbers that nodes of patches of a size have in common with others at the same places, flat."""
        step = np.arange(NODES, dtype=np.int64)
        finest = self.rows_halved, self.halved
        row, column = ((patches[:, k, None] * INTERVALS + step) << (finest[k] - size[k]) for k in (0, 1))
        return np.asarray((row[:, :, None] * (self.finest[1] * INTERVALS + 1) + column[:, None, :]).ravel())

    def nodes(self, key: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        """Return x and azimuths of nodes."""
        rows, columns = (n * INTERVALS for n in self.finest)
        row, column = np.divmod(key, columns + 1)
        return row * (1.0 / rows), column * ((1.0 if self.mirrored else 2.0) * math.pi / columns)

    def any_in_patches(self, smallest: NDArray[np.bool_], size: tuple[int, int]) -> NDArray[np.bool_]:
        """Return for all patches of a size whether anything holds in the smallest ones that lie in them."""
        rows, columns = self.rows << size[0], self.azimuths << size[1]
        parts = smallest.reshape(rows, smallest.shape[0] // rows, columns, smallest.shape[1] // columns)
        return np.asarray(parts.any(axis=(1, 3)))


HALVED = Knots(8, 8, halved=4, rows_halved=7)
HALVED_AT_EDGES = Knots(16, 8, halved=4, rows_halved=6)
"""Knots for air with layers. The kink at an edge can lie between two nodes of larger patches, where none shows it."""


@dataclass(frozen=True)
class RayPlane:
    """The rays from a camera to the ground or past it, by x from 0 to 1 along their axis and by azimuth."""

    coordinates: RayCoordinates
    to_ground: bool

    @property
    def axis(self) -> RayAxis:
        """The axis."""
        return self.coordinates.ground if self.to_ground else self.coordinates.limb

    def directions(self, x: FloatArray, azimuth: FloatArray) -> Vec:
        """Return unit directions at places, each of shape (n,)."""
        return vectors(self.coordinates.directions(self.axis.value(x), azimuth, self.to_ground))

    def place(self, o: Vec, d: Vec) -> tuple[mi.Float64, mi.Float64]:
        """Return ``(x, azimuth)`` of kernel directions; ``o`` is the camera."""
        steps, azimuth = self.coordinates.place(o, d, self.to_ground)
        return steps * (1.0 / (self.axis.count - 1)), azimuth

    @property
    def camera(self) -> Vec:
        """The camera."""
        return vectors(self.coordinates.origin[None, :])


NodeValues: TypeAlias = "Callable[[FloatArray, FloatArray], FloatArray]"
Allowed: TypeAlias = "Callable[[FloatArray], FloatArray]"


class RayTable:
    """A table that grows; ``patches`` counts its patches, ``rays`` the nodes that were marched for them.

    Parameters
    ----------
    values : callable
        From x in [0, 1] and azimuths [rad], each (n,), to (n, ``quantities``).
    quantities : int
        Filled up with zeros to a multiple of :data:`PACKET`.
    knots : Knots
    allowed : callable, optional
        From values (..., quantities) to the error allowed between the nodes, for patches that are halved.
    single : bool
        Coefficients in single precision, for large tables; differences of frames over a small part of a pixel need
        double precision.
    """

    def __init__(
        self,
        values: NodeValues,
        quantities: int,
        knots: Knots = HALVED,
        allowed: Allowed | None = None,
        *,
        single: bool = False,
    ) -> None:
        self.knots = knots
        self._march_nodes, self._allowed = values, allowed
        self._quantities = -(-quantities // PACKET) * PACKET
        self.rays = 0
        self._divided: dict[tuple[int, int], dict[tuple[int, ...], tuple[int, int]]] = defaultdict(dict)
        self.patches = 0
        self._scalar: Any = mi.Float32 if single else mi.Float64
        self._dtype = np.dtype(np.float32 if single else np.float64)
        self._new: list[NDArray[np.floating]] = []
        # of the patches that the last wave left to be halved: numbers of their nodes, and values there
        self._known = self._nothing_known()
        self._halved_nodes: list[tuple[NDArray[np.int64], FloatArray]] = []
        self._leaves = np.full(knots.finest, _NOT_MADE, dtype=np.uint32)
        self._pool: Any = None
        self._index: mi.UInt32 | None = None

    @property
    def nbytes(self) -> int:
        """Return the memory of the table."""
        each = COEFFICIENTS * COEFFICIENTS * self._quantities * self._dtype.itemsize
        return 2 * self._leaves.nbytes + self.patches * each

    def cover(self, x: mi.Float64, azimuth: mi.Float64) -> None:
        """Make the patches that rays fall into."""
        seen = dr.zeros(mi.UInt32, self._leaves.size)
        dr.scatter(seen, mi.UInt32(1), self.knots.smallest_at(x, azimuth))
        missing = (np.asarray(seen).reshape(self._leaves.shape) > 0) & (self._leaves == _NOT_MADE)
        if not missing.any():
            return
        with made_once("tables"):
            wave = {(0, 0): np.argwhere(self.knots.any_in_patches(missing, (0, 0)))}
            while wave:
                wave = self._halved(self._divide(wave), missing)
            self._known = self._nothing_known()
        coefficients = [*([] if self._pool is None else [np.asarray(self._pool)]), *self._new]
        self._pool = table_of_parts(self._scalar, coefficients)
        self._new.clear()
        self._index = mi.UInt32(self._leaves.ravel())

    def _divide(self, wave: _Patches) -> _Patches:
        """Return the patches of a wave that are not fine enough; what is, is kept. New ones are marched."""
        at_once = max(MOST_VALUES // (NODES * NODES * self._quantities), 1)
        part: _Patches = {}
        for size, patches in wave.items():
            new = np.array([p for p in patches if tuple(p) not in self._divided[size]], dtype=np.int64).reshape(-1, 2)
            while len(new):
                room = at_once - sum(len(p) for p in part.values())
                part[size], new = new[:room], new[room:]
                if len(new) or room == len(part[size]):
                    self._march(part)
                    part = {}
        self._march(part)
        keys, values = (np.concatenate(v) for v in zip(self._nothing_known(), *self._halved_nodes, strict=True))
        self._halved_nodes.clear()
        key, first = np.unique(keys, return_index=True)
        self._known = key, values[first]
        divided = {size: [p for p in patches if tuple(p) in self._divided[size]] for size, patches in wave.items()}
        return {size: np.array(patches) for size, patches in divided.items() if patches}

    def _march(self, part: _Patches) -> None:
        """March patches; keep those that are fine enough, and note along which axes to halve the others."""
        values = self._values_of(part)
        for size, patches in part.items():
            known, values = values[: len(patches)], values[len(patches) :]
            error = self._misses(known)
            finest = (self.knots.halved if size[1] else self.knots.rows_halved, self.knots.halved)
            coarse = np.stack([(e > 1.0) & (n < f) for e, n, f in zip(error, size, finest, strict=True)], axis=1)
            last = ~coarse.any(axis=1)
            self._keep(patches[last], size, known[last])
            keys = self.knots.node_keys(patches[~last], size)
            self._halved_nodes.append((keys, known[~last].reshape(-1, self._quantities)))
            for patch, axes in zip(patches[~last], coarse[~last], strict=True):
                self._divided[size][tuple(patch)] = (int(axes[0]), int(axes[1]))

    def _misses(self, values: FloatArray) -> list[FloatArray]:
        """Return how far off the splines through every second node along either axis are, of what they may."""
        if self._allowed is None:
            return [np.zeros(len(values))] * 2
        allowed = self._allowed(values)
        return [_largest_miss(values, allowed, axis) for axis in (0, 1)]

    def _nothing_known(self) -> tuple[NDArray[np.int64], FloatArray]:
        return np.zeros(0, dtype=np.int64), np.zeros((0, self._quantities))

    def _halved(self, wave: _Patches, missing: NDArray[np.bool_]) -> _Patches:
        """Return those parts of divided patches that rays fall into."""
        parts: dict[tuple[int, int], list[NDArray[np.int64]]] = defaultdict(list)
        for size, patches in wave.items():
            for patch in patches:
                halved = self._divided[size][tuple(patch)]
                corners = np.indices((1 + halved[0], 1 + halved[1])).reshape(2, -1).T
                parts[size[0] + halved[0], size[1] + halved[1]].append(patch * (1 + np.array(halved)) + corners)
        wanted = {}
        for size, pieces in parts.items():
            patches = np.concatenate(pieces)
            seen = patches[self.knots.any_in_patches(missing, size)[patches[:, 0], patches[:, 1]]]
            if len(seen):
                wanted[size] = seen
        return wanted

    def _values_of(self, wave: _Patches) -> FloatArray:
        """Return values at the nodes of patches, (patches, NODES, NODES, quantities); shared nodes are marched once."""
        if not wave:
            return np.zeros((0, NODES, NODES, self._quantities))
        keys = np.concatenate([self.knots.node_keys(p, size) for size, p in wave.items()])
        key, back = np.unique(keys, return_inverse=True)
        values = np.empty((len(key), self._quantities))
        _, mine, theirs = np.intersect1d(key, self._known[0], assume_unique=True, return_indices=True)
        values[mine] = self._known[1][theirs]
        new = np.ones(len(key), dtype=bool)
        new[mine] = False
        wanted = key[new]
        self.rays += len(wanted)
        if len(wanted):
            made = self._march_nodes(*self.knots.nodes(np.pad(wanted, (0, -len(wanted) % _BLOCK), mode="edge")))
            values[new] = np.pad(made[: len(wanted)], ((0, 0), (0, self._quantities - made.shape[1])))
        return values[back.ravel()].reshape(-1, NODES, NODES, self._quantities)

    def _keep(self, patches: NDArray[np.int64], size: tuple[int, int], values: FloatArray) -> None:
        if not len(patches):
            return
        first, halved = self.patches, (self.knots.rows_halved, self.knots.halved)
        rows, columns = (1 << (most - n) for most, n in zip(halved, size, strict=True))
        for k, (i, j) in enumerate(patches):
            leaf = np.uint32((first + k) << _NUMBER_SHIFT | size[0] << _LEVEL_BITS | size[1])
            self._leaves[i * rows : (i + 1) * rows, j * columns : (j + 1) * columns] = leaf
        self.patches += len(values)
        self._new.append(coefficients_of(values).astype(self._dtype))

    def covered(self, x: mi.Float64, azimuth: mi.Float64) -> Values:
        """Return all quantities at places, whose patches are made."""
        self.cover(x, azimuth)
        return self.look(x, azimuth, range(self._quantities // PACKET))

    def look(self, x: mi.Float64, azimuth: mi.Float64, packets: Sequence[int | mi.UInt32]) -> Values:
        """Return the quantities of some packets at places in patches that are made (:meth:`cover`)."""
        assert self._pool is not None
        assert self._index is not None
        leaf = dr.gather(mi.UInt32, self._index, self.knots.smallest_at(x, azimuth))
        halvings = (1 << _LEVEL_BITS) - 1
        row, column = self.knots.place(x, azimuth)
        rows, columns = (dr.opaque(mi.UInt32, n, 1) for n in (self.knots.rows, self.knots.azimuths))
        i, w = _interval(row * mi.Float64(rows << ((leaf >> _LEVEL_BITS) & halvings)))
        j, v = _interval(column * mi.Float64(columns << (leaf & halvings)))
        width = self._quantities // PACKET
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


def _largest_miss(values: FloatArray, allowed: FloatArray, axis: int) -> FloatArray:
    """Return for every patch how far its splines through every second node along an axis are off, of what they may."""
    miss = predicted(values, axis)
    np.subtract(miss, between(values, axis), out=miss)
    np.abs(miss, out=miss)
    np.divide(miss, between(allowed, axis), out=miss)
    return np.asarray(miss.max(axis=(1, 2, 3)))


def _below_one(x: mi.Float64) -> mi.Float64:
    return dr.clip(x, 0.0, 1.0 - 1e-15)


def _interval(place: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
    """Return the interval within its patch, and how far into it, of places counted in patches from the axis' begin."""
    u = (place - dr.floor(place)) * INTERVALS
    i = dr.minimum(mi.UInt32(u), INTERVALS - 1)
    return i, u - mi.Float64(i)
