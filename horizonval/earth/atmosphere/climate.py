"""Climate by latitude and month: a smooth blend of the AFGL climates.

Each climate stands at its own latitude (Anderson et al. 1986: tropical 15, midlatitude 45, subarctic 60 deg) and at the
middle of July or January. Between two latitudes the weights follow a smoothstep, towards the equator and the pole the
last climate holds; summer and winter share a year as ``(1 +- cos(2 pi (month - 7) / 12)) / 2``, six months later in the
south. In the tropics there is no season.

Temperatures are blended linearly, number densities in their logarithms. Every blend keeps the ideal gas law; it is
hydrostatic to 3 %, as the climates themselves are.

What no blend of six climates has: longitude, weather, the ozone hole, the cold stratosphere of the Antarctic winter,
sudden stratospheric warmings. The cold troposphere over the poles is put in place for thermal bands
(:mod:`horizonval.earth.weather.zonal_climate`).

Which latitudes a satellite's infrared rays pass over, and the climate there.

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

import calendar
import math
from collections.abc import Mapping
from datetime import datetime
from itertools import pairwise

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, profile
from horizonval.spec.scene import SceneSpec

BY_LATITUDE_MONTH = "by_latitude_month"
_ANCHORS = ((15.0, "tropical"), (45.0, "midlatitude"), (60.0, "subarctic"))
_BOLTZMANN = 1.380649e-23


def month_of(epoch: datetime) -> float:
    """Return the month as a number that passes through 7.0 in the middle of July and never jumps but at New Year.

    December's second half goes on from 12 to 12.5, January's first from 0.5 to 1; a year is a circle of 12.
    """
    days = calendar.monthrange(epoch.year, epoch.month)[1]
    day = epoch.day - 1 + (epoch.hour + epoch.minute / 60) / 24
    return epoch.month - 0.5 + day / days


def climate_weights(latitude_deg: float, month: float) -> dict[str, float]:
    """Return the weights of the climates that make up a place and a month; all above 0, sum 1.

    Parameters
    ----------
    latitude_deg : float
        -90 to 90, north positive.
    month : float
        1 to 12, the middle of each; fractions between, see :func:`month_of`.
    """
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


def blended(weights: Mapping[str, float], name: str = BY_LATITUDE_MONTH) -> AtmosphereProfile:
    """Return the blend of climates by their weights, on the climates' own levels."""
    parts = [(profile(climate), weight) for climate, weight in weights.items()]

    def logarithmic(key: str) -> FloatArray:
        return np.exp(sum(weight * np.log(getattr(part, key)) for part, weight in parts))

    temperature = np.asarray(sum(weight * part.temperature_k for part, weight in parts))
    air = logarithmic("number_density_air")
    return AtmosphereProfile(
        name=name,
        altitude_m=parts[0][0].altitude_m,
        pressure_pa=air * _BOLTZMANN * temperature,
        temperature_k=temperature,
        number_density_air=air,
        number_density_o3=logarithmic("number_density_o3"),
        number_density_h2o=logarithmic("number_density_h2o"),
        number_density_co2=logarithmic("number_density_co2"),
        number_density_n2o=logarithmic("number_density_n2o"),
        number_density_ch4=logarithmic("number_density_ch4"),
        number_density_hno3=logarithmic("number_density_hno3"),
    )


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


def month_of_rows(scene: SceneSpec) -> float:
    """Return the month of a scene's climate: what the atmosphere asks for, or that of the epoch."""
    fixed = scene.atmosphere.month
    return month_of(scene.platform.epoch_utc) if fixed is None else float(fixed)


def varies(scene: SceneSpec) -> bool:
    """Return whether a scene's air changes with latitude."""
    a = scene.atmosphere
    by_place = a.profile == BY_LATITUDE_MONTH and a.latitude_deg is None
    return by_place and a.profile_file is None and a.file is None


def row_weights(sin_latitude: FloatArray, month_of_rows: float) -> tuple[dict[str, float], ...]:
    """Return the climates of rows and their shares, see :func:`horizonval.earth.atmosphere.climate.climate_weights`."""
    return tuple(climate_weights(float(row), month_of_rows) for row in np.degrees(np.arcsin(sin_latitude)))
