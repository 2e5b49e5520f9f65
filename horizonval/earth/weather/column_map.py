r"""Where columns of air stand over a part of the globe that a camera sees: a square lattice on a map.

The map is the stereographic projection about the place c below the camera: a place with the ellipsoid's unit normal n,
and axes e, f across c, lies at::

    x = n . e / (1 + n . c),    y = n . f / (1 + n . c),        sqrt(x^2 + y^2) = tan(theta / 2)

with theta the angle from c. It is smooth everywhere but opposite of c: neither poles nor the date line are in its way,
which a lattice of latitudes and longitudes would have. What is given at the columns is taken as bilinear in (x, y)
between them, and beyond the outermost ones as on them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.directions import perpendicular

COARSER = 4
"""What varies little needs a column in so many each way; maps have a whole number of them along a side."""


@dataclass(frozen=True)
class ColumnMap:
    """``axes`` (3, 3): e, f and c as rows. ``half``: largest x and y, and smallest. ``count``: columns along a side."""

    axes: FloatArray
    half: float
    count: int

    @classmethod
    def around(cls, centre: FloatArray, reach_rad: float, step_rad: float) -> ColumnMap:
        """Return the map of all places within ``reach_rad`` of a unit normal, columns ``step_rad`` apart at most."""
        half = math.tan(0.5 * min(reach_rad, 0.95 * math.pi))
        # a step of the map is widest at its centre: 2 dx
        count = 1 + COARSER * math.ceil(2.0 * half / (COARSER * math.tan(0.5 * step_rad)) - 1e-9)
        c = centre / np.linalg.norm(centre)
        e = perpendicular(c)
        return cls(np.stack([e, np.cross(c, e), c]), half, count)

    @property
    def columns(self) -> int:
        """How many columns there are; those of a row of equal y lie side by side."""
        return self.count**2

    def coarser(self) -> tuple[ColumnMap, np.ndarray]:
        """Return the map of every :data:`COARSER` th column each way, and which columns those are."""
        side = np.arange(0, self.count, COARSER)
        return ColumnMap(self.axes, self.half, len(side)), (side[:, None] * self.count + side).ravel()

    def plane(self, normal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x and y of unit normals (..., 3)."""
        across, along, up = (normal @ axis for axis in self.axes)
        return across / (1.0 + up), along / (1.0 + up)

    def normals(self) -> FloatArray:
        """Return the unit normals of the columns, shape (columns, 3)."""
        side = np.linspace(-self.half, self.half, self.count)
        y, x = (v.ravel() for v in np.meshgrid(side, side, indexing="ij"))
        squared = x**2 + y**2
        place = np.stack([2.0 * x, 2.0 * y, 1.0 - squared], axis=-1) / (1.0 + squared)[:, None]
        return np.asarray(place @ self.axes)

    def corners(self, x: FloatArray, y: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return the four columns around places, and their weights."""
        (i, u), (j, v) = (self._along(value) for value in (x, y))
        start = j * self.count + i
        return [
            (start, (1.0 - u) * (1.0 - v)),
            (start + 1, u * (1.0 - v)),
            (start + self.count, (1.0 - u) * v),
            (start + self.count + 1, u * v),
        ]

    def _along(self, value: FloatArray) -> tuple[np.ndarray, FloatArray]:
        step = np.clip((value + self.half) * ((self.count - 1) / (2.0 * self.half)), 0.0, self.count - 1.0)
        i = np.minimum(step.astype(np.intp), self.count - 2)
        return i, step - i


def latitude_longitude_deg(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return geodetic latitude and longitude of unit normals (..., 3)."""
    latitude = np.degrees(np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1])))
    return latitude, np.degrees(np.arctan2(normal[..., 1], normal[..., 0]))
