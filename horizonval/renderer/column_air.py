r"""Air that differs from place to place, for sunlight.

The difference between each place and the column below the camera.

Extinction and scattering at a place are those of a batch's column plus a difference, linear in height between even
levels and bilinear between the columns around the place (by latitude alone: linear in its sine). So light meets the air
of every place that it passes on its way to the camera.

On its way from the Sun it meets one column's air, that of the place where it is scattered. The optical depth towards
the Sun, tabulated for the batch's column, is multiplied by a ratio of the columns' depths straight up (V) and
level (T) from the place, and for a Sun below the horizontal by that of T from its ray's lowest height::

    tau(h, mu; column) = tau(h, mu; own) (q T_column / T_own + (1 - q) V_column / V_own)(h')

    mu >= 0:  h' = h,                              q = c / (c + mu^2)
    mu < 0:   h' = (R + h) sqrt(1 - mu^2) - R,     q = 1

c is :data:`LEVEL_COSINE2`. Between the tropics and a subarctic winter the error of tau is within 1 % for mu above 0.1,
within 2 % at most heights for a lower Sun, and within 5 % at 20 km, near the lower edge of an ozone layer.
Light scattered more than once has the source per scattering coefficient of the batch's column.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import ColumnPlaces, SpectralNode
from horizonval.earth.weather.field import ColumnMap
from horizonval.renderer.planet import dot
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Values, Vec, constant, constant_vector

DepthFactor: TypeAlias = "Callable[[mi.Float64], Values]"
"""By what the optical depth towards the Sun is larger than in a batch's own column, per node, by the Sun's cosine."""
LEVEL_COSINE2 = 0.0015
"""Twice the height, in radii, of the air that dims a low Sun: 5 km above the place."""
_EXTINCTION, _MOLECULAR, _UP, _LEVEL = range(4)
_PARTS = 4
_LEAST_DEPTH = 1e-12
"""Air above a height that dims less has the ratio of the next lower level."""


class ColumnsAround(Protocol):
    """Where columns stand."""

    def corners(self, normal: Vec) -> list[tuple[mi.UInt32, mi.Float64]]:
        """Return the columns around places of unit normals, and their weights."""


@dataclass(frozen=True)
class LatitudeRows:
    """Rows even in the sine of latitude, and beyond the outermost as on them; numbers as data."""

    low: mi.Float64
    per_row: mi.Float64
    count: mi.UInt32

    @classmethod
    def of(cls, sin_latitude: FloatArray) -> LatitudeRows:
        """Build from the sines, at least two."""
        per_row = (len(sin_latitude) - 1) / float(sin_latitude[-1] - sin_latitude[0])
        return cls(constant(sin_latitude[0]), constant(per_row), dr.opaque(mi.UInt32, len(sin_latitude), 1))

    def corners(self, normal: Vec) -> list[tuple[mi.UInt32, mi.Float64]]:
        """Return the rows south and north of places, and their weights."""
        x = dr.clip((normal[2] - self.low) * self.per_row, 0.0, mi.Float64(self.count - 1))
        row = dr.minimum(mi.UInt32(x), self.count - 2)
        north = x - mi.Float64(row)
        return [(row, 1.0 - north), (row + 1, north)]


@dataclass(frozen=True)
class Lattice:
    """A :class:`horizonval.earth.weather.field.ColumnMap` for the kernel; numbers as data."""

    axes: tuple[Vec, Vec, Vec]
    half: mi.Float64
    per_step: mi.Float64
    count: mi.UInt32

    @classmethod
    def of(cls, m: ColumnMap) -> Lattice:
        """Build from a map."""
        e, f, c = (constant_vector(axis) for axis in m.axes)
        per_step = (m.count - 1) / (2.0 * m.half)
        return cls((e, f, c), constant(m.half), constant(per_step), dr.opaque(mi.UInt32, m.count, 1))

    def corners(self, normal: Vec) -> list[tuple[mi.UInt32, mi.Float64]]:
        """Return the four columns around places of unit normals, and their weights."""
        across, along, up = (dot(normal, axis) for axis in self.axes)
        scale = 1.0 / (1.0 + up)
        (i, u), (j, v) = (self._along(value * scale) for value in (across, along))
        start = j * self.count + i
        above = start + self.count
        return [
            (start, (1.0 - u) * (1.0 - v)),
            (start + 1, u * (1.0 - v)),
            (above, (1.0 - u) * v),
            (above + 1, u * v),
        ]

    def _along(self, value: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
        step = dr.clip((value + self.half) * self.per_step, 0.0, mi.Float64(self.count - 1))
        i = dr.minimum(mi.UInt32(step), self.count - 2)
        return i, step - mi.Float64(i)


@dataclass(frozen=True)
class ColumnAir:
    """How the air of a batch differs from the batch's column; ``places``: positions of the m columns.

    ``values``, (m * levels * 4 * width,): for every column, level and node the differences of extinction and of
    molecular scattering [1/m], and the ratios of the optical depths straight up and level. ``per_m``: levels per metre.
    """

    values: mi.Float32
    places: ColumnsAround
    levels: int
    width: int
    per_m: mi.Float64
    radius_m: float

    @classmethod
    def of(
        cls,
        places: ColumnPlaces,
        nodes: Sequence[SpectralNode],
        altitude_m: FloatArray,
        width: int,
        radius_m: float,
    ) -> ColumnAir:
        """Build for nodes on altitudes (n,), which may be apparent ones; layers of thin cloud dim the Sun elsewhere."""
        shape = nodes[0].more_extinction_per_m.shape
        packed = np.zeros((*shape, _PARTS, width), dtype=np.float32)
        up, level = _ways_out(places.altitude_m, radius_m)
        for k, node in enumerate(nodes):
            gas = node.extinction_per_m - (node.layer_per_m.sum(axis=0) if len(node.layer_per_m) else 0.0)
            packed[:, :, _EXTINCTION, k] = node.more_extinction_per_m
            packed[:, :, _MOLECULAR, k] = node.more_molecular_per_m
            own = np.interp(places.altitude_m, altitude_m, np.maximum(gas, 0.0))
            for part, weights in ((_UP, up), (_LEVEL, level)):
                packed[:, :, part, k] = _depth_ratio(own, node.more_extinction_per_m, weights)
        where: ColumnsAround
        where = LatitudeRows.of(places.sin_latitude) if places.column_map is None else Lattice.of(places.column_map)
        per_m = (shape[1] - 1) / float(places.altitude_m[-1])
        return cls(table_of(mi.Float32, packed), where, shape[1], width, constant(per_m), radius_m)

    def more_extinction(self, height_m: mi.Float64, normal: Vec) -> Values:
        """Return the extinction [1/m] that places have more, per node."""
        return self._look(_EXTINCTION, height_m, normal)

    def more_molecular(self, height_m: mi.Float64, normal: Vec) -> Values:
        """Return the scattering coefficient of molecules [1/m] that places have more, per node."""
        return self._look(_MOLECULAR, height_m, normal)

    def depth_factor(self, height_m: mi.Float64, normal: Vec) -> DepthFactor:
        """Return by what optical depths from places towards the Sun are larger, see the module text."""

        def at(cosine: mi.Float64) -> Values:
            square, down = cosine * cosine, cosine < 0.0
            lowest = (self.radius_m + height_m) * dr.sqrt(dr.maximum(1.0 - square, 1e-12)) - self.radius_m
            from_m = dr.select(down, lowest, height_m)
            share = dr.select(down, 1.0, LEVEL_COSINE2 / (LEVEL_COSINE2 + square))
            up, level = self._look(_UP, from_m, normal), self._look(_LEVEL, from_m, normal)
            return [dr.fma(b - a, share, a) for a, b in zip(up, level, strict=True)]

        return at

    def _look(self, part: int, height_m: mi.Float64, normal: Vec) -> Values:
        x = dr.clip(height_m * self.per_m, 0.0, self.levels - 1.0)
        i = dr.minimum(mi.UInt32(x), self.levels - 2)
        w = x - mi.Float64(i)
        total: list[Any] = [mi.Float32(0.0)] * self.width
        for column, share in self.places.corners(normal):
            start = column * self.levels + i
            for level, weight in ((start, share * (1.0 - w)), (start + 1, share * w)):
                values = gather_row(self.values, _PARTS * level + part, self.width)
                single = mi.Float32(weight)
                total = [dr.fma(a, single, b) for a, b in zip(values, total, strict=True)]
        return [mi.Float64(v) for v in total]


def _depth_ratio(own: FloatArray, more: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the ratio of columns' optical depths above levels to the own one's, shape (m, k); weights (k, k)."""
    depth = weights @ own
    ratio = 1.0 + more @ weights.T / np.maximum(depth, _LEAST_DEPTH)
    last = max(int(np.sum(depth > _LEAST_DEPTH)) - 1, 0)
    ratio[:, last + 1 :] = ratio[:, last : last + 1]
    return np.maximum(ratio, 0.0)


def _ways_out(level_m: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Return the weights (k, k) of extinction at levels (k,) in the optical depths straight up and level from each."""
    r = radius_m + level_m
    straight = np.maximum(level_m - level_m[:, None], 0.0)
    length = np.sqrt(np.maximum(r**2 - r[:, None] ** 2, 0.0))
    weights = []
    for way, square in ((straight, False), (length, True)):
        a, b = way[:, :-1], way[:, 1:]
        upper = (b + 2.0 * a) / (3.0 * np.maximum(a + b, 1e-9)) if square else np.full_like(a, 0.5)
        weight = np.zeros((len(r), len(r)))
        weight[:, :-1] += (b - a) * (1.0 - upper)
        weight[:, 1:] += (b - a) * upper
        weights.append(weight)
    return weights[0], weights[1]
