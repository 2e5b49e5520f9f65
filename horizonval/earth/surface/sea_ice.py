"""Where the sea is frozen: a climatological edge by month and longitude, and how much of the ice is white.

Poleward of the edge of a month and a longitude the sea is under ice. The edge moves between its summer and its winter
latitude, linear in a number from 0 to 1 that is that of the month::

    edge(longitude, month) = summer(longitude) + advance(month) (winter(longitude) - summer(longitude))

The latitudes are read, to a degree or so, off the median edges of the Sea Ice Index for March and September (north) and
September and February (south) (F. Fetterer et al., NSIDC data set G02135, version 3; medians of 1981 to 2010). The
``advance`` of each month was chosen here so that the sea beyond the edge has the monthly mean extent of the same index
(mean of the years 1995, 2000, ... 2020). What that cannot have: single winters, seas that lag behind the hemisphere
(the Sea of Okhotsk is free in June, Hudson Bay in August), the ice of the Baltic.

Over three degrees from the edge on, concentration rises to what it is inside the pack. :data:`WHITE_NORTH` and
:data:`WHITE_SOUTH` say how much of the surface there is snow or white ice; the rest is leads and, in the Arctic summer,
ponds, and counts as water (concentrations after C. L. Parkinson and D. J. Cavalieri, J. Geophys. Res. 113, C07003 and
C07004 (2008); ponds after D. K. Perovich et al., ibid. 107, 8044 (2002), whose albedo of Arctic ice goes from 0.85 in
April to 0.5 in July and back). Bare ice counts as snow: in the near infrared it is darker.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

SECTORS = 36
"""Of ten degrees of longitude, the first from 180 to 170 W; edges hold in their middles."""
EDGE_DEG = 3.0
"""Latitudes from the first ice to the pack."""
EXTENT_SHARE = 0.15
"""Concentration from which the sea counts as frozen in published extents."""

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
EXTENT_NORTH = (13.91, 14.73, 14.90, 14.21, 12.79, 11.05, 8.48, 6.13, 5.22, 7.14, 9.96, 12.23)
EXTENT_SOUTH = (5.26, 3.21, 4.27, 7.20, 10.64, 13.77, 16.24, 18.00, 18.69, 18.36, 16.14, 10.45)
"""Published extents, million km2, January first."""
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
    """Return how much of the pack is white, north and south."""
    return _at(month, WHITE_NORTH), _at(month, WHITE_SOUTH)


def frozen(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return how far into the ice places at sea are: 0 at the edge and in open water, 1 in the pack."""
    latitude, longitude = np.asarray(latitude_deg, dtype=np.float64), np.asarray(longitude_deg, dtype=np.float64)
    middle = (np.arange(SECTORS) + 0.5) * 360.0 / SECTORS - 180.0
    north, south = (np.interp(longitude, middle, edge, period=360.0) for edge in edges_deg(month))
    into = np.maximum(latitude - north, -latitude - south) / EDGE_DEG
    return np.clip(into, 0.0, 1.0)


def white_share(latitude_deg: ArrayLike, longitude_deg: ArrayLike, month: float) -> FloatArray:
    """Return how much of the sea is snow or white ice."""
    north, south = white_shares(month)
    return frozen(latitude_deg, longitude_deg, month) * np.where(np.asarray(latitude_deg) > 0.0, north, south)


def _at(month: float, values: tuple[float, ...]) -> float:
    return float(np.interp(month, np.arange(1, 13), values, period=12.0))
