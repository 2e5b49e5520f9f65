"""Where a layer of thin cloud is cloudy, as a map around the point below the camera that the march looks up.

An equal-area map (Lambert's) of everything in sight, made once per camera position by the same arithmetic as
:mod:`horizonval.earth.clouds.layers`, bilinear between its nodes. It has :data:`NODES_PER_SCALE` nodes per scale of
the gaps, and :data:`MOST_NODES` along a side at most: from 500 km that is enough for scales of 50 km and more; of
smaller ones, and from far, the finest edges are blurred to a node, 2 km from 500 km and 4 km from 36 000.

The map is looked up at the normal of the ellipsoid below a point. With refraction it is that of the straight ray among
the apparent heights: gaps stand up to 15 km along the ray from where they are, the same in all bands.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.clouds import layers
from horizonval.earth.clouds.layers import LayerGaps
from horizonval.geometry.rotation import perpendicular
from horizonval.renderer.kernel.clouds import kernel_arithmetic, rank_of
from horizonval.renderer.planet import Planet, dot
from horizonval.renderer.types import Vec, constant, constant_vector

NODES_PER_SCALE, MOST_NODES = 32, 3072
_KEPT_MAPS = 4
_Key: TypeAlias = tuple[LayerGaps, Planet, tuple[float, float, float], float, str | None]
_maps: OrderedDict[_Key, GapMap] = OrderedDict()


@dataclass(frozen=True)
class GapMap:
    """The cloud's share of the mean column, f / c, less one, around ``up``; ``side`` nodes along both axes.

    ``axes``: the map's x and y directions; ``per_unit``: nodes per unit.
    """

    values: mi.Float32
    axes: tuple[Vec, Vec]
    up: Vec
    per_unit: mi.Float64
    side: mi.UInt32

    def excess(self, normal: Vec) -> mi.Float64:
        """Return by how much of the mean column a layer exceeds it below unit normals: -1 in a gap."""
        stretch = dr.sqrt(2.0 / dr.maximum(1.0 + dot(normal, self.up), 1e-6)) * self.per_unit
        last = mi.Float64(self.side) - 1.0
        x, y = (dr.clip(dr.fma(dot(normal, axis), stretch, 0.5 * last), 0.0, last) for axis in self.axes)
        i, j = (dr.minimum(mi.UInt32(v), self.side - 2) for v in (x, y))
        wx, wy = mi.Float32(x - mi.Float64(i)), mi.Float32(y - mi.Float64(j))
        row = j * self.side + i
        corners = (row, row + 1, row + self.side, row + self.side + 1)
        v00, v10, v01, v11 = (dr.gather(mi.Float32, self.values, k) for k in corners)
        low, high = dr.fma(v10 - v00, wx, v00), dr.fma(v11 - v01, wx, v01)
        return mi.Float64(dr.fma(high - low, wy, low))


def gap_map(gaps: LayerGaps, planet: Planet, origin: tuple[float, float, float], top_m: float) -> GapMap:
    """Return the map of a layer below ``top_m`` around the point below a camera; those of the last few stay."""
    key = (gaps, planet, origin, top_m, mi.variant())
    if key not in _maps:
        _maps[key] = _make_map(gaps, planet, origin, top_m)
        if len(_maps) > _KEPT_MAPS:
            _maps.popitem(last=False)
    _maps.move_to_end(key)
    return _maps[key]


def _make_map(gaps: LayerGaps, planet: Planet, origin: tuple[float, float, float], top_m: float) -> GapMap:
    r = math.sqrt(sum(v * v for v in origin))
    up = np.array(origin) / r
    x_axis = perpendicular(up)
    axes = constant_vector(x_axis), constant_vector(np.cross(up, x_axis))
    vertical = constant_vector(up)
    radius = min(planet.a_m, planet.b_m)
    # to where a ray that just clears the ground leaves the layer; 1 deg for the ellipsoid's normals
    reach = math.acos(min(radius / r, 1.0)) + math.acos(radius / (radius + top_m)) + math.radians(1.0)
    half = 2.0 * math.sin(0.5 * min(reach, math.pi))
    side = min(MOST_NODES, math.ceil(2.0 * half * radius / gaps.scale_m * NODES_PER_SCALE))
    per_unit = constant(0.5 * (side - 1) / half)
    row_length = dr.opaque(mi.UInt32, side, 1)
    node = dr.arange(mi.UInt32, side * side)
    x = (mi.Float64(node % row_length) - constant(0.5 * (side - 1))) / per_unit
    y = (mi.Float64(node // row_length) - constant(0.5 * (side - 1))) / per_unit
    rho2 = dr.minimum(x * x + y * y, 4.0)
    shrink, rise = dr.sqrt(1.0 - 0.25 * rho2), 1.0 - 0.5 * rho2
    u, v, w = (x * shrink * e + y * shrink * n + rise * z for e, n, z in zip(*axes, vertical, strict=True))
    arithmetic = kernel_arithmetic()
    seed = dr.opaque(mi.UInt32, gaps.seed, 1)
    noise = layers.gap_noise(gaps, (u, v, w), seed, arithmetic.split, arithmetic.real)
    rank = rank_of(mi.Float64(noise), *layers.rank_table(gaps))
    cloudy = dr.clip((rank - constant(1.0 - gaps.cover)) / constant(gaps.softness) + 0.5, 0.0, 1.0)
    values = mi.Float32(cloudy / constant(gaps.cover) - 1.0)
    dr.eval(values)
    return GapMap(values, axes, vertical, per_unit, row_length)
