"""Where land is: a map of 0.25 degrees, rasterised from Natural Earth's land polygons (scale 1:50 million).

Between the centres of four cells the map is bilinear, and land is where it exceeds one half: coasts are smooth lines
and not staircases. Lakes count as land, ice shelves as sea.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.earth import tables

ROWS, COLUMNS = 720, 1440
PER_DEGREE = 4.0


def packed_words() -> NDArray[np.uint32]:
    """Return the map, 32 cells a word, the first in the lowest bit: rows from 90 S, columns eastward from 180 W."""
    return np.ascontiguousarray(tables.npz("land_map.npz")["land"]).view("<u4").ravel().astype(np.uint32)


@cache
def _cells() -> NDArray[np.uint8]:
    packed = np.ascontiguousarray(tables.npz("land_map.npz")["land"], dtype=np.uint8)
    return np.unpackbits(packed, axis=1, bitorder="little")


def is_land(latitude_deg: ArrayLike, longitude_deg: ArrayLike) -> NDArray[np.bool_]:
    """Return whether places (geodetic, broadcast against each other) lie on land."""
    y = (np.asarray(latitude_deg, dtype=np.float64) + 90.0) * PER_DEGREE - 0.5
    x = (np.asarray(longitude_deg, dtype=np.float64) + 180.0) * PER_DEGREE - 0.5
    i, j = np.floor(y).astype(int), np.floor(x).astype(int)
    wy, wx = y - i, x - j
    south, north = np.clip(i, 0, ROWS - 1), np.clip(i + 1, 0, ROWS - 1)
    west, east = j % COLUMNS, (j + 1) % COLUMNS
    cells = _cells()
    low = (1 - wx) * cells[south, west] + wx * cells[south, east]
    high = (1 - wx) * cells[north, west] + wx * cells[north, east]
    return (1 - wy) * low + wy * high > 0.5
