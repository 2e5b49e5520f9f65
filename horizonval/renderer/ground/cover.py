"""What the ground below rays is made of: :mod:`horizonval.earth.surface.ground_map`, written again for the kernel.

The map is a table of words, eight cells in each. Kinds of ground are looked up in a table of mixtures, four cells a
ray, and blended; the ice of the sea in the latitudes of its edges in the month at hand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.earth.surface import city_lights as city_lights_map
from horizonval.earth.surface import ground_map, sea_ice
from horizonval.earth.surface.materials import DRY
from horizonval.earth.surface.snow_reflectance import mean_reflection
from horizonval.renderer.types import Vec


@dataclass(frozen=True)
class GroundTable:
    """The ground of a month. ``words``: the map; ``mixtures``: of kinds, one behind the other; ``edges``: of sea ice,
    north and then south [deg]; ``heights`` [m];
    ``snow``: what the reflectance of snow is divided by;
    ``inhabitants``: per square metre, where cities shine.
    """

    words: mi.UInt32
    mixtures: mi.Float64
    edges: mi.Float64
    heights: mi.Float32
    snow_line_deg: mi.Float64
    white_north: mi.Float64
    white_south: mi.Float64
    snow: mi.Float64
    inhabitants: mi.Float32 | None = None

    @classmethod
    def of(cls, month: float, city_lights: bool = False) -> GroundTable:
        """Return the ground of a month."""
        edges = np.concatenate(sea_ice.edges_deg(month))
        north, south = sea_ice.white_shares(month)
        return cls(
            mi.UInt32(ground_map.packed_words()),
            mi.Float64(ground_map.mixtures().ravel()),
            mi.Float64(edges),
            mi.Float32(ground_map.heights_m().ravel()),
            dr.opaque(mi.Float64, ground_map.snow_line_deg(month), 1),
            dr.opaque(mi.Float64, north, 1),
            dr.opaque(mi.Float64, south, 1),
            mi.Float64(mean_reflection()),
            mi.Float32(city_lights_map.inhabitants_per_m2().ravel()) if city_lights else None,
        )


@dataclass(frozen=True)
class Places:
    """Where rays meet the ground. ``latitude``, ``longitude``: geodetic [deg], longitude from 0 to 720."""

    latitude: mi.Float64
    longitude: mi.Float64

    @classmethod
    def below(cls, normal: Vec) -> Places:
        """Return the places with given unit normals of the ellipsoid."""
        latitude = dr.rad2deg(dr.asin(dr.clip(normal[2], -1.0, 1.0)))
        # one turn and a half on from 180 W: never negative
        return cls(latitude, dr.rad2deg(dr.atan2(normal[1], normal[0])) + 540.0)


@dataclass(frozen=True)
class MapCells:
    """The four cells of the map around places: their kinds, and their weights, sea left out."""

    kinds: tuple[mi.UInt32, ...]
    weights: tuple[mi.Float64, ...]

    @property
    def alike(self) -> mi.Bool:
        """Return whether all are of one kind."""
        first, *others = self.kinds
        same = mi.Bool(True)
        for kind in others:
            same &= kind == first
        return same

    @property
    def on_land(self) -> mi.Float64:
        """Return the weight of land."""
        a, b, c, d = self.weights
        return a + b + c + d


def cells_around(table: GroundTable, places: Places) -> MapCells:
    """Look the map up."""
    rows, columns, weights = _around(places, ground_map.PER_DEGREE, ground_map.ROWS, ground_map.COLUMNS)
    kinds, dry = [], []
    for row, column, weight in zip(rows, columns, weights, strict=True):
        cell = row * ground_map.COLUMNS + column
        kind = (dr.gather(mi.UInt32, table.words, cell >> 3) >> ((cell & 7) * 4)) & 15
        kinds.append(kind)
        dry.append(dr.select(kind != ground_map.SEA, weight, 0.0))
    return MapCells(tuple(kinds), tuple(dry))


def look_alike(table: GroundTable, places: Places) -> tuple[mi.UInt32, mi.Bool]:
    """Return a number for what there is at places, and whether it is the same all around them.

    Places of one number have the same ground where it is the same around them, but for the slow ways in which snow and
    ice set in (the number tells none of them, some, and all from each other) and in which the height of land changes
    (it tells the squares in which heights are bilinear).
    """
    cells = cells_around(table, places)
    sea = cells.kinds[0] == ground_map.SEA
    white = dr.select(sea, frozen(table, places), snow_share(table, places))
    rows, columns, _ = _around(places, 1.0, 180, 360)
    square = dr.select(sea, mi.UInt32(0), 64 * (rows[0] * 360 + columns[0]))
    return square + 3 * cells.kinds[0] + mi.UInt32(dr.ceil(white)) + mi.UInt32(dr.floor(white)), cells.alike


def cover(table: GroundTable, places: Places) -> tuple[mi.Bool, dict[str, mi.Float64]]:
    """Return :func:`horizonval.earth.surface.ground_map.ground_cover`: whether there is land, and the shares."""
    cells = cells_around(table, places)
    land = cells.on_land > 0.5
    scale = dr.select(land, 1.0 / dr.maximum(cells.on_land, 0.5), 0.0)
    columns = len(ground_map.mixtures()[0])

    def blended(column: int) -> mi.Float64:
        total = mi.Float64(0.0)
        for kind, weight in zip(cells.kinds, cells.weights, strict=True):
            total = dr.fma(weight, dr.gather(mi.Float64, table.mixtures, kind * columns + column), total)
        return total * scale

    vegetation, soil, sand, firn, seen = (blended(k) for k in range(columns))
    snow = seen * snow_share(table, places)
    bare = 1.0 - snow / dr.maximum(1.0 - firn, 1e-6)
    white = dr.select(land, 0.0, white_share(table, places))
    shares = dict(zip(DRY, (vegetation * bare, soil * bare, sand * bare, snow + white, firn), strict=True))
    return land, shares | {"water": dr.select(land, 0.0, 1.0 - white)}


def snow_share(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.ground_map.snow_share`."""
    into = (places.latitude - table.snow_line_deg) * (0.5 / ground_map.SNOW_EDGE_DEG) + 0.5
    return dr.clip(into, 0.0, 1.0)


def frozen(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.sea_ice.frozen`."""
    count = sea_ice.SECTORS
    x = places.longitude * (count / 360.0) - 0.5
    i = mi.UInt32(x)
    w = x - mi.Float64(i)

    def edge(hemisphere: int) -> mi.Float64:
        low, high = (dr.gather(mi.Float64, table.edges, (i + k) % count + hemisphere * count) for k in (0, 1))
        return dr.lerp(low, high, w)

    beyond = dr.maximum(places.latitude - edge(0), -places.latitude - edge(1))
    return dr.clip(beyond / sea_ice.EDGE_DEG, 0.0, 1.0)


def white_share(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.sea_ice.white_share`."""
    return frozen(table, places) * dr.select(places.latitude > 0.0, table.white_north, table.white_south)


def height_m(table: GroundTable, places: Places) -> mi.Float64:
    """Return :func:`horizonval.earth.surface.ground_map.height_m`."""
    rows, columns, weights = _around(places, 1.0, 180, 360)
    total = mi.Float64(0.0)
    for row, column, weight in zip(rows, columns, weights, strict=True):
        total = dr.fma(weight, mi.Float64(dr.gather(mi.Float32, table.heights, row * 360 + column)), total)
    return total


def luminance(table: GroundTable, places: Places, mu_sun: mi.Float64, mu_view: mi.Float64) -> mi.Float64:
    """Return what cities shine [lm m-2 sr-1]; :mod:`horizonval.earth.surface.city_lights`, written again."""
    assert table.inhabitants is not None
    per_degree = city_lights_map.PER_DEGREE
    rows, columns, weights = _around(places, float(per_degree), 180 * per_degree, 360 * per_degree)
    density = mi.Float64(0.0)
    for row, column, weight in zip(rows, columns, weights, strict=True):
        cell = row * (360 * per_degree) + column
        density = dr.fma(weight, mi.Float64(dr.gather(mi.Float32, table.inhabitants, cell)), density)
    c = dr.clip(mu_view, city_lights_map.LEAST_COSINE, 1.0)
    z = dr.acos(c)
    down = 2.0 * city_lights_map.GROUND_REFLECTANCE * (1.0 - city_lights_map.UPWARD_SHARE) * c
    per_head = (down + 0.554 * city_lights_map.UPWARD_SHARE * z * z * z * z) / c
    burning = dr.clip(-mu_sun / city_lights_map.ALL_ON_SINE, 0.0, 1.0)
    return density * burning * per_head * (city_lights_map.LUMENS_PER_HEAD / (2.0 * math.pi))


def _around(
    places: Places, per_degree: float, rows: int, columns: int
) -> tuple[list[mi.UInt32], list[mi.UInt32], list[mi.Float64]]:
    """Return rows, columns and weights of the four cells around places."""
    y = dr.clip((places.latitude + 90.0) * per_degree - 0.5, 0.0, rows - 1.0)
    x = places.longitude * per_degree - 0.5
    i, j = dr.minimum(mi.UInt32(y), rows - 2), mi.UInt32(x)
    wy, wx = y - mi.Float64(i), x - mi.Float64(j)
    west, east = j % columns, (j + 1) % columns
    weights = [(1.0 - wy) * (1.0 - wx), (1.0 - wy) * wx, wy * (1.0 - wx), wy * wx]
    return [i, i, i + 1, i + 1], [west, east, west, east], weights
