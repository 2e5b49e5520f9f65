"""Cover of the globe, in cells of 0.05 degrees, its height, in cells of one degree, and chequered test grounds.

**Map.** The kinds of ground are those of the MODIS land cover of 2019 combined to fifteen
(``tests/data/make_ground_map.py``), four bits each. Weights are bilinear between the centres of four cells. A place is
land where its land cells weigh more than one half, so that coasts are smooth lines; its kind is a blend of those cells.
Lakes are water, the great ice shelves of Antarctica ice sheet. Heights are means of the land in a cell, for
temperatures only: the ground itself lies on the ellipsoid.

**Materials.** A kind of ground is a mixture of green vegetation, soil and bright sand; the rest is shade. Each mixture
reproduces the published broadband albedo of its IGBP class.

**Snow** covers land poleward of a line that moves with the month (:func:`snow_share`). Trees hide part of it: A. K.
Betts and J. H. Ball, J. Geophys. Res. 102, 28901 (1997), measured an albedo of 0.75 for snow-covered grass, 0.21 for
aspen and 0.13 for conifers; satellites find somewhat more (E. G. Moody et al., Remote Sens. Environ. 111, 337 (2007)).
Ice sheets are always firn. The area beyond the line is the mean snow cover of the northern hemisphere (Rutgers Global
Snow Lab: 47 million km2 in January, 2.9 in August). Neglected: snow on mountains off that line and in the southern
hemisphere, and the seasons of leaves and crops.

**The sea** is water with foam, and white where it is frozen (:mod:`horizonval.earth.surface.sea_ice`).

**Chequered ground.** The globe is divided into belts of latitude of equal height, and each belt into an even number of
equal pieces of longitude, as near to a square in its middle as whole numbers allow. Belts are counted from the south
pole, pieces from 180 deg eastwards; where the sum is even the ground is of the first kind.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth import tables
from horizonval.earth.surface import sea_ice
from horizonval.earth.surface.materials import DRY

ROWS, COLUMNS = 3600, 7200
PER_DEGREE = 20.0
KINDS = (
    "sea",
    "ice sheet",
    "boreal forest",
    "tropical forest",
    "temperate forest",
    "woodland",
    "savannah",
    "grassland",
    "cropland",
    "shrubland",
    "tundra",
    "desert",
    "rock",
    "wetland",
    "town",
)
SEA = KINDS.index("sea")
HEIGHT_STEP_M = 25.0


@cache
def _packed() -> NDArray[np.uint8]:
    """Return the cells, two per byte, the first in the low half: rows from 90 S, columns eastward from 180 W."""
    return np.ascontiguousarray(tables.npz("ground_map.npz")["kinds"], dtype=np.uint8)


def packed_words() -> NDArray[np.uint32]:
    """Return the map for the renderer, eight cells per word, the first in the lowest bits."""
    return _packed().view("<u4").ravel().astype(np.uint32, copy=False)


@cache
def heights_m() -> FloatArray:
    """Return heights of land [m], shape (180, 360), rows from 90 S, columns eastward from 180 W; 0 at sea."""
    heights = HEIGHT_STEP_M * tables.npz("ground_map.npz")["height"].astype(np.float64)
    heights.setflags(write=False)
    return heights


def kinds_around(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> tuple[NDArray[np.uint8], FloatArray]:
    """Return the kinds of the four cells around places and their weights, shapes (4, ...).

    Geodetic latitudes and longitudes (from -540 on) broadcast.
    """
    rows, columns, weights = _around(latitude_deg, longitude_deg, PER_DEGREE, ROWS, COLUMNS)
    pairs = _packed()[rows, columns >> 1]
    return (pairs >> (4 * (columns & 1)).astype(np.uint8)) & 15, weights


def height_m(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> FloatArray:
    """Return the height of the land around places [m]; parameters as :func:`kinds_around`."""
    rows, columns, weights = _around(latitude_deg, longitude_deg, 1.0, 180, 360)
    return np.asarray(np.sum(weights * heights_m()[rows, columns], axis=0))


def mean_height_m(latitude_deg: ArrayLike) -> FloatArray:
    """Return the mean height of land along circles of latitude [m], without Greenland and Antarctica."""
    return np.interp(np.asarray(latitude_deg, dtype=np.float64), np.arange(-89.5, 90.0), _mean_heights_m())


def air_begins_m(latitude_deg: FloatArray, longitude_deg: FloatArray | None) -> FloatArray:
    """Return the height at which columns of air begin [m]: that of the land poleward of 62 deg, 0 within 58 deg.

    Without longitudes: the mean of land and sea along circles of latitude south of 60 S, 0 elsewhere.
    """
    if longitude_deg is not None:
        return height_m(latitude_deg, longitude_deg) * np.clip((np.abs(latitude_deg) - 58.0) / 4.0, 0.0, 1.0)
    mean = np.where(np.arange(180) < 30, heights_m().mean(axis=1), 0.0)
    return np.interp(latitude_deg, np.arange(-89.5, 90.0), mean)


def highest_m(latitude_deg: ArrayLike) -> FloatArray:
    """Return an upper bound of :func:`height_m` at latitudes [m]."""
    row = np.clip(np.floor(np.asarray(latitude_deg, dtype=np.float64)).astype(np.int64) + 90, 0, 179)
    rows = heights_m().max(axis=1)
    return np.maximum(rows[row], np.maximum(rows[np.maximum(row - 1, 0)], rows[np.minimum(row + 1, 179)]))


@cache
def _mean_heights_m() -> FloatArray:
    heights = heights_m().copy()
    south, (east, west), north = 90 - 60, (180 - 74, 180 - 11), 90 + 59
    heights[:south] = 0.0
    heights[north:, east:west] = 0.0
    return np.asarray(heights.sum(axis=1) / np.maximum((heights > 0.0).sum(axis=1), 1))


def _around(
    latitude_deg: ArrayLike, longitude_deg: ArrayLike, per_degree: float, rows: int, columns: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    latitude, longitude = np.broadcast_arrays(
        np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64)
    )
    y = np.clip((latitude + 90.0) * per_degree - 0.5, 0.0, rows - 1.0)
    x = (longitude + 540.0) * per_degree - 0.5
    i, j = np.minimum(y.astype(np.int64), rows - 2), np.floor(x).astype(np.int64)
    wy, wx = y - i, x - j
    weights = np.stack([(1 - wy) * (1 - wx), (1 - wy) * wx, wy * (1 - wx), wy * wx])
    return np.stack([i, i, i + 1, i + 1]), np.stack([j, j + 1, j, j + 1]) % columns, weights


EARTH_RADIUS_KM = 6371.0


def belt_count(square_km: float) -> int:
    """Return the number of belts."""
    return max(1, round(math.pi * EARTH_RADIUS_KM / square_km))


def piece_counts(square_km: float) -> FloatArray:
    """Return the number of pieces of every belt, from the south."""
    belts = belt_count(square_km)
    middle = ((np.arange(belts) + 0.5) / belts - 0.5) * math.pi
    return np.asarray(2.0 * np.maximum(1.0, np.rint(math.pi * EARTH_RADIUS_KM * np.cos(middle) / square_km)))


SNOW_EDGE_DEG = 2.0
"""Half width in latitude of the edge of the snow cover."""
SNOW_LINE_DEG = (39.8, 40.5, 44.1, 50.3, 58.0, 65.1, 70.1, 71.5, 68.6, 58.7, 48.2, 42.1)
"""Northern snow line in the middle of each month, January first."""

_MIXTURES: Mapping[str, tuple[float, float, float, float, float]] = MappingProxyType(
    {
        "sea": (0.0, 0.0, 0.0, 0.0, 0.0),
        "ice sheet": (0.0, 0.0, 0.0, 1.0, 0.0),
        "boreal forest": (0.42, 0.08, 0.0, 0.0, 0.25),
        "tropical forest": (0.62, 0.02, 0.0, 0.0, 0.3),
        "temperate forest": (0.62, 0.08, 0.0, 0.0, 0.3),
        "woodland": (0.50, 0.20, 0.0, 0.0, 0.45),
        "savannah": (0.45, 0.35, 0.0, 0.0, 0.7),
        "grassland": (0.40, 0.50, 0.05, 0.0, 1.0),
        "cropland": (0.55, 0.35, 0.0, 0.0, 0.9),
        "shrubland": (0.20, 0.50, 0.25, 0.0, 0.9),
        "tundra": (0.40, 0.45, 0.0, 0.0, 1.0),
        "desert": (0.0, 0.25, 0.75, 0.0, 1.0),
        "rock": (0.05, 0.80, 0.0, 0.0, 1.0),
        "wetland": (0.50, 0.10, 0.0, 0.0, 0.8),
        "town": (0.30, 0.55, 0.0, 0.0, 0.6),
    }
)
"""Vegetation, soil, sand, firn; and the share of a snow cover that is visible from above."""


@dataclass(frozen=True)
class GroundCover:
    """Materials of the ground at places; arrays of one shape.

    ``shares``: of every material of :data:`horizonval.earth.surface.materials.DRY`, and of "water" without its foam.
    """

    land: NDArray[np.bool_]
    shares: dict[str, FloatArray]


def mixtures() -> FloatArray:
    """Return the mixture of every kind of ground, shape (kinds, 5); see ``_MIXTURES``."""
    return np.array([_MIXTURES[kind] for kind in KINDS])


def ground_cover(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: float) -> GroundCover:
    """Return the materials of the ground at geodetic places, which broadcast; ``month``: 7.0 is the middle of July."""
    latitude, longitude = np.broadcast_arrays(np.asarray(latitude_deg, float), np.asarray(longitude_deg, float))
    kinds, weights = kinds_around(latitude, longitude)
    weights = weights * (kinds != SEA)
    on_land = weights.sum(axis=0)
    land = on_land > 0.5
    table = mixtures()
    mixture = np.stack([np.sum(weights * table[kinds, k], axis=0) for k in range(table.shape[1])])
    vegetation, soil, sand, firn, seen = np.where(land, mixture / np.maximum(on_land, 0.5), 0.0)
    snow = seen * snow_share(latitude, snow_line_deg(month))
    white = np.where(land, 0.0, sea_ice.white_share(latitude, longitude, month))
    bare = 1.0 - snow / np.maximum(1.0 - firn, 1e-6)
    shares = (vegetation * bare, soil * bare, sand * bare, snow + white, firn)
    cover = dict(zip(DRY, shares, strict=True))
    return GroundCover(land, cover | {"water": np.where(land, 0.0, 1.0 - white)})


def snow_line_deg(month: float) -> float:
    """Return the latitude north of which land is under snow, linear between the middles of the months."""
    return float(np.interp(month, np.arange(1, 13), SNOW_LINE_DEG, period=12.0))


def snow_share(latitude_deg: ArrayLike, line_deg: float) -> FloatArray:
    """Return the share of land under snow at a latitude."""
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    return np.clip((latitude - line_deg) / (2.0 * SNOW_EDGE_DEG) + 0.5, 0.0, 1.0)
