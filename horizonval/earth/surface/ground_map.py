"""What covers the globe, in cells of 0.05 degrees, and how high it lies, in cells of one degree.

The kinds of ground are those of the MODIS land cover of 2019 put together to fifteen (``tests/data/make_ground_map.py``
says how), four bits each. Between the centres of four cells weights are bilinear. A place is land where the cells of
land among them weigh more than one half: coasts are smooth lines and not staircases; its kind is then a blend of those
cells. Lakes are water, the great ice shelves of Antarctica ice sheet.

Heights are means of what is land in a cell, for temperatures: the ground itself lies on the ellipsoid.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth import tables

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
SEA, ICE_SHEET = KINDS.index("sea"), KINDS.index("ice sheet")
HEIGHT_STEP_M = 25.0


@cache
def _packed() -> NDArray[np.uint8]:
    """Return the cells, two a byte, the first in the low half: rows from 90 S, columns eastward from 180 W."""
    return np.ascontiguousarray(tables.npz("ground_map.npz")["kinds"], dtype=np.uint8)


def packed_words() -> NDArray[np.uint32]:
    """Return the map for the renderer, eight cells a word, the first in the lowest bits."""
    return _packed().view("<u4").ravel().astype(np.uint32, copy=False)


@cache
def heights_m() -> FloatArray:
    """Return heights of land [m], shape (180, 360), rows from 90 S, columns eastward from 180 W; 0 at sea."""
    heights = HEIGHT_STEP_M * tables.npz("ground_map.npz")["height"].astype(np.float64)
    heights.setflags(write=False)
    return heights


def kinds_around(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> tuple[NDArray[np.uint8], FloatArray]:
    """Return the kinds of the four cells around places and their weights, shapes (4, ...).

    Parameters
    ----------
    latitude_deg, longitude_deg : array_like
        Geodetic, broadcast against each other; longitudes from -540 on.
    """
    rows, columns, weights = _around(latitude_deg, longitude_deg, PER_DEGREE, ROWS, COLUMNS)
    pairs = _packed()[rows, columns >> 1]
    return (pairs >> (4 * (columns & 1)).astype(np.uint8)) & 15, weights


def is_land(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> NDArray[np.bool_]:
    """Return whether places lie on land, ice sheets included; parameters as :func:`kinds_around`."""
    kinds, weights = kinds_around(latitude_deg, longitude_deg)
    return np.asarray(np.sum(weights * (kinds != SEA), axis=0) > 0.5)


def height_m(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> FloatArray:
    """Return the height of the land around places [m]; parameters as :func:`kinds_around`."""
    rows, columns, weights = _around(latitude_deg, longitude_deg, 1.0, 180, 360)
    return np.asarray(np.sum(weights * heights_m()[rows, columns], axis=0))


def mean_height_m(latitude_deg: ArrayLike) -> FloatArray:
    """Return the mean height of land along circles of latitude [m], Greenland and Antarctica left out."""
    return np.interp(np.asarray(latitude_deg, dtype=np.float64), np.arange(-89.5, 90.0), _mean_heights_m())


def air_begins_m(latitude_deg: FloatArray, longitude_deg: FloatArray | None) -> FloatArray:
    """Return the height at which columns of air begin [m]: that of the land poleward of 62 deg, 0 within 58 deg.

    Without longitudes the mean of land and sea along circles of latitude south of 60 S, 0 elsewhere.
    """
    if longitude_deg is not None:
        return height_m(latitude_deg, longitude_deg) * np.clip((np.abs(latitude_deg) - 58.0) / 4.0, 0.0, 1.0)
    mean = np.where(np.arange(180) < 30, heights_m().mean(axis=1), 0.0)
    return np.interp(latitude_deg, np.arange(-89.5, 90.0), mean)


def highest_m(latitude_deg: ArrayLike) -> FloatArray:
    """Return a height that :func:`height_m` does not pass at latitudes [m]."""
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
