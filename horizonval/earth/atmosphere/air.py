"""Air of a scene: its column on the grid of the optical properties, its columns at any place, and perturbed air.

**Perturbed air** (:class:`AirChange`), used for derivatives of frames:

- warmer: every temperature T becomes T + e. The pressure at the ground stays; above it follows from hydrostatic
  balance, so that by the ideal gas law the density changes by::

      d ln n(z) = -ln(1 + e / T) + int_0^z (M g / R) (1 / T - 1 / (T + e)) dz'

  Only the change is balanced, since the profiles are hydrostatic to a few per cent. Mixing ratios stay. Ozone's cross
  section in sunlight follows the temperature; in thermal bands absorption per molecule does not change;
- denser: all gases by one factor, temperature unchanged;
- dustier: all particles by one factor;
- raised: the air at height z moves to z + e; below e it is as at the ground. Refraction, the ground and its temperature
  do not change.

**Columns at any place**, where the air varies over latitude and longitude:

- ``by_latitude_month``: the blend of the AFGL climates for latitude and month;
- ``weather``: the zonal climate of :mod:`horizonval.earth.weather.zonal_climate` plus random deviations
  (:mod:`horizonval.earth.weather.field`). Pressure follows from hydrostatic balance, upward from sea level. Ozone and
  water vapour are the AFGL blend's at equal **pressure** times a random factor; below 25 km water vapour is at most
  saturated. N2O, CH4, HNO3 and CO2 are the blend's.

Deviations extend to 65 km and fade above. Temperatures are clipped to 130 to 340 K, which about one in 10 000 levels of
a polar winter would leave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.atmosphere import climate, profile_file
from horizonval.earth.atmosphere.aerosol import Aerosol, aerosol
from horizonval.earth.atmosphere.placed_profiles import PlacedProfiles
from horizonval.earth.atmosphere.profiles import GASES, AtmosphereProfile, names, profile, us76
from horizonval.earth.clouds.layers import ThinLayer, layers_of
from horizonval.earth.clouds.relief import seed_of
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.weather import hydrostatic, real_states, zonal_climate
from horizonval.earth.weather.field import SCALE_M, WeatherField
from horizonval.earth.weather.hydrostatic import saturated_share
from horizonval.spec.scene import SceneSpec

GRAVITY_M_S2, MOLAR_MASS_KG, GAS_CONSTANT = 9.80665, 28.9644e-3, 8.314462618
EARTH_RADIUS_M = 6_356_766.0


@dataclass(frozen=True)
class AirChange:
    """Difference of air from a scene's.

    ``warmer_k``: added to every temperature, pressure in hydrostatic balance; ``denser``, ``dustier``: relative change
    of all gases, of all particles; ``raised_m``: height by which the whole air is raised over the ground.
    """

    warmer_k: float = 0.0
    denser: float = 0.0
    dustier: float = 0.0
    raised_m: float = 0.0

    def ln_density(self, altitude_m: FloatArray, temperature_k: FloatArray) -> FloatArray:
        """Return the change of the logarithm of every gas's density.

        ``altitude_m`` (n,) rises from the ground; ``temperature_k`` (..., n) is that before the change.
        """
        gas = np.full_like(temperature_k, np.log1p(self.denser))
        if not self.warmer_k:
            return gas
        gravity = GRAVITY_M_S2 * (EARTH_RADIUS_M / (EARTH_RADIUS_M + altitude_m)) ** 2
        lighter = self.warmer_k / (temperature_k * (temperature_k + self.warmer_k))
        swollen = cumulative_trapezoid(MOLAR_MASS_KG / GAS_CONSTANT * gravity * lighter, altitude_m, initial=0.0)
        return np.asarray(gas + swollen - np.log1p(self.warmer_k / temperature_k))

    def state(self, state: AtmosphereProfile) -> AtmosphereProfile:
        """Return warmer and denser gases; the caller evaluates raised air at lower heights."""
        if not (self.warmer_k or self.denser):
            return state
        factor = np.exp(self.ln_density(state.altitude_m, state.temperature_k))
        temperature = state.temperature_k + self.warmer_k
        return AtmosphereProfile.of(
            name=state.name,
            altitude_m=state.altitude_m,
            pressure_pa=state.pressure_pa * factor * temperature / state.temperature_k,
            temperature_k=temperature,
            number_density_air=state.number_density_air * factor,
            gases={gas: density * factor for gas, density in state.gas_densities().items()},
        )

    def particles(self, particles: Aerosol) -> Aerosol:
        """Return more particles."""
        return replace(particles, extinction_550_per_m=particles.extinction_550_per_m * (1.0 + self.dustier))


AS_IT_IS = AirChange()


WEATHER = "weather"
SATURATED_TO_M = 25_000.0
COLDEST_K, WARMEST_K = 130.0, 340.0
_BOLTZMANN = 1.380649e-23
_MODEL_TOP_M = 86_000.0


def weather_of(scene: SceneSpec) -> WeatherField | None:
    """Return the weather of a scene, or None."""
    a = scene.atmosphere
    if a.profile != WEATHER or a.profile_file is not None or a.file is not None:
        return None
    seed = a.seed
    if seed is None:
        seed = seed_of(scene, "weather")
    return WeatherField(seed, climate.month_of_rows(scene), a.warming_k)


def log_pressure_height_m(altitude_m: FloatArray) -> FloatArray:
    """Return ``7 km ln(p_0 / p)`` of US76 at heights, extrapolated linearly above 86 km."""
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
    """Return columns of weather, arrays of shape (c, k). The last few results are cached.

    ``latitude_deg``, ``longitude_deg``: shape (c,), geodetic; ``altitude_m``: shape (k,), geodetic, rising from 0 to at
    most 100 km; ``co2_ppm``: in the lower atmosphere; ``calm``: the climate without deviations.
    """
    latitude, longitude, z = (np.asarray(v, dtype=np.float64) for v in (latitude_deg, longitude_deg, altitude_m))
    places = tuple(tuple(v.tolist()) for v in (latitude, longitude, z))
    state = _weather(field, places, co2_ppm, calm)
    return replace(state, vmr=dict(state.vmr))


@lru_cache(maxsize=8)
def _weather(field: WeatherField, places: tuple[tuple[float, ...], ...], co2_ppm: float, calm: bool) -> GasState:
    """Return :func:`weather_columns` for latitudes, longitudes and heights, write-protected."""
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
    gases = {gas: air * state.vmr[gas].reshape(-1) for gas in GASES}
    return AtmosphereProfile.of(name, state.altitude_m, pressure, kelvin, air, gases)


def real_profile(name: str, where: str = "") -> AtmosphereProfile:
    """Return a real state on levels from 0 to 120 km, completed from the climate of its latitude and month.

    Above its last level the temperature is constant. CO2, N2O, CH4 and HNO3 are the climate's at equal pressure; so are
    water vapour and ozone above their known levels. Raises ``UserError``: unknown name.
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


NO_ATMOSPHERE = "none"
TOP_M = 100_000.0
STEP_M = 100.0
Columns = Callable[[FloatArray, FloatArray, FloatArray], GasState]
"""From latitudes and longitudes (c,) [deg] and heights (k,) [m] to the gases there."""


@dataclass(frozen=True)
class Air:
    """Gases and particles of a scene in one column; where they vary, those of one place.

    ``state``: on 0 to 100 km by 100 m; ``climates``: weights of the AFGL climates in it, empty for ``us76`` and a
    profile from a file; ``aerosol``: on the same altitudes, thin cloud included; ``with_ozone``: ozone absorbs
    sunlight; ``columns``: function for weather and for profiles of many places, else None.
    """

    state: AtmosphereProfile
    climates: Mapping[str, float]
    aerosol: Aerosol
    with_ozone: bool
    columns: Columns | None = None
    layers: tuple[ThinLayer, ...] = ()

    @property
    def altitude_m(self) -> FloatArray:
        """Altitudes of everything, shape (n,)."""
        return self.state.altitude_m


def air_of(
    scene: SceneSpec,
    base_dir: Path | None = None,
    change: AirChange = AS_IT_IS,
    place_deg: tuple[float, float] | None = None,
) -> Air:
    """Return the gases and particles of a scene whose atmosphere is neither ``none`` nor ``file``.

    ``base_dir``: folder of ``atmosphere.profile_file``, default the current one; ``place_deg``: geodetic latitude and
    longitude of the column, default the sub-satellite point, ignored where the air is uniform. Raises ``UserError``:
    unknown profile, or an invalid profile file.
    """
    atmosphere = scene.atmosphere
    place = (scene.platform.latitude_deg, scene.platform.longitude_deg) if place_deg is None else place_deg
    z = np.linspace(0.0, TOP_M, round(TOP_M / STEP_M) + 1)
    climates: Mapping[str, float] = {}
    many: Columns | None = None
    weather = weather_of(scene)
    if atmosphere.profile_file is not None:
        path = (base_dir or Path()) / atmosphere.profile_file
        placed = PlacedProfiles(profile_file.read_profiles(path, co2_ppm=atmosphere.co2_ppm))
        state = placed.profiles[0].profile
        if placed.vary:
            many = placed.columns
            state = as_profile(many(np.array([place[0]]), np.array([place[1]]), z), state.name)
    elif weather is not None:
        many = partial(weather_columns, weather, co2_ppm=atmosphere.co2_ppm)
        state = as_profile(many(np.array([place[0]]), np.array([place[1]]), z), WEATHER)
    elif atmosphere.profile.startswith(real_states.PREFIX):
        name = atmosphere.profile.removeprefix(real_states.PREFIX)
        state = real_profile(name, where=f"{scene.scene.name}: atmosphere.profile")
    elif atmosphere.profile == climate.BY_LATITUDE_MONTH:
        latitude = atmosphere.latitude_deg
        latitude = place[0] if latitude is None else latitude
        climates = climate.climate_weights(latitude, climate.month_of_rows(scene))
        state = climate.blended(climates)
    else:
        known = [*names(), climate.BY_LATITUDE_MONTH, WEATHER, NO_ATMOSPHERE]
        if atmosphere.profile not in known:
            raise UserError(
                f"unknown atmosphere profile {atmosphere.profile!r}",
                where=f"{scene.scene.name}: atmosphere.profile",
                expected="one of " + ", ".join(nearest(atmosphere.profile, known)),
            )
        state = profile(atmosphere.profile)
        climates = {state.name: 1.0} if state.name in afgl.names() else {}
    if atmosphere.profile_file is None and many is None:
        state = replace(state, number_density_co2=state.number_density_co2 * (atmosphere.co2_ppm / afgl.CO2_PPM))
    lower = np.clip(z - change.raised_m, state.altitude_m[0], state.altitude_m[-1])
    particles = aerosol(
        atmosphere.aerosol,
        np.minimum(lower, TOP_M),
        depth_below_10_km=atmosphere.aerosol_optical_depth_550nm,
        where=f"{scene.scene.name}: atmosphere.aerosol",
    )
    gases = replace(state.at(lower), altitude_m=z)
    layers = layers_of(scene)
    particles = _with_layers(change.particles(particles), layers, z, change.raised_m)
    return Air(change.state(gases), climates, particles, atmosphere.ozone, many, layers)


def _with_layers(particles: Aerosol, layers: tuple[ThinLayer, ...], altitude_m: FloatArray, raised_m: float) -> Aerosol:
    """Return particles including those of thin cloud."""
    columns = [layer.column(altitude_m, raised_m) for layer in layers]
    kinds = (*particles.kinds, *(layer.particle for layer in layers))
    return Aerosol(kinds, np.concatenate([particles.extinction_550_per_m, *(c[None, :] for c in columns)]))
