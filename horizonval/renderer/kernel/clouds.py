"""Cloud tops inside the renderer: a table of the relief as seen from above, and where rays meet it.

The table is an equal-area map (Lambert) of everything in sight around the point below the camera, made by the same
arithmetic as :mod:`horizonval.earth.clouds.relief`; between its nodes the relief is bilinear. At 500 km a node
stands for 1.9 km, at 36 000 km for 6 km.

A ray is searched from where it enters the layer of the tops to where it leaves it or meets the ground, in steps of
half a table node; the crossing between the last step outside and the first inside is bisected to 1e-3 of a step. Peaks
narrower than a step may be missed where a ray grazes them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds import earth_pattern, relief
from horizonval.earth.clouds.earth_pattern import Arithmetic, Local
from horizonval.earth.clouds.relief import BASE_M, CloudField
from horizonval.geometry.directions import perpendicular
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Vec, constant, constant_vector

TABLE_SIDE = 3072
BISECTIONS = 10
BENDING_NODES_ABOVE = 32
"""Of the bending above the clouds: a tenth of it all, good to 1e-5 of that."""
NARROWEST_STEP_M = 250.0
_KEPT_TABLES = 2
_Key: TypeAlias = tuple[CloudField, Planet, tuple[float, float, float], str | None]
_tables: OrderedDict[_Key, CloudTable] = OrderedDict()


@dataclass(frozen=True)
class CloudTable:
    """Tops [m] over the globe around ``up``; ``axes`` are the map's x and y directions, ``per_unit`` nodes per unit.

    ``albedos``: of the clouds at the same nodes, 0 between them; None where the height tells them.
    """

    field: CloudField
    values: mi.Float32
    albedos: mi.Float32 | None
    axes: tuple[Vec, Vec]
    up: Vec
    per_unit: mi.Float64
    step_m: mi.Float64
    layer_m: mi.Float64

    def top(self, normal: Vec) -> mi.Float64:
        """Return the relief [m] at unit normals: below BASE_M where there is no cloud."""
        return self._look(self.values, normal)

    @property
    def translucent(self) -> bool:
        """Whether clouds hand on what they do not reflect."""
        return self.albedos is not None

    def brightness(self, height: mi.Float64, normal: Vec) -> mi.Float64:
        """Return the albedo of clouds at heights of their tops below verticals, over that of the brightest."""
        if self.albedos is None:
            return brightness(self.field, height, normal)
        return self._look(self.albedos, normal) / constant(max(self.field.albedo, 1e-6))

    def _look(self, values: mi.Float32, normal: Vec) -> mi.Float64:
        """Return the bilinear value of a map."""
        stretch = dr.sqrt(2.0 / dr.maximum(1.0 + dot(normal, self.up), 1e-6)) * self.per_unit
        east, north = dot(normal, self.axes[0]), dot(normal, self.axes[1])
        x, y = (dr.fma(c, stretch, 0.5 * (TABLE_SIDE - 1)) for c in (east, north))
        x, y = (dr.clip(c, 0.0, TABLE_SIDE - 1.001) for c in (x, y))
        i, j = mi.UInt32(x), mi.UInt32(y)
        wx, wy = x - mi.Float64(i), y - mi.Float64(j)
        row = j * TABLE_SIDE + i
        v00, v10, v01, v11 = (
            mi.Float64(dr.gather(mi.Float32, values, row + k)) for k in (0, 1, TABLE_SIDE, TABLE_SIDE + 1)
        )
        low, high = dr.fma(v10 - v00, wx, v00), dr.fma(v11 - v01, wx, v01)
        return dr.fma(high - low, wy, low)


def cloud_table(field: CloudField, planet: Planet, origin: tuple[float, float, float]) -> CloudTable:
    """Return the relief around the point below a camera; those of the last few cameras stay."""
    key = (field, planet, origin, mi.variant())
    if key not in _tables:
        _tables[key] = _make_table(field, planet, origin)
        if len(_tables) > _KEPT_TABLES:
            _tables.popitem(last=False)
    _tables.move_to_end(key)
    return _tables[key]


def _make_table(field: CloudField, planet: Planet, origin: tuple[float, float, float]) -> CloudTable:
    r = math.sqrt(sum(v * v for v in origin))
    up = np.array(origin) / r
    x_axis = perpendicular(up)
    y_axis = np.cross(up, x_axis)
    radius = min(planet.a_m, planet.b_m)
    # a ray that just clears the ground may meet a top beyond the horizon; 1 deg for the ellipsoid's normals
    reach = math.acos(min(radius / r, 1.0)) + math.acos(radius / (radius + field.top_m)) + math.radians(1.0)
    half = 2.0 * math.sin(0.5 * min(reach, math.pi))
    per_unit = 0.5 * (TABLE_SIDE - 1) / half
    east, north, vertical = (constant_vector(w) for w in (x_axis, y_axis, up))
    node = dr.arange(mi.UInt32, TABLE_SIDE * TABLE_SIDE)
    x = (mi.Float64(node % TABLE_SIDE) - 0.5 * (TABLE_SIDE - 1)) / constant(per_unit)
    y = (mi.Float64(node // TABLE_SIDE) - 0.5 * (TABLE_SIDE - 1)) / constant(per_unit)
    rho2 = dr.minimum(x * x + y * y, 4.0)
    shrink, rise = dr.sqrt(1.0 - 0.25 * rho2), 1.0 - 0.5 * rho2
    u, v, w = (x * shrink * e1 + y * shrink * e2 + rise * e3 for e1, e2, e3 in zip(east, north, vertical, strict=True))
    albedos = None
    if field.pattern == "earth":
        depth, at = earth_clouds(field, (u, v, w))
        arithmetic = kernel_arithmetic()
        values = mi.Float32(earth_pattern.top_m(depth, at, _tropopause(w), constant(field.top_m), arithmetic))
        albedo = earth_pattern.albedo(depth, at, arithmetic)
        albedos = mi.Float32(dr.minimum(albedo, constant(field.albedo)))
    else:
        values = mi.Float32(top_at(field, (u, v, w)))
    dr.eval(values, albedos)
    step_m = max(0.5 * radius / per_unit, NARROWEST_STEP_M)
    axes = east, north
    return CloudTable(
        field, values, albedos, axes, vertical, constant(per_unit), constant(step_m), constant(field.top_m)
    )


def kernel_arithmetic() -> Arithmetic:
    """Return Dr.Jit's spelling."""
    return Arithmetic(dr, dr.select, _split, mi.Float64, constant)


def _split(v: mi.Float64) -> tuple[mi.UInt32, mi.Float64]:
    whole = mi.UInt32(v)
    return whole, v - mi.Float64(whole)


def earth_clouds(field: CloudField, normal: Vec) -> tuple[mi.Float64, Local]:
    """Return :func:`horizonval.earth.clouds.earth_pattern.depth_at` at unit normals."""
    coarse, arithmetic = field.coarse(), kernel_arithmetic()
    latitude = dr.rad2deg(dr.asin(dr.clip(normal[2], -1.0, 1.0)))
    y, x = earth_pattern.map_place(latitude, dr.rad2deg(dr.atan2(normal[1], normal[0])))
    i = dr.minimum(mi.UInt32(y), earth_pattern.MAP_ROWS - 2)
    j = dr.minimum(mi.UInt32(x), earth_pattern.MAP_COLUMNS - 2)
    wy, wx = y - mi.Float64(i), x - mi.Float64(j)
    table, row = table_of(mi.Float32, coarse.values), i * earth_pattern.MAP_COLUMNS + j

    def corner(k: int) -> list[mi.Float64]:
        return [mi.Float64(c) for c in gather_row(table, row + k, earth_pattern.CHANNELS)]

    above = earth_pattern.MAP_COLUMNS
    corners = (corner(k) for k in (0, 1, above, above + 1))
    channels = [dr.lerp(dr.lerp(a, b, wx), dr.lerp(c, d, wx), wy) for a, b, c, d in zip(*corners, strict=True)]
    at = earth_pattern.local(channels, arithmetic)
    noise = earth_pattern.noise(normal, at, dr.opaque(mi.UInt32, field.seed, 1), arithmetic)
    rank = rank_of(noise, coarse.lowest, coarse.highest, coarse.rank)
    return earth_pattern.depth(rank, at, arithmetic), at


def rank_of(noise: mi.Float64, lowest: float, highest: float, rank: FloatArray) -> mi.Float64:
    """Return the rank of noise by its table."""
    steps = len(rank) - 1
    table = table_of(mi.Float64, rank)
    step = (noise - constant(lowest)) / constant((highest - lowest) / steps)
    step = dr.clip(step, 0.0, float(steps))
    i = dr.minimum(mi.UInt32(step), steps - 1)
    low, high = dr.gather(mi.Float64, table, i), dr.gather(mi.Float64, table, i + 1)
    return dr.fma(high - low, step - mi.Float64(i), low)


def top_at(field: CloudField, normal: Vec) -> mi.Float64:
    """Return :func:`horizonval.earth.clouds.relief.top_m` at unit normals."""

    if field.pattern == "earth":
        depth, at = earth_clouds(field, normal)
        ceiling = _tropopause(normal[2])
        return earth_pattern.top_m(depth, at, ceiling, constant(field.top_m), kernel_arithmetic())
    cover = constant(field.share)
    u = rank_of(relief.noise(normal, field, _split, mi.Float64), *relief.rank_table(field))
    s = (u - (1.0 - cover)) / cover
    risen = dr.exp(dr.log(dr.maximum(s, 1e-12)) * constant(field.exponent))
    return BASE_M + (_ceiling(field, normal) - BASE_M) * dr.select(s > 0.0, risen, s)


def brightness(field: CloudField, height: mi.Float64, normal: Vec) -> mi.Float64:
    """Return the albedo of tops of the uniform pattern at heights below verticals, over that of the highest."""
    risen = dr.clip((height - BASE_M) / (_ceiling(field, normal) - BASE_M), 0.0, 1.0)
    return relief.BASE_BRIGHTNESS + (1.0 - relief.BASE_BRIGHTNESS) * risen


def _ceiling(field: CloudField, normal: Vec) -> mi.Float64:
    return dr.minimum(constant(field.top_m), _tropopause(normal[2]))


def _tropopause(z: mi.Float64) -> mi.Float64:
    latitude = dr.abs(dr.rad2deg(dr.asin(dr.clip(z, -1.0, 1.0))))
    middle = 0.5 * (relief.TROPICAL_TROPOPAUSE_M + relief.POLAR_TROPOPAUSE_M)
    half = 0.5 * (relief.TROPICAL_TROPOPAUSE_M - relief.POLAR_TROPOPAUSE_M)
    return middle - half * dr.tanh((latitude - 40.0) / 10.0)


def first_cloud(
    table: CloudTable, planet: Planet, o: Vec, d: Vec, to_ground: bool, bending: BendingField | None = None
) -> tuple[mi.Bool, mi.Float64]:
    """Return ``(hit, t)``: whether rays meet a cloud, and at what parameter.

    ``to_ground``: the rays meet the ground, and nothing beyond it counts. ``bending``: the rays are the straight ones
    of refracted light; the clouds are met where the bent ones are.
    """
    mid, half, meets = planet.chord(o, d, table.layer_m)
    start, end = dr.maximum(mid - half, 0.0), mid + half
    if to_ground:
        ground_mid, ground_half, _ = planet.chord(o, d)
        end = dr.minimum(end, ground_mid - ground_half)
    meets &= end > start
    count = dr.ceil((end - start) / table.step_m)

    up = None if bending is None else bending.up(o, d)

    def inside(t: mi.Float64, angle: mi.Float64) -> mi.Bool:
        if bending is None:
            height, normal = planet.height_and_normal(along(o, d, t))
        else:
            height, normal = bending.place(o, d, t, angle)
        top = table.top(normal)
        return (top > BASE_M) & (height <= top)

    def turned(t: mi.Float64, angle: mi.Float64, further_m: mi.Float64) -> mi.Float64:
        """Return the angle a little further on."""
        if bending is None or up is None:
            return angle
        return dr.fma(bending.rate(o, d, up, t), further_m, angle)

    def advance(
        i: mi.Float64, angle: mi.Float64, hit: mi.Bool, going: mi.Bool
    ) -> tuple[mi.Float64, mi.Float64, mi.Bool, mi.Bool]:
        t = dr.minimum(dr.fma(i, table.step_m, start), end)
        hit = inside(t, angle)
        following = dr.select(hit, i, i + 1.0)
        return following, dr.select(hit, angle, turned(t, angle, table.step_m)), hit, ~hit & (following <= count)

    at_start = 0.0 * start if bending is None else bending.angle(o, d, BENDING_NODES_ABOVE, start)
    index, angle, hit, _ = dr.while_loop(
        (0.0 * start, at_start, meets & ~meets, dr.copy(meets)),
        lambda i, angle, hit, going: going,
        advance,
        labels=("i", "angle", "hit", "going"),
        label="cloud search",
    )

    def halve(k: mi.UInt32, low: mi.Float64, high: mi.Float64) -> tuple[mi.UInt32, mi.Float64, mi.Float64]:
        middle = 0.5 * (low + high)
        covered = inside(middle, angle)
        return k + 1, dr.select(covered, low, middle), dr.select(covered, middle, high)

    high = dr.minimum(dr.fma(index, table.step_m, start), end)
    _, _, high = dr.while_loop(
        (mi.UInt32(0), dr.maximum(dr.fma(index - 1.0, table.step_m, start), start), high),
        lambda k, low, high: hit & (k < BISECTIONS),
        halve,
        labels=("k", "low", "high"),
        label="cloud edge",
    )
    return hit, high
