"""A coarse table over the rays of a camera position: all azimuths, signed values, nodes where they are needed.

Cubic interpolation as :mod:`horizonval.renderer.spline_table`, but around the whole circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.renderer.spline_table import Neighbours, cubic_weights
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import Values


class SlowTable:
    """Quantities at nodes of ``rows`` by ``columns``; the columns are even steps of a full circle.

    Parameters
    ----------
    rows, columns : int
    row, azimuth : Float64
        Places [steps] and azimuths [rad] of the rays that will be looked up.
    values : callable
        From rows (n,) and azimuths [rad] (n,) of nodes to quantities (n, q).
    """

    def __init__(
        self,
        rows: int,
        columns: int,
        row: mi.Float64,
        azimuth: mi.Float64,
        values: Callable[[NDArray[np.int64], FloatArray], FloatArray],
    ) -> None:
        self.rows, self.columns = rows, columns
        mask = dr.zeros(mi.UInt32, rows * columns)
        for node, _ in self._nodes(row, azimuth):
            dr.scatter(mask, mi.UInt32(1), node)
            dr.eval(mask)
        needed = np.flatnonzero(np.array(mask))
        made = values(needed // columns, np.asarray(needed % columns * (2.0 * math.pi / columns), dtype=np.float64))
        full = np.zeros((made.shape[1], rows * columns))
        full[:, needed] = made.T
        self._values = [table_of(mi.Float64, quantity) for quantity in full]

    def look(self, row: mi.Float64, azimuth: mi.Float64) -> Values:
        """Return the quantities at places that were given when the table was made."""
        nodes = self._nodes(row, azimuth)
        dr.eval(nodes)
        return [
            sum((weight * dr.gather(mi.Float64, table, node) for node, weight in nodes), start=mi.Float64(0.0))
            for table in self._values
        ]

    def _nodes(self, row: mi.Float64, azimuth: mi.Float64) -> list[tuple[mi.UInt32, mi.Float64]]:
        down = Neighbours.on_parabola(row, self.rows)
        turns = azimuth * (0.5 / math.pi)
        place = (turns - dr.floor(turns)) * float(self.columns)
        j = mi.UInt32(place)
        across = cubic_weights(place - mi.Float64(j))
        near = [(j + k) % self.columns for k in (self.columns - 1, 0, 1, 2)]
        return [
            (i * self.columns + column, a * b)
            for i, a in zip(down.index, down.weight, strict=True)
            for column, b in zip(near, across, strict=True)
        ]
