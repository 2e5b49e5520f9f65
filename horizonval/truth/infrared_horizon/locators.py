"""Where a limb profile drops: what horizon sensors in thermal bands look for.

``L(h)`` is the radiance of the clear limb against the lowest geodetic height of the ray. The plateau is the largest
``L`` between 10 and 24 km if the air itself is the horizon there (``opaque``: at least 0.6 of the ray 10 km below the
hard horizon, as in the 15 um band of CO2), else that ray's radiance (``window``: the ground is the horizon, blurred by
water vapour). Half of the plateau, and the steepest fall, are the heights that the locators of sensors come near to.

The steepest fall is a broad maximum, with edges of its own where the lapse rate of a profile changes: it depends on
what counts as structure (here 0.5 km) by some 0.3 km, and where two places are nearly as steep it may be either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from horizonval.core.arrays import FloatArray

PLATEAU_M = (10e3, 24e3)
GROUND_RAY_M = -10e3
"""Height of the ray that stands for the Earth's disc: 10 km of chord depth, half a degree or less below the horizon."""
OPAQUE_SHARE = 0.6

_STEP_M = 25.0


def profile_heights_m(top_m: float) -> FloatArray:
    """Return the heights [m] a profile needs: 0.5 km apart where a band drops, wider elsewhere, up to 90 km."""
    heights = np.concatenate(
        [
            np.arange(0.0, 8e3, 500.0),
            np.arange(8e3, 28e3, 1e3),
            np.arange(28e3, 50e3, 500.0),
            np.arange(50e3, 60e3, 1e3),
            np.arange(60e3, 91e3, 3e3),
        ]
    )
    return heights[heights < top_m - 500.0]


@dataclass(frozen=True)
class HorizonHeights:
    """The horizon in limb profiles of several azimuths; arrays of shape (azimuths,)."""

    kind: str
    plateau: FloatArray
    half_plateau_m: FloatArray
    maximum_gradient_m: FloatArray


def locate(height_m: FloatArray, radiance: FloatArray, ground_radiance: FloatArray) -> HorizonHeights:
    """Return where the profiles of one band drop.

    Parameters
    ----------
    height_m : ndarray, shape (n,)
        Rising from 0. Between them a cubic spline: structure finer than the steps does not count.
    radiance : ndarray, shape (azimuths, n)
    ground_radiance : ndarray, shape (azimuths,)
        Of the rays of :data:`GROUND_RAY_M`.

    Returns
    -------
    Located
        ``kind`` is one for the band, by the means over the azimuths. ``half_plateau_m`` is the highest place with half
        of the plateau; 0 where the whole limb is darker (the drop is then at the hard horizon itself).
        ``maximum_gradient_m`` is where -dL/dh is largest above 0.
    """
    fine = np.arange(height_m[0], height_m[-1] + 0.5 * _STEP_M, _STEP_M)
    fine[-1] = min(fine[-1], height_m[-1])
    spline = CubicSpline(height_m, radiance, axis=1)
    level, slope = spline(fine), -spline(fine, 1)
    within = (fine >= PLATEAU_M[0]) & (fine <= PLATEAU_M[1])
    air = level[:, within].max(axis=1)
    opaque = bool(air.mean() >= OPAQUE_SHARE * ground_radiance.mean())
    plateau = air if opaque else ground_radiance
    return HorizonHeights(
        kind="opaque" if opaque else "window",
        plateau=plateau,
        half_plateau_m=np.array([_highest(fine, row, 0.5 * p) for row, p in zip(level, plateau, strict=True)]),
        maximum_gradient_m=np.array([_peak(fine, row) for row in slope]),
    )


def _highest(height_m: FloatArray, level: FloatArray, wanted: float) -> float:
    """Return the highest place where a profile comes down to a level; 0 if it is nowhere above."""
    above = np.flatnonzero(level >= wanted)
    if not above.size:
        return 0.0
    i = int(above[-1])
    if i == len(level) - 1:
        return float(height_m[i])
    share = (level[i] - wanted) / (level[i] - level[i + 1])
    return float(height_m[i] + share * (height_m[i + 1] - height_m[i]))


def _peak(height_m: FloatArray, values: FloatArray) -> float:
    """Return the place of the largest of equally spaced values, by the parabola through its neighbours."""
    i = int(np.argmax(values))
    if i in (0, len(values) - 1):
        return float(height_m[i])
    bend = values[i - 1] - 2.0 * values[i] + values[i + 1]
    shift = 0.5 * (values[i - 1] - values[i + 1]) / bend if bend < 0.0 else 0.0
    return float(height_m[i] + np.clip(shift, -0.5, 0.5) * _STEP_M)
