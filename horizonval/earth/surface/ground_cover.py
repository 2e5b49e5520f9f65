"""What the ground at a place is made of in a month: shares of materials.

A kind of ground is a mixture of green vegetation, soil and bright sand; what lacks in its sum is shade. The mixtures
are chosen so that the albedo of each kind over all sunlight is the published one of its IGBP class
(``tests/unit/earth/test_earth_ground_kinds.py`` has both), not measured at one place.

**Snow** covers land poleward of a line that moves with the month (:func:`snow_share`). Over trees it is seen between
and on them only in part: A. K. Betts and J. H. Ball, J. Geophys. Res. 102, 28901 (1997), measured an albedo of 0.75 for
snow-covered grass, 0.21 for aspen and 0.13 for conifers; satellites find somewhat more (E. G. Moody et al., Remote
Sens. Environ. 111, 337 (2007)). Ice sheets are firn everywhere and at all times. The line moves so that the area beyond
it is the mean snow cover of the northern hemisphere (Rutgers Global Snow Lab, monthly means: 47 million km2 in January,
2.9 in August); snow on mountains off that line and on the land of the southern hemisphere is left out, and so are the
seasons of leaves and crops.

**The sea** is water with foam, and white where it is frozen (:mod:`horizonval.earth.surface.sea_ice`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.surface import sea_ice
from horizonval.earth.surface.ground_map import KINDS, SEA, kinds_around
from horizonval.earth.surface.materials import DRY

SNOW_EDGE_DEG = 2.0
"""Half width in latitude of the belt in which snow sets in."""
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
"""Vegetation, soil, sand, firn; and how much of a cover of snow is seen from above."""


@dataclass(frozen=True)
class GroundCover:
    """What the ground at places is made of; arrays of one shape.

    Attributes
    ----------
    land : bool array
    shares : dict of ndarray
        Share of every material of :data:`horizonval.earth.surface.materials.DRY`, and of "water" without its foam.
    """

    land: NDArray[np.bool_]
    shares: dict[str, FloatArray]


def mixtures() -> FloatArray:
    """Return the mixture of every kind of ground, shape (kinds, 5); see ``_MIXTURES``."""
    return np.array([_MIXTURES[kind] for kind in KINDS])


def ground_cover(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: float) -> GroundCover:
    """Return what the ground is made of.

    Parameters
    ----------
    latitude_deg, longitude_deg : array_like
        Geodetic, broadcast against each other.
    month : float
        0.5 to 12.5, 7.0 the middle of July.
    """
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
    """Return how much of the land at a latitude is under snow."""
    latitude = np.asarray(latitude_deg, dtype=np.float64)
    return np.clip((latitude - line_deg) / (2.0 * SNOW_EDGE_DEG) + 0.5, 0.0, 1.0)
