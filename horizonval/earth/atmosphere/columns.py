"""Columns of a scene's air at any places, where that varies over latitude and longitude.

- ``by_latitude_month``: the blend of the AFGL climates of the latitude and month;
- ``weather``: the zonal climate of :mod:`horizonval.earth.weather.zonal_climate` and the weather that is drawn over it
  (:mod:`horizonval.earth.weather.field`). Pressure follows from hydrostatic balance with the temperature drawn, up from
  the pressure at sea level. Ozone and water vapour are the AFGL blend's at equal **pressure**, times what is drawn;
  below 25 km there is no more water vapour than saturates the air. N2O, CH4, HNO3 and CO2 are the blend's.

Deviations are drawn to 65 km and fade above; temperatures stay within 130 to 340 K, which one in some 10 000 levels of
a polar winter would leave.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from datetime import UTC, datetime
from functools import lru_cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate, climate_rows
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, us76
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.weather import hydrostatic, real_states, zonal_climate
from horizonval.earth.weather.field import WeatherField
from horizonval.earth.weather.humidity import saturated_share
from horizonval.earth.weather.modes import SCALE_M
from horizonval.spec.scene import SceneSpec

WEATHER = "weather"
SATURATED_TO_M = 25_000.0
COLDEST_K, WARMEST_K = 130.0, 340.0
_BOLTZMANN = 1.380649e-23
_MODEL_TOP_M = 86_000.0


def weather_of(scene: SceneSpec) -> WeatherField | None:
    """Return the weather of a scene, None where its air has none."""
    a = scene.atmosphere
    if a.profile != WEATHER or a.profile_file is not None or a.file is not None:
        return None
    seed = a.seed
    if seed is None:
        identity = json.dumps(["weather", scene.scene.draw or scene.scene.name, scene.scene.seed])
        seed = int.from_bytes(hashlib.sha256(identity.encode()).digest()[:4], "little")
    return WeatherField(seed, climate_rows.month(scene), a.warming_k)


def log_pressure_height_m(altitude_m: FloatArray) -> FloatArray:
    """Return ``7 km ln(p_0 / p)`` of US76 at heights; above 86 km it goes on as below."""
    z = np.asarray(altitude_m, dtype=np.float64)
    low = np.minimum(z, _MODEL_TOP_M)
    fall = np.log(us76(np.array([0.0])).pressure_pa / us76(low).pressure_pa)
    step = np.log(us76(np.array([_MODEL_TOP_M - 1e3])).pressure_pa / us76(np.array([_MODEL_TOP_M])).pressure_pa) / 1e3
    return np.asarray(SCALE_M * (fall + step * (z - low)))


def weather_columns(
    field: WeatherField,
    latitude_deg: FloatArray,
    longitude_deg: FloatArray,
    altitude_m: FloatArray,
    co2_ppm: float = afgl.CO2_PPM,
    *,
    calm: bool = False,
) -> GasState:
    """Return columns of weather, arrays of shape (c, k).

    Parameters
    ----------
    field : WeatherField
    latitude_deg, longitude_deg : ndarray, shape (c,)
        Geodetic.
    altitude_m : ndarray, shape (k,)
        Geodetic, rising from 0 to at most 100 km.
    co2_ppm : float
        Of the lower atmosphere.
    calm : bool
        The climate alone.

    Notes
    -----
    The last few are remembered: frames of one place share theirs.
    """
    latitude, longitude, z = (np.asarray(v, dtype=np.float64) for v in (latitude_deg, longitude_deg, altitude_m))
    places = tuple(tuple(v.tolist()) for v in (latitude, longitude, z))
    state = _weather(field, places, co2_ppm, calm)
    return replace(state, vmr=dict(state.vmr))


@lru_cache(maxsize=8)
def _weather(field: WeatherField, places: tuple[tuple[float, ...], ...], co2_ppm: float, calm: bool) -> GasState:
    """Return :func:`weather_columns` for latitudes, longitudes and heights; nobody may write to it."""
    latitude, longitude, z = (np.array(v) for v in places)
    weights = [climate.climate_weights(float(row), field.month) for row in latitude]
    blend = afgl.blended(weights, z, co2_ppm)
    kelvin = zonal_climate.temperature_k(latitude, field.month, z, blend.temperature_k)
    ground_pa = zonal_climate.sea_level_pa(latitude)
    more_ozone: FloatArray | float = 0.0
    more_water: FloatArray | float = 0.0
    if not calm:
        drawn = field.at(latitude, longitude, log_pressure_height_m(z))
        kelvin = np.clip(kelvin + drawn.temperature_k, COLDEST_K, WARMEST_K)
        ground_pa = ground_pa + drawn.sea_level_pa
        more_ozone, more_water = drawn.ln_ozone, drawn.ln_water
    pressure = hydrostatic.pressure_pa(latitude, z, kelvin, blend.vmr["h2o"], ground_pa)
    at, own = -np.log(pressure), -np.log(blend.pressure_pa)
    gases = {
        gas: np.exp(np.stack([np.interp(x, xp, row) for x, xp, row in zip(at, own, np.log(values), strict=True)]))
        for gas, values in blend.vmr.items()
    }
    gases["o3"] = gases["o3"] * np.exp(more_ozone)
    water = gases["h2o"] * np.exp(more_water)
    gases["h2o"] = np.where(z <= SATURATED_TO_M, np.minimum(water, saturated_share(pressure, kelvin)), water)
    # once more, with the vapour that is there
    pressure = hydrostatic.pressure_pa(latitude, z, kelvin, gases["h2o"], ground_pa)
    for values in (z, pressure, kelvin, *gases.values()):
        values.flags.writeable = False
    return GasState(z, pressure, kelvin, gases)


def as_profile(state: GasState, name: str) -> AtmosphereProfile:
    """Return one column, arrays of shape (n,) or (1, n), as a profile."""
    pressure, kelvin = state.pressure_pa.reshape(-1), state.temperature_k.reshape(-1)
    air = pressure / (_BOLTZMANN * kelvin)

    def density(gas: str) -> FloatArray:
        return np.asarray(air * state.vmr[gas].reshape(-1))

    return AtmosphereProfile(
        name=name,
        altitude_m=state.altitude_m,
        pressure_pa=pressure,
        temperature_k=kelvin,
        number_density_air=air,
        number_density_o3=density("o3"),
        number_density_h2o=density("h2o"),
        number_density_co2=density("co2"),
        number_density_n2o=density("n2o"),
        number_density_ch4=density("ch4"),
        number_density_hno3=density("hno3"),
    )


def real_profile(name: str, where: str = "") -> AtmosphereProfile:
    """Return a real state on levels from 0 to 120 km, with what it lacks from the climate of its place and month.

    Above its last level the temperature stays as it is there. CO2, N2O, CH4 and HNO3 are the climate's, at equal
    pressure; so are water vapour and ozone above the levels that know them.

    Raises
    ------
    UserError
        Unknown name.
    """
    s = real_states.real_state(name, where)
    z = np.unique(np.concatenate([np.arange(0.0, 30e3, 250.0), np.arange(30e3, 120_001.0, 500.0)]))
    kelvin = np.interp(z, s.altitude_m, s.temperature_k)
    ln_p = np.interp(z, s.altitude_m, np.log(s.pressure_pa))
    top = float(s.altitude_m[-1])
    gravity = hydrostatic.gravity_m_s2(s.latitude_deg, 0.5 * (top + z))
    scale = hydrostatic.GAS_CONSTANT * kelvin / (hydrostatic.MOLAR_MASS_KG * gravity)
    pressure = np.exp(ln_p - np.maximum(z - top, 0.0) / scale)
    month = climate.month_of(datetime(s.date.year, s.date.month, s.date.day, tzinfo=UTC))
    blend = afgl.blended([climate.climate_weights(s.latitude_deg, month)], z)
    gases = {
        gas: np.exp(np.interp(-np.log(pressure), -np.log(blend.pressure_pa[0]), np.log(row[0])))
        for gas, row in blend.vmr.items()
    }
    for gas, known, values in (
        ("h2o", s.known_water, s.water_share),
        ("o3", s.ozone_share > 0.0, s.ozone_share),
    ):
        height = s.altitude_m[known]
        own = np.exp(np.interp(z, height, np.log(values[known])))
        gases[gas] = np.where(z <= height[-1], own, gases[gas])
    return as_profile(GasState(z, pressure, kelvin, gases), real_states.PREFIX + name)
