"""What the ground of a scene emits: from its specification to
:class:`horizonval.earth.surface.ground_emission.GroundEmission`.

A ``uniform`` ground is as warm as ``surface.temperature_k`` says, or else as the lowest air: one temperature, or with
``by_latitude_month`` and ``weather`` that of the AFGL climates at every latitude. An ``earth`` has the climate of
:mod:`horizonval.earth.surface.surface_temperature` for the month of the air (or of the epoch), whatever the profile of
the air above it, unless ``surface.temperature_k`` puts one temperature in place of everything.

Clouds are as warm as the air at their tops; how much of it they emit is ``clouds.emissivity``.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate_rows, columns
from horizonval.earth.gases import afgl
from horizonval.earth.surface import ground_map, surface_temperature
from horizonval.earth.surface.ground_emission import GroundEmission, uniform_ground
from horizonval.spec.scene import SceneSpec


def emitting_ground(scene: SceneSpec, lowest_air_k: float) -> GroundEmission:
    """Return what the ground of a scene emits.

    Parameters
    ----------
    scene : SceneSpec
    lowest_air_k : float
        Temperature of the lowest level of the air where it is the same everywhere.
    """
    surface = scene.surface
    cloud = 1.0 if scene.clouds is None else scene.clouds.emissivity
    fixed = surface.temperature_k
    rows = climate_rows.all_rows()
    month = climate_rows.month(scene)
    if surface.kind == "earth" and fixed is None:
        return _climate(rows, month, cloud)
    by_latitude = climate_rows.varies(scene) or columns.weather_of(scene) is not None
    if surface.kind == "uniform" and fixed is None and by_latitude:
        air = afgl.blended(climate_rows.weights(rows, month), np.zeros(1)).temperature_k[:, 0]
        return uniform_ground(air, surface.emissivity, cloud)
    return uniform_ground(lowest_air_k if fixed is None else fixed, surface.emissivity, cloud, surface.kind, month)


def _climate(rows: FloatArray, month: float, cloud_emissivity: float) -> GroundEmission:
    """Return the ground of a month. What is published is the mean of the land as high as it lies."""
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
