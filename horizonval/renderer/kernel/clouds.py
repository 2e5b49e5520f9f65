"""Cloud tops inside the renderer: a table of the relief as seen from above, and where rays meet it.

The table is an equal-area map (Lambert) of everything in sight around the point below the camera, made by the same
arithmetic as :mod:`horizonval.earth.clouds.relief` and bilinear between its nodes. At 500 km a node stands for 1.9 km,
at 36 000 km for 6 km. Structure of the Earth's pattern larger than 75 nodes is computed at every fourth node: that
moves tops by some 20 m, a tenth of the error between nodes.

A ray is searched from where it enters the layer of the tops to where it leaves it or meets the ground, in steps over
half a table node; the crossing is bisected to 1e-3 of a step. Peaks narrower than a step may be missed where a ray
grazes them. Points are in single precision from where a ray enters the layer: heights are good to a metre. Two more
maps hold the highest top in squares of :data:`SQUARES` nodes a side and around them: steps that stay above are skipped.

**Gaps of thin cloud** are such a map, too (:mod:`horizonval.earth.clouds.layers`): :data:`NODES_PER_SCALE` nodes per
scale of the gaps, at most :data:`MOST_NODES` along a side, which resolves scales of 50 km and more from 500 km. Finer
edges are blurred to a node. With refraction the map is read below the straight ray among the apparent heights: gaps are
displaced by up to 15 km along the ray, the same in all bands.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, reduce

import drjit as dr
import mitsuba as mi
import numpy as np
import scipy.ndimage
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.clouds import earth_pattern, layers, relief
from horizonval.earth.clouds.earth_pattern import Arithmetic, Coarse, Local
from horizonval.earth.clouds.layers import LayerGaps
from horizonval.earth.clouds.relief import BASE_M, CloudField
from horizonval.geometry.rotation import perpendicular
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.refraction import END_BENDING_NODES, BendingField, turn_between, vertical_of
from horizonval.renderer.tables import gather_row, table_of
from horizonval.renderer.types import Real, Vec, Vec3, constant, constant_vector, in_single, inverse_root

TABLE_SIDE = 3072
SPARSER, LARGE_NODES = 4, 75
"""Octaves of noise with cells of as many nodes are found at every fourth node."""
MOST_LARGE_OCTAVES = 5
"""From there on decks have cells, which have kinks."""
BISECTIONS = 10
NARROWEST_STEP_M = 250.0
SQUARES = (16, 8)
MOST_SKIPPED = 20
STRETCH = math.sqrt(2.0)
"""Of the map across its radii at 90 deg from its middle: it moves a step by as many more nodes."""
SKIP_MARGIN_M = 50.0
"""A ray falls no faster than at a step's beginning, but for its bending."""
LEAST_COSINE = 0.4
"""Of the elevation of rays whose steps pass over half a node; steps of steeper ones are no longer."""
NO_TOP_M = -1e9


@dataclass(frozen=True)
class GlobeMap:
    """An equal-area map (Lambert) of what is in sight around ``up``, ``side`` nodes along both axes.

    ``axes``: the map's x and y directions; ``per_unit``: nodes per unit of these.
    """

    axes: tuple[Vec, Vec]
    up: Vec
    per_unit: mi.Float64
    side: mi.UInt32

    @classmethod
    def of(
        cls, planet: Planet, origin: tuple[float, float, float], top_m: float, side: Callable[[float], int]
    ) -> tuple[GlobeMap, float]:
        """Return the map around the point below a camera, and its nodes per metre; ``side``: by its size [m]."""
        r, radius = math.sqrt(sum(v * v for v in origin)), min(planet.a_m, planet.b_m)
        up = np.array(origin) / r
        x_axis = perpendicular(up)
        # to where a ray that just clears the ground leaves what is below a height; 1 deg for the ellipsoid's normals
        reach = math.acos(min(radius / r, 1.0)) + math.acos(radius / (radius + top_m)) + math.radians(1.0)
        half = 2.0 * math.sin(0.5 * min(reach, math.pi))
        count = side(2.0 * half * radius)
        per_unit = 0.5 * (count - 1) / half
        axes = constant_vector(x_axis), constant_vector(np.cross(up, x_axis))
        found = cls(axes, constant_vector(up), constant(per_unit), dr.opaque(mi.UInt32, count, 1))
        return found, per_unit / radius

    def place(self, normal: Vec3[Real]) -> tuple[Real, Real]:
        """Return column and row of unit normals, from 0 to the last."""
        real = type(normal[0])

        def toward(axis: Vec) -> Real:
            return dot(normal, (real(axis[0]), real(axis[1]), real(axis[2])))

        stretch = dr.sqrt(2.0 / dr.maximum(1.0 + toward(self.up), 1e-6)) * real(self.per_unit)
        last = real(self.side) - 1.0
        x, y = (dr.clip(dr.fma(toward(axis), stretch, 0.5 * last), 0.0, last) for axis in self.axes)
        return x, y

    def look(self, values: mi.Float32, normal: Vec3[Real]) -> Real:
        """Return the bilinear value of a map's nodes."""
        x, y = self.place(normal)
        real = type(x)
        i, j = (dr.minimum(mi.UInt32(v), self.side - 2) for v in (x, y))
        wx, wy = x - real(i), y - real(j)
        row = j * self.side + i
        corners = (row, row + 1, row + self.side, row + self.side + 1)
        v00, v10, v01, v11 = (real(dr.gather(mi.Float32, values, k)) for k in corners)
        low, high = dr.fma(v10 - v00, wx, v00), dr.fma(v11 - v01, wx, v01)
        return dr.fma(high - low, wy, low)

    def normals(self, side: int, every: int = 1) -> Vec:
        """Return the unit normals at ``side`` nodes along both axes from the first on, at one of ``every`` few."""
        node, length = dr.arange(mi.UInt32, side * side), dr.opaque(mi.UInt32, side, 1)
        middle = 0.5 * (mi.Float64(self.side) - 1.0)
        x, y = ((mi.Float64(k) * float(every) - middle) / self.per_unit for k in (node % length, node // length))
        rho2 = dr.minimum(x * x + y * y, 4.0)
        shrink, rise = dr.sqrt(1.0 - 0.25 * rho2), 1.0 - 0.5 * rho2
        u, v, w = (
            x * shrink * e1 + y * shrink * e2 + rise * e3 for e1, e2, e3 in zip(*self.axes, self.up, strict=True)
        )
        return u, v, w


@dataclass(frozen=True)
class Squares:
    """The highest tops in squares of ``side`` nodes and the eight around each; ``steps``: that they speak for."""

    side: int
    highest: mi.Float32
    steps: mi.Float64


@dataclass(frozen=True)
class CloudTable:
    """Tops [m] over the globe in sight.

    ``albedos``: of the clouds at the same nodes, 0 between them; None where they follow from the height. ``squares``:
    the largest first.
    """

    field: CloudField
    values: mi.Float32
    albedos: mi.Float32 | None
    squares: tuple[Squares, ...]
    globe: GlobeMap
    step_m: mi.Float64
    layer_m: mi.Float64

    def top(self, normal: Vec3[Real]) -> Real:
        """Return the relief [m] at unit normals: below BASE_M where there is no cloud."""
        return self.globe.look(self.values, normal)

    @property
    def translucent(self) -> bool:
        """Whether clouds hand on what they do not reflect."""
        return self.albedos is not None

    def brightness(self, height: mi.Float64, normal: Vec) -> mi.Float64:
        """Return the albedo of clouds at heights of their tops below verticals, over that of the brightest."""
        if self.albedos is None:
            return brightness(self.field, height, normal)
        return self.globe.look(self.albedos, normal) / constant(max(self.field.albedo, 1e-6))

    def highest_around(self, squares: Squares, normal: Vec3[Real]) -> Real:
        """Return what no top is above within a map's steps of unit normals: far below zero where there is none."""
        x, y = self.globe.place(normal)
        square = mi.UInt32(y) // squares.side * (TABLE_SIDE // squares.side) + mi.UInt32(x) // squares.side
        return type(x)(dr.gather(mi.Float32, squares.highest, square))


def cloud_table(field: CloudField, planet: Planet, origin: tuple[float, float, float]) -> CloudTable:
    """Return the relief around the point below a camera; those of the last few cameras stay."""
    return _cloud_table(field, planet, origin, mi.variant())


@lru_cache(maxsize=2)
def _cloud_table(
    field: CloudField, planet: Planet, origin: tuple[float, float, float], variant: str | None
) -> CloudTable:
    globe, per_m = GlobeMap.of(planet, origin, field.top_m, lambda _: TABLE_SIDE)
    albedos = None
    if field.pattern == "earth":
        depth, at = _relief_of_earth(field, globe, per_m)
        arithmetic = kernel_arithmetic()
        ceiling = _tropopause(mi.Float32(globe.normals(TABLE_SIDE)[2]))
        values = earth_pattern.top_m(depth, at, ceiling, mi.Float32(constant(field.top_m)), arithmetic)
        albedos = dr.minimum(earth_pattern.albedo(depth, at, arithmetic), mi.Float32(constant(field.albedo)))
    else:
        values = mi.Float32(top_at(field, globe.normals(TABLE_SIDE)))
    dr.eval(values, albedos)
    step_m = max(0.5 / per_m, NARROWEST_STEP_M)
    squares = _squares(values, STRETCH * step_m * per_m)
    return CloudTable(field, values, albedos, squares, globe, constant(step_m), constant(field.top_m))


def _squares(values: mi.Float32, nodes_per_step: float) -> tuple[Squares, ...]:
    """Return the highest tops in squares of nodes, :data:`NO_TOP_M` without clouds."""
    tops, before = np.asarray(values).reshape(TABLE_SIDE, TABLE_SIDE), 1
    maps: list[Squares] = []
    for side in reversed(SQUARES):
        tops, before = _highest_in_squares(tops, side // before), side
        around = scipy.ndimage.maximum_filter(tops, size=3, mode="nearest")
        highest = table_of(mi.Float32, np.where(around > BASE_M, around, NO_TOP_M))
        steps = 1 + min((side - 2) / nodes_per_step, MOST_SKIPPED - 1)
        maps.insert(0, Squares(side, highest, constant(math.floor(steps))))
    return tuple(maps)


def _highest_in_squares(tops: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Return the highest in squares of a map: row by row, which takes a tenth of the time of NumPy over both axes."""
    rows = tops.reshape(len(tops) // side, side, -1).max(axis=1)
    return reduce(np.maximum, (rows[:, k::side] for k in range(side)))


def _relief_of_earth(field: CloudField, globe: GlobeMap, per_m: float) -> tuple[mi.Float32, Local]:
    """Return :func:`earth_clouds` at the nodes of the table, what is large from every fourth of them."""
    coarse, arithmetic = field.coarse(), kernel_arithmetic()
    seed = dr.opaque(mi.UInt32, field.seed, 1)
    cells = per_m * earth_pattern.LARGEST_M / LARGE_NODES
    large_ones = min(1 + math.floor(math.log2(max(cells, 1.0))), MOST_LARGE_OCTAVES)
    side = TABLE_SIDE // SPARSER + 1
    normal = globe.normals(side, SPARSER)
    channels = _coarse_channels(coarse, normal)
    at = earth_pattern.local(channels, arithmetic)
    large = earth_pattern.octaves(normal, at, seed, arithmetic, range(large_ones))
    channels[3] = large / earth_pattern.sigma(at, arithmetic) + at.lift
    sparse = dr.empty(mi.Float32, side * side * earth_pattern.CHANNELS)
    node = dr.arange(mi.UInt32, side * side)
    found = [mi.Float32(channel) for channel in channels]
    # once: every scatter would find them again
    dr.eval(found)
    for k, channel in enumerate(found):
        dr.scatter(sparse, channel, node * earth_pattern.CHANNELS + k, mode=dr.ReduceMode.NoConflicts)
    dr.eval(sparse)

    node = dr.arange(mi.UInt32, TABLE_SIDE * TABLE_SIDE)
    column, row = node % TABLE_SIDE, node // TABLE_SIDE
    first = (row // SPARSER) * side + column // SPARSER
    wx, wy = (mi.Float32(c % SPARSER) * (1.0 / SPARSER) for c in (column, row))
    corners = (gather_row(sparse, first + k, earth_pattern.CHANNELS) for k in (0, 1, side, side + 1))
    between = [dr.lerp(dr.lerp(a, b, wx), dr.lerp(c, d, wx), wy) for a, b, c, d in zip(*corners, strict=True)]
    at = earth_pattern.local(between, arithmetic)
    normal = globe.normals(TABLE_SIDE)
    small = earth_pattern.octaves(normal, at, seed, arithmetic, range(large_ones, earth_pattern.OCTAVES))
    noise = small / earth_pattern.sigma(at, arithmetic) + at.lift
    rank = rank_of(mi.Float64(noise), coarse.lowest, coarse.highest, coarse.rank)
    return earth_pattern.depth(mi.Float32(rank), at, arithmetic), at


def kernel_arithmetic() -> Arithmetic:
    """Return Dr.Jit's spelling; within a cell of the lattice single precision is enough."""
    return Arithmetic(dr, dr.select, _split, mi.Float32, constant)


def _split(v: mi.Float64) -> tuple[mi.UInt32, mi.Float32]:
    whole = mi.UInt32(v)
    return whole, mi.Float32(v - mi.Float64(whole))


def _coarse_channels(coarse: Coarse, normal: Vec) -> list[mi.Float64]:
    """Return the coarse map at unit normals."""
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
    return channels


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
    """Return :func:`horizonval.earth.clouds.relief.top_m` of the uniform pattern at unit normals."""
    cover = constant(field.share)
    u = rank_of(relief.noise(normal, field, _split, mi.Float32), *relief.rank_table(field))
    s = (u - (1.0 - cover)) / cover
    risen = dr.exp(dr.log(dr.maximum(s, 1e-12)) * constant(field.exponent))
    return BASE_M + (_ceiling(field, normal) - BASE_M) * dr.select(s > 0.0, risen, s)


def brightness(field: CloudField, height: mi.Float64, normal: Vec) -> mi.Float64:
    """Return the albedo of tops of the uniform pattern at heights below verticals, over that of the highest."""
    risen = dr.clip((height - BASE_M) / (_ceiling(field, normal) - BASE_M), 0.0, 1.0)
    return relief.BASE_BRIGHTNESS + (1.0 - relief.BASE_BRIGHTNESS) * risen


def _ceiling(field: CloudField, normal: Vec) -> mi.Float64:
    return dr.minimum(constant(field.top_m), _tropopause(normal[2]))


def _tropopause(z: Real) -> Real:
    latitude = dr.abs(dr.rad2deg(dr.asin(dr.clip(z, -1.0, 1.0))))
    middle = 0.5 * (relief.TROPICAL_TROPOPAUSE_M + relief.POLAR_TROPOPAUSE_M)
    half = 0.5 * (relief.TROPICAL_TROPOPAUSE_M - relief.POLAR_TROPOPAUSE_M)
    # tanh((latitude - 40) / 10), by a function that a GPU has in double precision
    poleward = 1.0 - 2.0 / (dr.exp((latitude - 40.0) / 5.0) + 1.0)
    return middle - half * poleward


def first_cloud(
    table: CloudTable, planet: Planet, o: Vec, d: Vec, to_ground: bool | mi.Bool, bending: BendingField | None = None
) -> tuple[mi.Bool, mi.Float64]:
    """Return ``(hit, t)``: whether rays meet a cloud, and at what parameter.

    ``to_ground``: the rays meet the ground, and nothing beyond it counts. ``bending``: the rays are the straight ones
    of refracted light; the clouds are met where the bent ones are.
    """
    return first_cloud_and_turn(table, planet, o, d, to_ground, bending)[:2]


def first_cloud_and_turn(
    table: CloudTable, planet: Planet, o: Vec, d: Vec, to_ground: bool | mi.Bool, bending: BendingField | None = None
) -> tuple[mi.Bool, mi.Float64, mi.Float64 | None]:
    """Return ``(hit, t, angle)``: as :func:`first_cloud`, and the bending angle [rad] there or at the ground.

    None without refraction. From 500 km the error is 1.6e-5 rad rms and 4e-5 at most: 100 and 250 m on the ground.
    """
    mid, half, meets = planet.chord(o, d, table.layer_m)
    start, end = dr.maximum(mid - half, 0.0), mid + half
    if to_ground is not False:
        ground_mid, ground_half, _ = planet.chord(o, d)
        end = dr.select(to_ground, dr.minimum(end, ground_mid - ground_half), end)
    meets &= end > start
    single = mi.Float32
    entry, along_ray, way = in_single(along(o, d, start)), in_single(d), single(end - start)
    # half a node of the table is what a step passes over; steep rays come down by more
    rise = dot(planet.height_and_normal(entry)[1], along_ray)
    step_m = single(table.step_m) * inverse_root(dr.maximum(1.0 - rise * rise, LEAST_COSINE**2))
    count = dr.ceil(way / step_m)

    up = None if bending is None else in_single(bending.up(o, d))
    at_start = rate_at_start = zero = 0.0 * way
    if bending is not None and up is not None:
        at_start = single(bending.angle(o, d, END_BENDING_NODES, start, single=True))
        rate_at_start = bending.look(entry, up).rate

    def place(
        s: mi.Float32, before: mi.Float32, angle: mi.Float32, rate: mi.Float32
    ) -> tuple[mi.Float32, Vec3[mi.Float32], mi.Float32, mi.Float32]:
        """Return heights, verticals, bending angles and their rate behind the entry, by those at ``before``."""
        point = along(entry, along_ray, s)
        if bending is None or up is None:
            return *planet.height_and_normal(point), angle, rate
        bent = bending.look(point, up)
        angle = dr.fma(turn_between(rate, bent.rate), s - before, angle)
        return bent.true_m, vertical_of(bent.normal, along_ray, angle), angle, bent.rate

    def inside(height: mi.Float32, normal: Vec3[mi.Float32]) -> mi.Bool:
        top = table.top(normal)
        return (top > BASE_M) & (height <= top)

    def advance(
        i: mi.Float32, before: mi.Float32, angle: mi.Float32, rate: mi.Float32, hit: mi.Bool, going: mi.Bool
    ) -> tuple[mi.Float32, mi.Float32, mi.Float32, mi.Float32, mi.Bool, mi.Bool]:
        s = dr.minimum(i * step_m, way)
        height, vertical, angle, rate = place(s, before, angle, rate)
        hit = inside(height, vertical)
        # steps to where the ray may come down to the highest top around
        falling = dr.maximum(-dot(vertical, along_ray) * step_m, 1e-3)
        steps = single(1.0)
        for squares in table.squares:
            free = dr.floor((height - SKIP_MARGIN_M - table.highest_around(squares, vertical)) / falling) + 1.0
            steps = dr.maximum(steps, dr.minimum(free, single(squares.steps)))
        following = dr.select(hit, i, i + steps)
        return following, s, angle, rate, hit, ~hit & (following <= count)

    index, last, angle, rate, hit, _ = dr.while_loop(
        (zero, zero + 0.0, at_start, rate_at_start, meets & ~meets, dr.copy(meets)),
        lambda i, before, angle, rate, hit, going: going,
        advance,
        labels=("i", "before", "angle", "rate", "hit", "going"),
        label="cloud search",
    )

    def halve(k: mi.UInt32, low: mi.Float32, high: mi.Float32) -> tuple[mi.UInt32, mi.Float32, mi.Float32]:
        middle = 0.5 * (low + high)
        covered = inside(*place(middle, middle, angle, rate)[:2])
        return k + 1, dr.select(covered, low, middle), dr.select(covered, middle, high)

    high = dr.minimum(index * step_m, way)
    _, _, high = dr.while_loop(
        (mi.UInt32(0), dr.maximum((index - 1.0) * step_m, 0.0), high),
        lambda k, low, high: hit & (k < BISECTIONS),
        halve,
        labels=("k", "low", "high"),
        label="cloud edge",
    )
    t = start + mi.Float64(high)
    if bending is None:
        return hit, t, None
    return hit, t, mi.Float64(place(dr.select(hit, high, way), last, angle, rate)[2])


NODES_PER_SCALE, MOST_NODES = 32, 3072


@dataclass(frozen=True)
class GapMap:
    """The cloud's share of the mean column, f / c, less one; ``cover``: c; ``scale_m``: of the gaps."""

    values: mi.Float32
    globe: GlobeMap
    cover: mi.Float64
    scale_m: float

    def share(self, normal: Vec) -> mi.Float64:
        """Return the cloud's share f of its full optical depth below unit normals."""
        return (self.excess(normal) + 1.0) * self.cover

    def excess(self, normal: Vec) -> mi.Float64:
        """Return by how much of the mean column a layer exceeds it below unit normals: -1 in a gap."""
        return self.globe.look(self.values, normal)


def gap_map(gaps: LayerGaps, planet: Planet, origin: tuple[float, float, float], top_m: float) -> GapMap:
    """Return the map of a layer below ``top_m`` around the point below a camera; those of the last few stay."""
    return _gap_map(gaps, planet, origin, top_m, mi.variant())


@lru_cache(maxsize=4)
def _gap_map(
    gaps: LayerGaps, planet: Planet, origin: tuple[float, float, float], top_m: float, variant: str | None
) -> GapMap:
    def side(size_m: float) -> int:
        return min(MOST_NODES, math.ceil(size_m / gaps.scale_m * NODES_PER_SCALE))

    globe, _ = GlobeMap.of(planet, origin, top_m, side)
    arithmetic, seed = kernel_arithmetic(), dr.opaque(mi.UInt32, gaps.seed, 1)
    normal = globe.normals(int(globe.side[0]))
    noise = layers.gap_noise(gaps, normal, seed, arithmetic.split, arithmetic.real)
    rank = rank_of(mi.Float64(noise), *layers.rank_table(gaps))
    cloudy = dr.clip((rank - constant(1.0 - gaps.cover)) / constant(gaps.softness) + 0.5, 0.0, 1.0)
    values = mi.Float32(cloudy / constant(gaps.cover) - 1.0)
    dr.eval(values)
    return GapMap(values, globe, constant(gaps.cover), gaps.scale_m)
