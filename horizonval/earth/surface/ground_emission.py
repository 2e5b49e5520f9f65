"""Temperature and emissivity of ground and clouds, from a scene's specification to plain data that JSON preserves
exactly.

The temperature of land follows the Sun through the day: ``T = land_k + diurnal_k cos(H - lag)`` with H the hour angle
of the Sun at the place (0 at noon, positive in the afternoon) and ``lag`` :data:`LAG_RAD`. Deserts have a larger
amplitude; sea, snow and ice have none. A true skin rises faster after sunrise than it falls by night; the cosine has
the right amplitude and phase only. Higher ground is colder, by separate lapse rates of land and of ice sheets. The
ground itself lies on the ellipsoid; over ice sheets air that varies begins at their height
(:mod:`horizonval.earth.atmosphere.emission`).

A ``uniform`` ground has the temperature ``surface.temperature_k``, or that of the lowest air: one temperature, that of
every latitude with ``by_latitude_month``, that of the AFGL climates there with ``weather``, or its mean around each
circle of latitude with profiles of many places. An ``earth`` has the climate of
:mod:`horizonval.earth.surface.surface_temperature` for the month of the air (or of the epoch), whatever the profile of
the air, unless ``surface.temperature_k`` replaces every temperature.

Clouds are as warm as the air at their tops and have the emissivity ``clouds.emissivity``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate
from horizonval.earth.atmosphere.air import Columns, weather_of
from horizonval.earth.gases import afgl
from horizonval.earth.surface import emissivity, ground_map, surface_temperature
from horizonval.earth.surface.ground_map import ground_cover, height_m
from horizonval.earth.weather.zonal_climate import with_cold_poles
from horizonval.spec.scene import SceneSpec

LAG_RAD = math.radians(22.5)
"""The ground is warmest an hour and a half after noon."""
KINDS = ("land", "desert", "snow", "water")
"""Kinds of ground with different emissivity. Foam counts as water, sand as desert, ice sheets and white sea ice as
snow, everything else as land."""
ICE_POINT_K = 273.15


@dataclass(frozen=True)
class GroundEmission:
    """Temperature and emissivity of everything that a ray can end on.

    Attributes
    ----------
    kind, month : "uniform" or "earth"; float
        Month from 0.5 to 12.5, 7.0 the middle of July: for snow and sea ice of an "earth".
    sin_latitude : tuple of float, length k
        Rising in equal steps from -1 to 1, of geodetic latitude. All temperatures below are linear between.
    land_k, snow_k, ice_sheet_k, sea_ice_k, water_k : tuple of float, length k
        Daily mean temperature at sea level of land, of land under snow, of an ice sheet, of white sea ice, of the sea.
        Equal for a uniform ground. Snow and ice are never above 273.15 K, unless one temperature replaces all.
    desert_warmer_k : tuple of float, length k
        Difference of a desert from land.
    diurnal_k, desert_diurnal_k : tuple of float, length k
        Amplitude of the daily variation of land and desert.
    land_lapse_k_m, ice_lapse_k_m : float; tuple of float, length k
        Lapse rates of land and of an ice sheet [K/m].
    emissivity, cloud_emissivity : float
        Of a uniform ground; that of an "earth" is :func:`horizonval.earth.surface.emissivity.emissivity`. Cloud tops
        transmit the rest from below.
    """

    kind: str
    month: float
    sin_latitude: tuple[float, ...]
    land_k: tuple[float, ...]
    snow_k: tuple[float, ...]
    ice_sheet_k: tuple[float, ...]
    sea_ice_k: tuple[float, ...]
    water_k: tuple[float, ...]
    desert_warmer_k: tuple[float, ...]
    diurnal_k: tuple[float, ...]
    desert_diurnal_k: tuple[float, ...]
    land_lapse_k_m: float
    ice_lapse_k_m: tuple[float, ...]
    emissivity: float
    cloud_emissivity: float


@dataclass(frozen=True)
class EmittingPlaces:
    """Emitting ground at places; arrays of one shape.

    ``sin_latitude``: of the geodetic latitude; ``hour_angle``: of the Sun [rad], 0 at noon, positive in the afternoon;
    ``shares``: of the kinds of :data:`KINDS` that are present; ``height_m``: of the land; ``ice_sheet``: share of ice
    sheet in white land.
    """

    sin_latitude: FloatArray
    hour_angle: FloatArray
    shares: dict[str, FloatArray]
    land: NDArray[np.bool_]
    height_m: FloatArray
    ice_sheet: FloatArray


def uniform_ground(
    temperature_k: ArrayLike,
    emissivity: float,
    cloud_emissivity: float = 1.0,
    kind: str = "uniform",
    month: float = 7.0,
) -> GroundEmission:
    """Return a ground whose temperature is the same for all kinds of ground, at all heights and hours.

    ``temperature_k``: one for all latitudes, or by latitude, in equal steps of its sine from -1 to 1.
    """
    values = np.atleast_1d(np.asarray(temperature_k, dtype=np.float64))
    values = np.repeat(values, 2) if len(values) == 1 else values
    same, still = tuple(values.tolist()), (0.0,) * len(values)
    rows = tuple(np.linspace(-1.0, 1.0, len(values)).tolist())
    return GroundEmission(
        kind, month, rows, *(same,) * 5, still, still, still, 0.0, still, emissivity, cloud_emissivity
    )


def emitting_places(
    ground: GroundEmission, latitude_rad: FloatArray, longitude_rad: FloatArray, sun_longitude_rad: float
) -> EmittingPlaces:
    """Return the emitting ground at geodetic places, shape (n,), with the Sun over a longitude."""
    sine, hour = np.sin(latitude_rad), longitude_rad - sun_longitude_rad
    zero = np.zeros_like(sine)
    if ground.kind == "uniform":
        return EmittingPlaces(sine, hour, {"land": zero + 1.0}, zero == 0.0, zero, zero)
    latitude, longitude = np.degrees(latitude_rad), np.degrees(longitude_rad)
    cover = ground_cover(latitude, longitude, ground.month)
    sand, water = cover.shares["sand"], cover.shares["water"]
    white = cover.shares["snow"] + cover.shares["firn"]
    shares = {"land": np.where(cover.land, 1.0 - sand - white, 0.0), "desert": sand, "snow": white, "water": water}
    height = np.where(cover.land, height_m(latitude, longitude), 0.0)
    sheet = cover.shares["firn"] / np.maximum(white, 1e-9)
    return EmittingPlaces(sine, hour, shares, cover.land, height, sheet)


def ground_k(ground: GroundEmission, kind: str, at: EmittingPlaces) -> FloatArray:
    """Return the temperature of a kind of ground (see :data:`KINDS`) at places [K]."""

    def row(values: tuple[float, ...]) -> FloatArray:
        return np.interp(at.sin_latitude, ground.sin_latitude, values)

    if kind == "water":
        return row(ground.water_k)
    if kind == "snow":
        snow = row(ground.snow_k) - ground.land_lapse_k_m * at.height_m
        sheet = row(ground.ice_sheet_k) - row(ground.ice_lapse_k_m) * at.height_m
        white = np.where(at.land, snow + at.ice_sheet * (sheet - snow), row(ground.sea_ice_k))
        return white if ground.land_lapse_k_m == 0.0 else np.minimum(white, ICE_POINT_K)
    cosine = np.cos(at.hour_angle - LAG_RAD)
    land = row(ground.land_k) - ground.land_lapse_k_m * at.height_m
    if kind == "desert":
        return np.asarray(land + row(ground.desert_warmer_k) + row(ground.desert_diurnal_k) * cosine)
    return np.asarray(land + row(ground.diurnal_k) * cosine)


def ground_emissivity(
    ground: GroundEmission, kind: str, wavelength_um: ArrayLike, cosine: ArrayLike = 1.0
) -> FloatArray:
    """Return the emissivity of a kind of ground; the cosine of the view's zenith angle matters to water only."""
    wavelength, c = np.broadcast_arrays(np.asarray(wavelength_um, dtype=np.float64), np.asarray(cosine))
    if ground.kind == "uniform":
        return np.full(wavelength.shape, ground.emissivity)
    if kind == "water":
        return emissivity.water_emissivity(wavelength, c)
    return emissivity.emissivity(kind, wavelength)


_AROUND_DEG = 15.0


def emitting_ground(scene: SceneSpec, lowest_air_k: float | FloatArray) -> GroundEmission:
    """Return the emission of a scene's ground.

    ``lowest_air_k``: temperature of the lowest level of the air, one value or at :func:`climate.all_rows`.
    """
    surface = scene.surface
    cloud = 1.0 if scene.clouds is None else scene.clouds.emissivity
    fixed = surface.temperature_k
    rows = climate.all_rows()
    month = climate.month_of_rows(scene)
    if surface.kind == "earth" and fixed is None:
        return climate_ground(month, cloud)
    by_latitude = climate.varies(scene) or weather_of(scene) is not None
    if surface.kind != "earth" and fixed is None and by_latitude:
        air = afgl.blended(climate.row_weights(rows, month), np.zeros(1))
        if climate.varies(scene):
            air = with_cold_poles(air, np.degrees(np.arcsin(rows)), month)
        return uniform_ground(air.temperature_k[:, 0], surface.emissivity, cloud)
    kind = "earth" if surface.kind == "earth" else "uniform"
    return uniform_ground(lowest_air_k if fixed is None else fixed, surface.emissivity, cloud, kind, month)


def lowest_air_k(columns: Columns) -> FloatArray:
    """Return the zonal mean temperature of the lowest air at :func:`climate.all_rows`."""
    rows = np.degrees(np.arcsin(climate.all_rows()))
    around = np.arange(0.0, 360.0, _AROUND_DEG)
    latitude, longitude = (v.ravel() for v in np.meshgrid(rows, around, indexing="ij"))
    kelvin = columns(latitude, longitude, np.zeros(1)).temperature_k
    return np.asarray(kelvin.reshape(len(rows), len(around)).mean(axis=1))


def climate_ground(month: float, cloud_emissivity: float = 1.0) -> GroundEmission:
    """Return the ground of an "earth" in a month. Published temperatures are means of the land at its height."""
    rows = climate.all_rows()
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
