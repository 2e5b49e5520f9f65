"""Climate by latitude and month: a smooth blend of the AFGL climates, and the rows of latitude that a camera sees.

Each climate applies at one latitude (Anderson et al. 1986: tropical 15, midlatitude 45, subarctic 60 deg) in the middle
of July or January. Between two latitudes the weights follow a smoothstep; equatorward and poleward the last climate
holds. Summer and winter share a year as ``(1 +- cos(2 pi (month - 7) / 12)) / 2``, six months later in the south. The
tropics have no season.

Temperatures are blended linearly, number densities in their logarithms. Every blend obeys the ideal gas law and is
hydrostatic to 3 %, like the climates themselves. A blend of six climates has no longitude, no weather, no ozone hole,
no cold Antarctic stratosphere in winter and no stratospheric warmings. Thermal bands replace the troposphere over the
poles (:mod:`horizonval.earth.weather.zonal_climate`).

**Rows of latitude.** From an altitude a the ground reaches ``acos(R / (R + a))`` from the nadir; a ray that grazes it
crosses the air for another ``acos(R / (R + 100 km)) = 10.1 deg``. Rows lie on one grid of sin(latitude) for all scenes,
so that successive frames see the same air. Extinction and source are linear in sin(latitude) between rows. That leaves
at most 0.05 K of temperature, 0.05 % of the radiance in 14.0 to 16.3 um and 0.15 % in the windows. Latitudes are
geodetic; treating geocentric ones as such shifts the climate by a third of a row at most.
"""

from __future__ import annotations

import calendar
import math
from collections.abc import Mapping
from datetime import datetime
from itertools import pairwise

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.profiles import GASES, AtmosphereProfile, profile
from horizonval.spec.scene import SceneSpec

BY_LATITUDE_MONTH = "by_latitude_month"
_ANCHORS = ((15.0, "tropical"), (45.0, "midlatitude"), (60.0, "subarctic"))
_BOLTZMANN = 1.380649e-23


def month_of(epoch: datetime) -> float:
    """Return the month as a real number from 0.5 to 12.5, 7.0 in the middle of July.

    It jumps at New Year only; a year is a circle of 12.
    """
    days = calendar.monthrange(epoch.year, epoch.month)[1]
    day = epoch.day - 1 + (epoch.hour + epoch.minute / 60) / 24
    return epoch.month - 0.5 + day / days


def climate_weights(latitude_deg: float, month: float) -> dict[str, float]:
    """Return the positive weights, of sum 1, of the climates at a latitude (-90 to 90, north positive) and a month."""
    zones = _zone_weights(abs(latitude_deg))
    northern = month if latitude_deg >= 0 else month + 6
    summer = (1 + math.cos(2 * math.pi * (northern - 7) / 12)) / 2
    weights: dict[str, float] = {}
    for zone, share in zones.items():
        if zone == "tropical":
            weights[zone] = share
        else:
            weights[f"{zone}_summer"], weights[f"{zone}_winter"] = share * summer, share * (1 - summer)
    return {name: weight for name, weight in weights.items() if weight > 0}


def _zone_weights(latitude: float) -> dict[str, float]:
    if latitude <= _ANCHORS[0][0]:
        return {_ANCHORS[0][1]: 1.0}
    for (low, below), (high, above) in pairwise(_ANCHORS):
        if latitude < high:
            x = (latitude - low) / (high - low)
            share = x * x * (3 - 2 * x)
            return {below: 1 - share, above: share}
    return {_ANCHORS[-1][1]: 1.0}


def blended(weights: Mapping[str, float]) -> AtmosphereProfile:
    """Return the blend of climates by their weights, on the climates' levels."""
    parts = [(profile(climate), weight) for climate, weight in weights.items()]

    def logarithmic(key: str) -> FloatArray:
        return np.exp(sum(weight * np.log(getattr(part, key)) for part, weight in parts))

    temperature = np.asarray(sum(weight * part.temperature_k for part, weight in parts))
    air = logarithmic("number_density_air")
    return AtmosphereProfile.of(
        name=BY_LATITUDE_MONTH,
        altitude_m=parts[0][0].altitude_m,
        pressure_pa=air * _BOLTZMANN * temperature,
        temperature_k=temperature,
        number_density_air=air,
        gases={gas: logarithmic(f"number_density_{gas}") for gas in GASES},
    )


STEPS = 100
"""Rows from the equator to the pole: 0.01 of the sine, 0.6 deg at the equator."""
_RADIUS_M, _TOP_M = 6.371e6, 1e5
_MARGIN = math.radians(1.0)


def all_rows() -> FloatArray:
    """Return the sines of the latitudes of all rows, from pole to pole."""
    return np.arange(-STEPS, STEPS + 1) / STEPS


def rows_in_sight(latitude_deg: float, height_m: float) -> FloatArray:
    """Return the sines of the latitudes where rays from a point ``height_m`` above the Earth can meet air or ground.

    They are part of :func:`all_rows`, at least two.
    """
    reach = reach_rad(height_m)
    latitude = math.radians(latitude_deg)
    south, north = max(latitude - reach, -math.pi / 2), min(latitude + reach, math.pi / 2)
    # The far side of a pole has no latitudes that the near side lacks.
    first, last = math.floor(math.sin(south) * STEPS), math.ceil(math.sin(north) * STEPS)
    return np.arange(max(first, -STEPS), min(last, STEPS) + 1) / STEPS


def reach_rad(height_m: float) -> float:
    """Return the angle at the Earth's centre from the nadir to the farthest air that rays from a height can meet."""
    return math.acos(_RADIUS_M / (_RADIUS_M + height_m)) + math.acos(_RADIUS_M / (_RADIUS_M + _TOP_M)) + _MARGIN


def month_of_rows(scene: SceneSpec) -> float:
    """Return the month of a scene's climate: ``atmosphere.month``, or that of the epoch."""
    fixed = scene.atmosphere.month
    return month_of(scene.platform.epoch_utc) if fixed is None else float(fixed)


def varies(scene: SceneSpec) -> bool:
    """Return whether a scene's air changes with latitude."""
    a = scene.atmosphere
    by_place = a.profile == BY_LATITUDE_MONTH and a.latitude_deg is None
    return by_place and a.profile_file is None and a.file is None


def row_weights(sin_latitude: FloatArray, month_of_rows: float) -> tuple[dict[str, float], ...]:
    """Return the weights of the climates in each row, see :func:`climate_weights`."""
    return tuple(climate_weights(float(row), month_of_rows) for row in np.degrees(np.arcsin(sin_latitude)))
