"""Which latitudes a satellite's infrared rays pass over, and the climate there.

Seen from a height a the ground reaches ``acos(R / (R + a))`` from the point below; a ray that grazes it goes on through
the air for another ``acos(R / (R + 100 km)) = 10.1 deg``. Rows of climate stand on one grid of sin(latitude) that is
the same for all scenes, so that frames taken one after the other see the same air. Between two rows extinction and
source are linear in sin(latitude). Half way between two rows, where that is worst, the temperature is within 0.05 K of
the blend of that latitude, and the radiance within 0.05 % of its own in 14.0 to 16.3 um, 0.15 % in the windows; along a
ray that crosses many rows within 0.06 % of air that varies smoothly, windows included, but for 0.12 % of these across
the edge of the polar air, from 55 to 68 deg.

Latitudes are geodetic; taking geocentric ones for them (0.19 deg at most) shifts the climate by a third of a row.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate
from horizonval.spec.scene import SceneSpec

STEPS = 100
"""From the equator to the pole: 0.01 of the sine, 0.6 deg at the equator."""
_RADIUS_M, _TOP_M = 6.371e6, 1e5
_MARGIN = math.radians(1.0)


def all_rows() -> FloatArray:
    """Return the sines of the latitudes of all rows, from pole to pole."""
    return np.arange(-STEPS, STEPS + 1) / STEPS


def rows_in_sight(latitude_deg: float, height_m: float) -> FloatArray:
    """Return the sines of the latitudes that rays from a place above the Earth can meet air or ground at, and beyond.

    Parameters
    ----------
    latitude_deg : float
        Of the satellite, -90 to 90.
    height_m : float
        Above 0.

    Returns
    -------
    ndarray, shape (m,)
        Part of :func:`all_rows`, at least two.
    """
    reach = reach_rad(height_m)
    latitude = math.radians(latitude_deg)
    south, north = max(latitude - reach, -math.pi / 2), min(latitude + reach, math.pi / 2)
    # The far side of a pole has no latitudes that the near side lacks.
    first, last = math.floor(math.sin(south) * STEPS), math.ceil(math.sin(north) * STEPS)
    return np.arange(max(first, -STEPS), min(last, STEPS) + 1) / STEPS


def reach_rad(height_m: float) -> float:
    """Return how far from the point below rays from a height can meet air or ground, as an angle at the centre."""
    return math.acos(_RADIUS_M / (_RADIUS_M + height_m)) + math.acos(_RADIUS_M / (_RADIUS_M + _TOP_M)) + _MARGIN


def month(scene: SceneSpec) -> float:
    """Return the month of a scene's climate: what the atmosphere asks for, or that of the epoch."""
    fixed = scene.atmosphere.month
    return climate.month_of(scene.platform.epoch_utc) if fixed is None else float(fixed)


def varies(scene: SceneSpec) -> bool:
    """Return whether a scene's air changes with latitude."""
    a = scene.atmosphere
    by_place = a.profile == climate.BY_LATITUDE_MONTH and a.latitude_deg is None
    return by_place and a.profile_file is None and a.file is None


def weights(sin_latitude: FloatArray, month: float) -> tuple[dict[str, float], ...]:
    """Return the climates of rows and their shares, see :func:`horizonval.earth.atmosphere.climate.climate_weights`."""
    return tuple(climate.climate_weights(float(row), month) for row in np.degrees(np.arcsin(sin_latitude)))
