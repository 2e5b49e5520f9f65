"""Sea ice: a climatological edge by month and longitude, and the white share of the ice.

Poleward of an edge the sea is frozen. The edge moves between its summer and its winter latitude with a number that
depends on the month alone::

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
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

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
