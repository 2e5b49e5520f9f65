"""Cover of the globe, its height, sea ice, the materials of the ground, and chequered test grounds.

**Map.** The kinds of ground are those of the MODIS land cover of 2019 combined to fifteen
(``tests/data/make_ground_map.py``), four bits each, in cells of 0.05 degrees. Weights are bilinear between the centres
of four cells. A place is land where its land cells weigh more than one half, so that coasts are smooth lines; its kind
is a blend of those cells. Lakes are water, the great ice shelves of Antarctica ice sheet. Heights are means of the land
in a cell of one degree, for temperatures only: the ground itself lies on the ellipsoid.

**Materials.** A kind of ground is a mixture of green vegetation, soil and bright sand; the rest is shade. Each mixture
reproduces the published broadband albedo of its IGBP class.

**Snow** covers land poleward of a line that moves with the month (:func:`snow_share`). Trees hide part of it: A. K.
Betts and J. H. Ball, J. Geophys. Res. 102, 28901 (1997), measured an albedo of 0.75 for snow-covered grass, 0.21 for
aspen and 0.13 for conifers; satellites find somewhat more (E. G. Moody et al., Remote Sens. Environ. 111, 337 (2007)).
Ice sheets are always firn. The area beyond the line is the mean snow cover of the northern hemisphere (Rutgers Global
Snow Lab: 47 million km2 in January, 2.9 in August). Neglected: snow on mountains off that line and in the southern
hemisphere, and the seasons of leaves and crops.

**The sea** is water with foam, and white where it is frozen.

**Chequered ground.** The globe is divided into belts of latitude of equal height, and each belt into an even number of
equal pieces of longitude, as near to a square in its middle as whole numbers allow. Belts are counted from the south
pole, pieces from 180 deg eastwards; where the sum is even the ground is of the first kind.

**Sea ice.** Poleward of a climatological edge the sea is frozen. The edge moves between its summer and its winter
latitude with a number that depends on the month alone::

    edge(longitude, month) = summer(longitude) + advance(month) (winter(longitude) - summer(longitude))

The latitudes are the median edges of the Sea Ice Index for March and September (north) and September and February
(south), to a degree or so (F. Fetterer et al., NSIDC data set G02135, version 3; medians of 1981 to 2010). The
``advance`` of each month gives the sea beyond the edge the monthly mean extent of the same index (mean of the years
1995, 2000, ... 2020). Neglected: differences between winters, seas that lag behind the hemisphere (the Sea of Okhotsk,
Hudson Bay), the ice of the Baltic.

Concentration rises over three degrees from the edge to that of the pack. :data:`WHITE_NORTH` and :data:`WHITE_SOUTH`
are the shares of snow or white ice there; the rest, leads and in the Arctic summer ponds, counts as water
(concentrations after C. L. Parkinson and D. J. Cavalieri, J. Geophys. Res. 113, C07003 and C07004 (2008); ponds after
D. K. Perovich et al., ibid. 107, 8044 (2002)). Bare ice counts as snow, although it is darker in the near infrared.

**Spectra** of the materials, from 0.3 to 2.5 um, are rounded after published measurements:

- ``vegetation``: a closed green canopy; ``soil``: dry soil, rock and straw (shapes after the ASTER spectral library, A.
  M. Baldridge et al., Remote Sens. Environ. 113, 711 (2009));
- ``sand``: bright desert, at the dark end of the bare sands by which satellites are calibrated, as rocky desert lies
  between the sands (H. Cosnefroy et al., ibid. 58, 101 (1996): 0.18 to 0.25 at 0.45 um, 0.35 to 0.5 at 0.65, 0.45 to
  0.6 at 0.85, 0.55 to 0.7 at 1.6);
- ``snow``: S. G. Warren, Rev. Geophys. 20, 67 (1982), grains of a tenth of a millimetre, reduced by a tenth for age and
  dirt; also of sea ice; ``firn``: the clean, dry snow of ice sheets (T. C. Grenfell, S. G. Warren, P. C. Mullen, J.
  Geophys. Res. 99, 18669 (1994): 0.96 to 0.98 in all visible light);
- ``water``: reflectance from below the surface of clear oceanic water with 0.1 mg of chlorophyll per m3 (A. Morel and
  S. Maritorena, ibid. 106, 7163 (2001)); ``foam``: P. Koepke, Appl. Opt. 23, 1816 (1984), spectrally flat.
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

SECTORS = 36
"""Number of sectors of ten degrees of longitude, the first from 180 to 170 W; edges apply in their middles."""
EDGE_DEG = 3.0
"""Width in latitude of the transition from open water to the pack."""

_WINTER_NORTH = (
    60, 58.5, 65, 65, 65, 65, 65, 65, 55, 50, 50, 47, 58, 65, 66, 69, 72, 74,
    78.5, 77, 75, 74.5, 71, 69, 66, 65, 65, 65, 65, 65, 65, 53, 46, 53, 60, 61,
)  # fmt: skip
_SUMMER_NORTH = (
    74.5, 74.5, 74, 73, 73, 74, 74, 75, 76, 78, 79, 80, 82, 80, 82, 72, 76, 79.5,
    81, 81.5, 81.8, 81.8, 81.5, 81.5, 81, 80, 79, 78.5, 77.5, 77, 77.5, 77.5, 76.5, 76, 74.5, 74,
)  # fmt: skip
_WINTER_SOUTH = (
    62, 62, 62.5, 62.5, 63.5, 64.5, 65.5, 66.5, 67, 67.5, 66.5, 65, 60.5, 58, 57, 56, 55.5, 55,
    55.5, 55.5, 56.5, 58, 59.5, 59.5, 59.5, 59, 58.5, 59.5, 60.5, 61.5, 62, 62, 62, 61.5, 61.5, 62,
)  # fmt: skip
_SUMMER_SOUTH = (
    78, 77, 74.5, 73, 72.5, 72, 71.5, 71, 70.5, 70, 70, 68, 65.5, 66, 70, 72, 72, 70.5,
    69.5, 69.5, 69, 68, 68, 66, 66.5, 67, 66, 65.5, 64.5, 65.5, 65.7, 65.5, 66, 67, 69, 73,
)  # fmt: skip
_ADVANCE_NORTH = (0.882, 0.969, 0.986, 0.915, 0.781, 0.619, 0.305, 0.090, 0.000, 0.178, 0.480, 0.736)
_ADVANCE_SOUTH = (0.176, 0.015, 0.100, 0.314, 0.543, 0.736, 0.878, 0.973, 1.011, 0.993, 0.872, 0.531)
WHITE_NORTH = (0.95, 0.95, 0.95, 0.94, 0.90, 0.78, 0.58, 0.55, 0.70, 0.85, 0.91, 0.94)
WHITE_SOUTH = (0.62, 0.62, 0.70, 0.78, 0.82, 0.84, 0.85, 0.85, 0.84, 0.82, 0.76, 0.66)


def edges_deg(month: float) -> tuple[FloatArray, FloatArray]:
    """Return the latitudes beyond which the sea is under ice, north and south, both positive, shape (SECTORS,).

    ``month``: 0.5 to 12.5, 7.0 the middle of July.
    """
    pairs = ((_SUMMER_NORTH, _WINTER_NORTH, _ADVANCE_NORTH), (_SUMMER_SOUTH, _WINTER_SOUTH, _ADVANCE_SOUTH))
    north, south = (
        np.array(summer) + _at(month, advance) * (np.array(winter) - np.array(summer))
        for summer, winter, advance in pairs
    )
    return north, south


def white_shares(month: float) -> tuple[float, float]:
    """Return the white share of the pack, north and south."""
    return _at(month, WHITE_NORTH), _at(month, WHITE_SOUTH)


def frozen(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the depth of places at sea in the ice: 0 at the edge and in open water, 1 in the pack."""
    latitude, longitude = np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64)
    middle = (np.arange(SECTORS) + 0.5) * 360.0 / SECTORS - 180.0
    north, south = (np.interp(longitude, middle, edge, period=360.0) for edge in edges_deg(month))
    into = np.maximum(latitude - north, -latitude - south) / EDGE_DEG
    return np.clip(into, 0.0, 1.0)


def white_share(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return the share of the sea that is snow or white ice."""
    north, south = white_shares(month)
    return frozen(latitude_deg, longitude_deg, month) * np.where(np.asarray(latitude_deg) > 0.0, north, south)


def _at(month: float, values: tuple[float, ...]) -> float:
    return float(np.interp(month, np.arange(1, 13), values, period=12.0))


DRY = ("vegetation", "soil", "sand", "snow", "firn")
"""Materials of land; snow lies on sea ice too."""
FOAM_ALBEDO = 0.22

_SPECTRA = {
    "vegetation": (
        (0.30, 0.40, 0.45, 0.50, 0.55, 0.60, 0.65, 0.68, 0.70, 0.72, 0.75, 0.80, 0.90, 1.10, 1.30, 1.45, 1.65, 1.95,
         2.20, 2.50),
        (0.03, 0.035, 0.04, 0.05, 0.09, 0.07, 0.05, 0.045, 0.09, 0.18, 0.32, 0.37, 0.39, 0.39, 0.34, 0.14, 0.24, 0.06,
         0.13, 0.05),
    ),
    "soil": (
        (0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.10, 1.30, 1.65, 1.95, 2.20, 2.50),
        (0.04, 0.07, 0.11, 0.16, 0.20, 0.23, 0.25, 0.28, 0.31, 0.33, 0.28, 0.31, 0.25),
    ),
    "sand": (
        (0.30, 0.40, 0.45, 0.50, 0.55, 0.60, 0.65, 0.70, 0.80, 0.90, 1.10, 1.30, 1.65, 1.95, 2.20, 2.50),
        (0.07, 0.12, 0.17, 0.21, 0.29, 0.35, 0.39, 0.42, 0.46, 0.48, 0.53, 0.57, 0.60, 0.53, 0.58, 0.48),
    ),
    "snow": (
        (0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00, 1.05, 1.10, 1.20, 1.30, 1.40, 1.50, 1.65, 1.80, 1.95, 2.20, 2.50),
        (0.88, 0.89, 0.885, 0.87, 0.85, 0.81, 0.73, 0.71, 0.72, 0.57, 0.55, 0.30, 0.05, 0.10, 0.18, 0.03, 0.12, 0.03),
    ),
    "firn": (
        (0.30, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00, 1.05, 1.10, 1.20, 1.30, 1.40, 1.50, 1.65, 1.80, 1.95, 2.20, 2.50),
        (0.97, 0.98, 0.98, 0.97, 0.95, 0.92, 0.85, 0.83, 0.84, 0.71, 0.69, 0.45, 0.12, 0.20, 0.30, 0.07, 0.21, 0.08),
    ),
    "water": (
        (0.30, 0.40, 0.44, 0.49, 0.51, 0.55, 0.58, 0.60, 0.65, 0.70, 2.50),
        (0.015, 0.022, 0.020, 0.012, 0.008, 0.004, 0.002, 0.001, 0.0005, 0.0, 0.0),
    ),
}  # fmt: skip
NAMES = tuple(_SPECTRA)


def spectrum(material: str, wavelength_um: ArrayLike) -> FloatArray:
    """Return the albedo of a material of :data:`NAMES`; of water the part from below its surface."""
    return np.interp(np.asarray(wavelength_um, dtype=np.float64), *_SPECTRA[material])


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

    ``shares``: of every material of :data:`horizonval.earth.surface.ground_map.DRY`, and of "water" without its foam.
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
    white = np.where(land, 0.0, white_share(latitude, longitude, month))
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
