"""Cloud fraction by place and month, and the kinds of cloud in it.

The fraction is that of imagers in orbit, including thin cloud: by latitude over sea and over land, with the tropical
belt that follows the Sun, dry deserts and the decks of stratocumulus west of the continents::

    F(lat, lon, month) = sea + share of land (land - sea) + belt,       adjusted in deserts and decks

The result has the published means: 0.67 of the globe, 0.72 of the sea and 0.55 of the land (M. D. King et al., IEEE
Trans. Geosci. Remote Sens. 51, 3826 (2013)), more than 0.8 along 60 S. Values by latitude are rounded after the zonal
means there and in C. J. Stubenrauch et al., Bull. Am. Meteorol. Soc. 94, 1031 (2013), good to 0.05 or 0.1 in a belt of
ten degrees. Places and months of the decks' maxima are those of S. A. Klein and D. L. Hartmann, J. Climate 6, 1587
(1993). Differences between years and between hours of the day are neglected.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter

from horizonval.core.arrays import FloatArray
from horizonval.earth import tables

LATITUDE_DEG = np.arange(-90.0, 91.0, 10.0)
# fmt: off
SEA = (0.70, 0.72, 0.85, 0.91, 0.88, 0.80, 0.68, 0.60, 0.56, 0.54, 0.54, 0.54, 0.60, 0.74, 0.83, 0.84, 0.80, 0.76, 0.75)
LAND = (
    0.50, 0.52, 0.65, 0.76, 0.74, 0.62, 0.44, 0.44, 0.56, 0.64,
    0.56, 0.42, 0.44, 0.52, 0.63, 0.67, 0.68, 0.68, 0.68,
)
# fmt: on
"""Fraction without the tropical belt at the latitudes above."""
BELT, BELT_DEG = 0.20, 5.0
"""Increase in the middle of the tropical belt, and the belt's width (standard deviation)."""
BELT_SEA_DEG, BELT_LAND_DEG = (6.5, 2.5), (1.0, 11.0)
"""Mean latitude of the belt and its amplitude, over the open sea and over land; northernmost in August."""
BELT_NORTH_MONTH = 8.0
COAST_DEG = 3.0
"""Distance over which the fraction changes from land to sea (standard deviation)."""
LARGEST, LEAST = 0.97, 0.04


@dataclass(frozen=True)
class Region:
    """An ellipse of latitude and longitude [deg] with its cloud fraction; widths are standard deviations.

    ``swing`` and ``month``: increase of the fraction in the month of its maximum.
    """

    latitude: float
    longitude: float
    width: tuple[float, float]
    fraction: float
    swing: float = 0.0
    month: float = 1.0


DESERTS = (
    Region(23.0, 0.0, (6.5, 9.0), 0.16),
    Region(23.0, 20.0, (6.5, 11.0), 0.14),
    Region(22.0, 46.0, (6.5, 7.5), 0.16),
    Region(30.0, 61.0, (4.5, 7.0), 0.28),
    Region(-25.0, 132.0, (6.0, 10.0), 0.28),
    Region(-23.0, 19.0, (5.0, 5.0), 0.28),
    Region(-23.0, -69.0, (6.0, 2.5), 0.18),
    Region(31.0, -109.0, (5.0, 6.0), 0.32),
)
DECKS = (
    Region(25.0, -125.0, (6.0, 8.0), 0.74, 0.08, 7.0),
    Region(-15.0, -85.0, (7.0, 8.0), 0.80, 0.08, 10.0),
    Region(-15.0, 5.0, (6.0, 7.0), 0.78, 0.08, 10.0),
    Region(-30.0, 100.0, (5.0, 7.0), 0.68, 0.06, 1.0),
    Region(22.0, -29.0, (5.0, 6.0), 0.58, 0.06, 7.0),
)
"""Off California, Peru, Namibia, western Australia and the Canary Islands."""


@dataclass(frozen=True)
class CloudKinds:
    """Cloud fraction at places, and the shares, of sum 1, of four kinds of cloud in it.

    ``deep``: tropical convection; ``fronts``: of middle and high latitudes; ``deck``: stratocumulus; ``cumulus``: of
    the trade winds, and the rest.
    """

    fraction: FloatArray
    deep: FloatArray
    fronts: FloatArray
    deck: FloatArray
    cumulus: FloatArray


def cloud_kinds(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: int) -> CloudKinds:
    """Return the mean cloudiness at places (arrays of one shape) in a month, 1 for January."""
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    longitude = np.asarray(longitude_deg, dtype=np.float64)
    land = land_share(latitude, longitude)
    belt = _belt(latitude, longitude, land, month)
    sea, dry = (np.interp(latitude, LATITUDE_DEG, row) for row in (SEA, LAND))
    fraction = sea + land * (dry - sea) + BELT * belt
    for region in DESERTS:
        weight = land * _inside(region, latitude, longitude)
        fraction = fraction + weight * (region.fraction - fraction)
    deck = np.zeros_like(fraction)
    for region in DECKS:
        weight = (1.0 - land) * _inside(region, latitude, longitude)
        season = math.cos(2.0 * math.pi * (month - region.month) / 12.0)
        fraction = fraction + weight * (region.fraction + region.swing * season - fraction)
        deck = np.maximum(deck, weight)
    # deep clouds extend beyond the belt
    deep = (1.0 - deck) * np.minimum(np.sqrt(np.maximum(belt, 0.0)), 1.0)
    fronts = (1.0 - deck - deep) * _smooth((np.abs(latitude) - 24.0) / 16.0)
    return CloudKinds(np.clip(fraction, LEAST, LARGEST), deep, fronts, deck, 1.0 - deck - deep - fronts)


def _smooth(x: FloatArray) -> FloatArray:
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _inside(region: Region, latitude: FloatArray, longitude: FloatArray) -> FloatArray:
    east = np.remainder(longitude - region.longitude + 180.0, 360.0) - 180.0
    north = latitude - region.latitude
    # flat in the middle
    return np.exp(-0.5 * ((north / region.width[0]) ** 2 + (east / region.width[1]) ** 2) ** 1.5)


def _belt(latitude: FloatArray, longitude: FloatArray, land: FloatArray, month: int) -> FloatArray:
    """Return the share of the tropical belt at places, including its branch in the South Pacific."""
    season = math.cos(2.0 * math.pi * (month - BELT_NORTH_MONTH) / 12.0)
    # the monsoon's sea swings with the land around
    monsoon = np.exp(-0.5 * ((np.remainder(longitude - 85.0 + 180.0, 360.0) - 180.0) / 25.0) ** 2)
    follows = np.maximum(land, monsoon)
    over_sea, over_land = (mean + swing * season for mean, swing in (BELT_SEA_DEG, BELT_LAND_DEG))
    middle = over_sea + follows * (over_land - over_sea)
    width = BELT_DEG * (1.0 + 0.6 * follows)
    belt = np.exp(-0.5 * ((latitude - middle) / width) ** 2)
    # from New Guinea to 30 S, 140 W
    east = np.remainder(longitude - 150.0 + 180.0, 360.0) - 180.0
    away = (latitude + 3.0 + 0.38 * east) / 5.0
    branch = np.exp(-0.5 * away**2) * _smooth((east + 15.0) / 15.0) * _smooth((75.0 - east) / 25.0)
    return np.maximum(belt, 0.9 * branch)


@cache
def _land_map() -> FloatArray:
    """Return the share of land around the centres of cells of one degree, from 90 S and 180 W on.

    The cells are those of :mod:`horizonval.earth.surface.ground_map`, 20 x 20 to a degree, two per byte, 0 for the sea;
    they are read from the file because that room imports this one.
    """
    packed = np.ascontiguousarray(tables.npz("ground_map.npz")["kinds"], dtype=np.uint8)
    pairs = ((packed & 15) > 0).astype(np.float32) + (packed > 15)
    cells = pairs.reshape(180, 20, 360, 10).mean(axis=(1, 3), dtype=np.float64) / 2.0
    smooth = gaussian_filter(cells, COAST_DEG, mode=("nearest", "wrap"))
    # a pole has one value, however many columns its row has
    for row in (0, -1):
        smooth[row] = smooth[row].mean()
    smooth.setflags(write=False)
    return np.asarray(smooth)


def land_share(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    """Return the share of land within some 300 km of places."""
    y = np.clip(latitude_deg + 89.5, 0.0, 179.0)
    x = np.remainder(longitude_deg + 179.5, 360.0)
    i, j = np.minimum(y.astype(int), 178), x.astype(int) % 360
    wy, wx, cells = y - i, x - np.floor(x), _land_map()
    low = cells[i, j] + wx * (cells[i, (j + 1) % 360] - cells[i, j])
    high = cells[i + 1, j] + wx * (cells[i + 1, (j + 1) % 360] - cells[i + 1, j])
    return low + wy * (high - low)
