r"""Refraction for the truth of infrared horizons: heights in which bent rays are straight.

A ray in layered air keeps ``n (R + z) sin(theta)`` (Bouguer). With the height ``y = z + N(z) (R + z)``, N = n - 1,
it is a straight line past a planet that is ``N(0) R`` larger, and its path is dz/dy of the straight one's:

.. math:: ds = \frac{dz}{dy}\,dt

so that extinction over y, times dz/dy, gives the bent ray's optical depth. A line's lowest y is its distance from the
geometric planet as seen from outside the air: what a horizon sensor takes for the height.

Neglected: the turn of the verticals along the ray (1.1 deg at most, for a ray that grazes the ground; 3 arcsec at
40 km), by which a ray sees air a little further on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel


@dataclass(frozen=True)
class StraightHeights:
    """Heights over the larger planet of the module text, and how they stretch.

    ``rise_m``: by how much it is larger; ``top_m``: of the air; ``altitude_m``, ``height_m``: true heights and those
    over the larger planet; ``stretch``: dz/dy.
    """

    rise_m: float
    top_m: float
    altitude_m: FloatArray
    height_m: FloatArray
    stretch: FloatArray

    def of(self, altitude_m: FloatArray) -> FloatArray:
        """Return heights over the larger planet."""
        return np.interp(altitude_m, self.altitude_m, self.height_m)


def straight_heights(model: OpticalModel, mean_radius_m: float) -> StraightHeights:
    """Return the heights of a model's air; those of straight rays where its light is not bent."""
    z = model.altitude_m
    if model.refractivity is None:
        return StraightHeights(0.0, model.top_m, z, z, np.ones_like(z))
    excess = model.refractivity - model.refractivity[-1]
    y = z + excess * (mean_radius_m + z)
    rise = float(y[0])
    return StraightHeights(rise, float(y[-1]) - rise, z, y - rise, 1.0 / np.gradient(y, z))
