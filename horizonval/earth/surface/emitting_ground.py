"""What the ground of a scene emits: from its specification to
:class:`horizonval.earth.surface.ground_emission.GroundEmission`.

A ``uniform`` ground is as warm as ``surface.temperature_k`` says, or else as the lowest air: one temperature, that of
every latitude with ``by_latitude_month``, that of the AFGL climates there with ``weather``, and with profiles of many
places that of their lowest air, its mean around each circle of latitude. An ``earth`` has the climate of
:mod:`horizonval.earth.surface.surface_temperature` for the month of the air (or of the epoch), whatever the profile of
the air above it, unless ``surface.temperature_k`` puts one temperature in place of everything.

Clouds are as warm as the air at their tops; how much of it they emit is ``clouds.emissivity``.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate_rows, columns
from horizonval.earth.atmosphere.air import Columns
from horizonval.earth.gases import afgl
from horizonval.earth.surface import ground_map, surface_temperature
from horizonval.earth.surface.ground_emission import GroundEmission, uniform_ground
from horizonval.earth.weather.cold_poles import with_cold_poles
from horizonval.spec.scene import SceneSpec

_AROUND_DEG = 15.0


def emitting_ground(scene: SceneSpec, lowest_air_k: float | FloatArray) -> GroundEmission:
    """Return what the ground of a scene emits.

    Parameters
    ----------
    scene : SceneSpec
    lowest_air_k : float or ndarray, shape (m,)
        Temperature of the lowest level of the air: one for everywhere, or at :func:`climate_rows.all_rows`.
    """
    surface = scene.surface
    cloud = 1.0 if scene.clouds is None else scene.clouds.emissivity
    fixed = surface.temperature_k
    rows = climate_rows.all_rows()
    month = climate_rows.month(scene)
    if surface.kind == "earth" and fixed is None:
        return climate_ground(month, cloud)
    by_latitude = climate_rows.varies(scene) or columns.weather_of(scene) is not None
    if surface.kind != "earth" and fixed is None and by_latitude:
        air = afgl.blended(climate_rows.weights(rows, month), np.zeros(1))
        if climate_rows.varies(scene):
            air = with_cold_poles(air, np.degrees(np.arcsin(rows)), month)
        return uniform_ground(air.temperature_k[:, 0], surface.emissivity, cloud)
    kind = "earth" if surface.kind == "earth" else "uniform"
    return uniform_ground(lowest_air_k if fixed is None else fixed, surface.emissivity, cloud, kind, month)


def lowest_air_k(columns: Columns) -> FloatArray:
    """Return the temperature of the lowest air at :func:`climate_rows.all_rows`, its mean around each."""
    rows = np.degrees(np.arcsin(climate_rows.all_rows()))
    around = np.arange(0.0, 360.0, _AROUND_DEG)
    latitude, longitude = (v.ravel() for v in np.meshgrid(rows, around, indexing="ij"))
    kelvin = columns(latitude, longitude, np.zeros(1)).temperature_k
    return np.asarray(kelvin.reshape(len(rows), len(around)).mean(axis=1))


def climate_ground(month: float, cloud_emissivity: float = 1.0) -> GroundEmission:
    """Return the ground of an "earth" in a month. What is published is the mean of the land as high as it lies."""
    rows = climate_rows.all_rows()
    latitude = np.degrees(np.arcsin(rows))
    sea_level = surface_temperature.LAND_LAPSE_K_M * ground_map.mean_height_m(latitude)
    swing = surface_temperature.land_daily_swing_k(latitude)
    sheet, lapse = surface_temperature.ice_sheet(latitude, month)
    return GroundEmission(
        kind="earth",
        month=month,
        sin_latitude=_plain(rows),
        land_k=_plain(surface_temperature.land_k(latitude, month) + sea_level),
        snow_k=_plain(surface_temperature.snow_k(latitude, month) + sea_level),
        ice_sheet_k=_plain(sheet),
        sea_ice_k=_plain(surface_temperature.sea_ice_k(latitude, month)),
        water_k=_plain(surface_temperature.sea_k(latitude, month)),
        desert_warmer_k=_plain(surface_temperature.desert_warmer_k(latitude)),
        diurnal_k=_plain(swing),
        desert_diurnal_k=_plain(swing * surface_temperature.DESERT_SWING),
        land_lapse_k_m=surface_temperature.LAND_LAPSE_K_M,
        ice_lapse_k_m=_plain(lapse),
        emissivity=1.0,
        cloud_emissivity=cloud_emissivity,
    )


def _plain(values: np.ndarray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
