r"""Altitude profiles and the Sun's optical depth as tables that a kernel reads.

Profiles are linear in altitude between the nodes of one common grid and zero above the top. The nodes of a batch lie
side by side in memory, so that one packet gather serves the batch.

The optical depth towards the Sun from height ``h`` under solar zenith cosine ``mu`` is tabulated on::

    h  = top x_r^2,          mu = mu_h + (1 - mu_h) x_mu^2,      mu_h = -sqrt(h (2 R + h)) / (R + h)

``mu_h`` is the cosine of the geometric horizon seen from ``h``, so the table never straddles the shadow edge, and the
squares put nodes where the optical depth bends most: near the ground and near the horizon. Stored is
``ln(tau + tau_0)``, ``tau_0 = 1e-12``: nearly linear along both axes, so bilinear interpolation serves.

**Tables over the rays of one camera position** are read by cubic interpolation (Catmull and Rom). Rows are places on an
axis of rays (:mod:`horizonval.renderer.kernel.frame_geometry`), columns azimuths from 0 to :math:`\pi` for functions
of height and latitude alone, which are symmetric about the camera's meridian, or else all
round. A node is made when a frame first needs it; its values do not depend on earlier frames.

Node values f are joined by cubics with the slopes ``(f[i + 1] - f[i - 1]) / 2``: smooth, and exact for parabolas.
Beyond the ends of rows one more node lies on the parabola through the last three; beyond those of columns they are
mirrored, or periodic.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.types import Real, Values, Vec, constant, joined

TAU_FLOOR = 1e-12

_ALIGNMENT = 128


def gather_row(table: Real, index: mi.UInt32, width: int) -> list[Real]:
    """Return the ``width`` neighbouring entries of a flat table at row ``index``."""
    if width % 4 == 0:
        scalar: Any = type(table)
        packet = packet_type(scalar)
        packets = [dr.gather(packet, table, index * (width // 4) + k) for k in range(width // 4)]
        return [values[k] for values in packets for k in range(4)]
    return [dr.gather(type(table), table, index * width + k) for k in range(width)]


def table_of(scalar: type[Real], values: NDArray[np.floating]) -> Real:
    """Return values as a flat array of the type ``scalar`` (Float32 or Float64), fit for :func:`gather_row`.

    Dr.Jit reads NumPy's memory in place, and gathers packets and loads vectors with one instruction only where they are
    aligned. NumPy's alignment varies, and every combination would be another kernel to compile.
    """
    return table_of_parts(scalar, [values])


def table_of_parts(scalar: type[Real], parts: Sequence[NDArray[np.floating]]) -> Real:
    """Return the values of arrays, one behind the other, as :func:`table_of`: large ones are copied once."""
    dtype = np.dtype(np.float32 if dr.type_v(scalar) == dr.VarType.Float32 else np.float64)
    size = sum(part.size for part in parts)
    room = np.empty(size * dtype.itemsize + _ALIGNMENT, dtype=np.uint8)
    first = -room.ctypes.data % _ALIGNMENT
    aligned = room[first : first + size * dtype.itemsize].view(dtype)
    filled = 0
    for part in parts:
        aligned[filled : filled + part.size] = part.ravel()
        filled += part.size
    return scalar(aligned)


def vectors(v: FloatArray) -> Vec:
    """Return rows (n, 3) as three kernel arrays."""
    x, y, z = (table_of(mi.Float64, v[:, k]) for k in range(3))
    return x, y, z


@cache
def packet_type(scalar: type[Real]) -> Any:
    """Return the type of four neighbouring Float32 or Float64 values."""
    module = dr.cuda if dr.backend_v(scalar) == dr.JitBackend.CUDA else dr.llvm
    return module.ad.Array4f if dr.type_v(scalar) == dr.VarType.Float32 else module.ad.Array4f64


def _at(nodes: mi.Float64, i: mi.UInt32) -> Any:
    return dr.gather(mi.Float64, nodes, i)


@dataclass(frozen=True)
class AltitudeGrid:
    """Where on the common altitude grid a height lies. Uniform grids need no search."""

    altitude_m: mi.Float64
    count: int
    step_m: float | None

    @classmethod
    def of(cls, altitude_m: NDArray[np.float64]) -> AltitudeGrid:
        """Build from rising altitudes [m]."""
        steps = np.diff(altitude_m)
        uniform = bool(np.all(np.abs(steps - steps[0]) <= 1e-9 * altitude_m[-1]))
        return cls(
            table_of(mi.Float64, altitude_m), len(altitude_m), float(altitude_m[-1]) / len(steps) if uniform else None
        )

    def locate(self, height_m: Real) -> tuple[mi.UInt32, Real, mi.Bool]:
        """Return ``(i, w, inside)``: lower node, weight of the upper one, and whether the height is at most the top.

        Heights below 0 (rounding at the ground) count as 0. On even grids they may be single.
        """
        if self.step_m is not None:
            x = dr.maximum(height_m, 0.0) * (1.0 / self.step_m)
            i = dr.minimum(mi.UInt32(dr.minimum(x, self.count)), self.count - 2)
            w = x - type(x)(i)
        else:
            i = dr.binary_search(1, self.count - 1, lambda k: _at(self.altitude_m, k) <= height_m)
            i = mi.UInt32(i) - 1
            low, high = _at(self.altitude_m, i), _at(self.altitude_m, i + 1)
            w = dr.maximum(height_m - low, 0.0) / (high - low)
        return i, dr.minimum(w, 1.0), w <= 1.0 + 1e-9


def interpolate(table: Real, i: mi.UInt32, w: Real, width: int, stride: int = 1) -> list[Real]:
    """Return a row's values linear between rows ``i`` and ``i + stride``."""
    low, high = gather_row(table, i, width), gather_row(table, i + stride, width)
    return [dr.fma(b - a, w, a) for a, b in zip(low, high, strict=True)]


@dataclass(frozen=True)
class SunShell:
    """A layer of thin cloud in the way of sunlight.

    Extinction [1/m] per node between two heights, path lengths exact.
    """

    base_m: mi.Float64
    top_m: mi.Float64
    per_m: Values

    def depth(self, height_m: mi.Float64, mu: mi.Float64, radius_m: float) -> Values:
        """Return the optical depth per node from points outwards, towards a zenith cosine, over a sphere."""
        r = radius_m + height_m
        forth = r * mu
        miss2 = dr.fma(-forth, forth, r * r)

        def inside(edge_m: mi.Float64) -> mi.Float64:
            x = radius_m + edge_m
            half = dr.sqrt(dr.maximum(dr.fma(x, x, -miss2), 0.0))
            return dr.maximum(half - dr.maximum(forth, -half), 0.0)

        length = inside(self.top_m) - inside(self.base_m)
        return [k * length for k in self.per_m]


@dataclass(frozen=True)
class SunTable:
    """``ln(tau + tau_0)`` of a node batch, shape (n_height, n_mu, width) flattened.

    Without ``shells``, layers of thin cloud.

    Values in Float32 are interpolated in Float32, which costs half as much and 1e-6 of the optical depth.
    """

    values: mi.Float64 | mi.Float32
    n_height: int
    n_mu: int
    radius_m: float
    top_m: float
    shells: tuple[SunShell, ...] = ()

    @staticmethod
    def nodes(n_height: int, n_mu: int, radius_m: float, top_m: float) -> tuple[FloatArray, FloatArray]:
        """Return heights (n_height,) [m] and solar zenith cosines (n_height, n_mu) of the table's nodes."""
        h = top_m * np.linspace(0.0, 1.0, n_height) ** 2
        mu_h = -np.sqrt(h * (2 * radius_m + h)) / (radius_m + h)
        mu = mu_h[:, None] + (1.0 - mu_h[:, None]) * np.linspace(0.0, 1.0, n_mu)[None, :] ** 2
        return h, mu

    def transmittance(
        self,
        height_m: mi.Float64,
        mu: mi.Float64,
        width: int,
        factor: Callable[[mi.Float64], Values] | None = None,
    ) -> Values:
        """Return ``exp(-tau)`` towards the Sun. Directions below the geometric horizon count as on it.

        ``factor``: of tau at the places, by the Sun's cosine; layers left out.
        """
        h = dr.clip(height_m, 0.0, self.top_m)
        mu_h = -dr.sqrt(h * (2.0 * self.radius_m + h)) / (self.radius_m + h)
        x = dr.sqrt(h * (1.0 / self.top_m)) * (self.n_height - 1)
        y = dr.sqrt(dr.clip((mu - mu_h) / (1.0 - mu_h), 0.0, 1.0)) * (self.n_mu - 1)
        i = dr.minimum(mi.UInt32(x), self.n_height - 2)
        j = dr.minimum(mi.UInt32(y), self.n_mu - 2)
        values: Any = self.values
        real = type(values)
        wx, wy = real(x - mi.Float64(i)), real(y - mi.Float64(j))
        row = i * self.n_mu + j
        near = interpolate(values, row, wy, width)
        far = interpolate(values, row + self.n_mu, wy, width)
        less: list[Any] = [TAU_FLOOR - dr.exp(dr.fma(b - a, wx, a)) for a, b in zip(near, far, strict=True)]
        if factor is not None:
            less = [mi.Float64(v) * f for v, f in zip(less, factor(dr.maximum(mu, mu_h)), strict=True)]
        found = [mi.Float64(dr.exp(v)) for v in less]
        return through_shells(found, self.shells, h, dr.maximum(mu, mu_h), self.radius_m)


def through_shells(
    transmittance: Values, shells: tuple[SunShell, ...], height_m: mi.Float64, mu: mi.Float64, radius_m: float
) -> Values:
    """Return transmittances towards the Sun with those of layers; arguments as of :meth:`SunShell.depth`."""
    for shell in shells:
        depth = shell.depth(height_m, mu, radius_m)
        transmittance = [t * dr.exp(-v) for t, v in zip(transmittance, depth, strict=True)]
    return transmittance


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
    """``rows`` nodes along an axis of rays, ``columns`` in azimuth from 0 to pi or ``all_round``.

    Both at least four.
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
        """Return all quantities at ``row`` [steps] and azimuths [rad]; negative ones are set to 0.

        Radiance is never negative, but the cubic through it dips below 0 where the air ends.
        """
        total = [mi.Float64(0.0)] * self.width
        for node, weight in self._nodes(row, azimuth):
            for q, value in enumerate(gather_row(self._values, node, self.width)):
                total[q] = dr.fma(weight, value, total[q])
        return [dr.maximum(value, 0.0) for value in total[: self.quantities]]


class StationTable(NodeTable):
    """Two quantities at stations along rays.

    In memory a node holds both quantities of a station and of the next, station by station, so that two
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
