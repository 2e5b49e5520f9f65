"""Tables of thermal bands: states of air, cloud and ground by latitude and month, and the profiles they give.

Every place of the table has

- the calm climate of the weather model, :func:`horizonval.earth.atmosphere.air.weather_columns`;
- *air*: :data:`WEATHERS` days drawn with it, one draw serving all latitudes of its month, at two places of a
  parallel, and as one more the blend of the AFGL climates, without the colder poles that scenes have below 8 km. Days
  come in pairs, each with its opposite, and warmings in as many of them as they have of all days, so that the mean of
  few days is the climate's;
- *below*: :data:`COVERS` states of what else is there, on the calm air: opaque clouds in three states of four, cirrus
  as often as it is seen, the ground warmer or colder than the climate by 5 K rms, on land or sea by halves, haze of 0.5
  to 2 times the mean (one standard deviation), a volcanic stratosphere in one of ten.

All of these shares were chosen, but for the weather's own and the occurrence of cirrus, which have sources where they
are made. Draws follow from hashes of month and number.

A line meets the highest cloud within :data:`SIGHT_M` of its lowest point that stands in its way: of tops ``z(s)`` along
it, the height ``max of z(s) - s^2 / 2R``. Tops are those of the pattern of the Earth of the month; every state takes
one quantile of their distribution at all latitudes. The cloud is a shell there, as warm as the air.

Air is the same all along a line: how it differs along some hundred kilometres is left out. The table of a band is the
mean and the modes of all states of all places, month by month.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress
from horizonval.earth.atmosphere.aerosol import MEAN_DEPTH_BELOW_10_KM, aerosol
from horizonval.earth.atmosphere.air import weather_columns
from horizonval.earth.atmosphere.climate import climate_weights
from horizonval.earth.atmosphere.emission import EmittingAir, EmittingBand
from horizonval.earth.clouds import layers, relief
from horizonval.earth.clouds.layers import ThinLayer
from horizonval.earth.column import OpticalModel
from horizonval.earth.gases import afgl, rayleigh
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.limb_heights import CLOUD_RELIEF_THERMAL
from horizonval.earth.spectral import bands
from horizonval.earth.surface import surface_temperature
from horizonval.earth.surface.ground_emission import uniform_ground
from horizonval.earth.weather import field
from horizonval.earth.weather.field import WeatherField
from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.templates import LimbTemplates
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.horizon import rays_along_parallels
from horizonval.spec.camera import Band
from horizonval.tables.modes import (
    BESIDE,
    HEIGHT_M,
    LATITUDE_DEG,
    MONTHS,
    edge_weights,
    empirical_modes,
    kept_arrays,
    scene_mode,
)

WEATHERS, COVERS = 12, 6
CIRRUS = ("cirrus", "subvisible_cirrus")
ASIDE_DEG = 15.0
"""Distance along the parallel, as an angle at the Earth's centre.

0.1 to 0.5 of the arcs of limb that low orbits see.
"""
LEAST_COSINE = math.cos(math.radians(80.0))
"""Of the latitude; nearer to a pole a step along the parallel is a turn of 86 deg, and at the pole it leads nowhere."""
CLOUDS, VOLCANIC = 0.75, 0.1
GROUND_SIGMA_K, HAZE_SIGMA = 5.0, math.log(2.0)
SIGHT_M, SIGHT_STEP_M = 300e3, 15e3
LONGITUDES = 48
OPAQUE_PER_M = 2e-2
"""Of opaque cloud: black within 100 m."""
GRID_M = np.linspace(0.0, 100e3, 1001)
NODES = 128
"""Of the march; see :data:`horizonval.suites.stability.NODES`."""


def draws(what: str, month: float, number: int) -> np.random.Generator:
    """Return the random numbers of one state."""
    return np.random.default_rng(seed_of(what, month, number))


def seed_of(what: str, month: float, number: int) -> int:
    """Return the seed of one state."""
    return int.from_bytes(hashlib.sha256(f"limb templates {what} {month:g} {number}".encode()).digest()[:4], "little")


@dataclass(frozen=True)
class Cover:
    """What lies below the air and in it, gases apart.

    ``top_m``: of opaque cloud, 0 for none. ``layers``: of cirrus. ``haze``: name and depth below 10 km.
    ``ground_warmer_k``: than sea or land (``land``) of the climate.
    """

    top_m: float
    layers: tuple[ThinLayer, ...]
    haze: tuple[str, float]
    ground_warmer_k: float
    land: float


CLEAR = Cover(0.0, (), ("background", MEAN_DEPTH_BELOW_10_KM), 0.0, 0.5)


def is_cloudy(month: float, number: int) -> bool:
    """Return whether one of the states has opaque clouds at all: all latitudes of a month together."""
    return bool(draws("cover", month, number).random() < CLOUDS)


def has_cirrus(latitude_deg: float, month: float, number: int) -> bool:
    """Return whether one of the states has thin clouds of any kind at a latitude."""
    lots = draws("cover", month, number).random(3)[1:]
    return any(lot < layers.occurrence(kind, latitude_deg, month) for kind, lot in zip(CIRRUS, lots, strict=True))


def cirrus_chance(latitude_deg: float, month: float) -> float:
    """Return how often there are any, of the kinds by themselves."""
    return 1.0 - math.prod(1.0 - layers.occurrence(kind, latitude_deg, month) for kind in CIRRUS)


def cover_of(latitude_deg: float, month: float, number: int) -> Cover:
    """Return the cover of one state at a latitude."""
    random = draws("cover", month, number)
    cloudy, cirrus, thin, volcanic, land, phase = random.random(6)
    depth, haze, warmer, height = random.standard_normal(4)
    # the quantiles of a month's states are spread evenly
    quantile = (number + phase) / COVERS
    top = float(np.quantile(_tops(month, latitude_deg), quantile)) if cloudy < CLOUDS else 0.0
    thin_layers = []
    for kind, lot in zip(CIRRUS, (cirrus, thin), strict=True):
        if lot < layers.occurrence(kind, latitude_deg, month):
            usual = layers.KINDS[kind]
            level = float(relief.tropopause_m(latitude_deg)) + 500.0 * float(height)
            tau = usual.optical_depth * math.exp(HAZE_SIGMA * float(depth))
            base, highest = level + usual.base_m, level + usual.top_m
            particle = layers.particle(usual.phase, usual.effective_radius_um)
            thin_layers.append(ThinLayer(base, highest, tau / (highest - base), particle))
    name = "volcanic_moderate" if volcanic < VOLCANIC else "background"
    amount = MEAN_DEPTH_BELOW_10_KM * math.exp(HAZE_SIGMA * float(haze))
    return Cover(max(top, 0.0), tuple(thin_layers), (name, amount), GROUND_SIGMA_K * float(warmer), float(land < 0.5))


@cache
def _tops(month: float, latitude_deg: float) -> FloatArray:
    """Return how high clouds stand in the way of lines at a latitude, shape (LONGITUDES,)."""
    return clouds_in_the_way(month, np.full(LONGITUDES, latitude_deg), np.linspace(0.0, 360.0, LONGITUDES + 1)[:-1])


def clouds_in_the_way(month: float, latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    """Return the heights [m], shape (n,), below which lines towards the east are stopped by clouds; 0 for none."""
    field = relief.CloudField(None, 17e3, 7e3, 3e5, seed_of("clouds", month, 0), 0.8, "earth", round(month))
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    up = np.stack(
        [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1
    )
    east = np.stack([-np.sin(longitude), np.cos(longitude), np.zeros_like(longitude)], axis=-1)
    along = np.arange(-SIGHT_M, SIGHT_M + 1.0, SIGHT_STEP_M) / WGS84.a_m
    places = up[:, None] * np.cos(along)[:, None] + east[:, None] * np.sin(along)[:, None]
    tops = relief.top_m(field, places.reshape(-1, 3)).reshape(places.shape[:2])
    tops = np.where(tops > relief.BASE_M, tops, 0.0)
    return np.asarray(np.maximum((tops - 0.5 * WGS84.a_m * along**2).max(axis=1), 0.0))


def calm_air(latitude_deg: float, month: float, altitude_m: FloatArray) -> GasState:
    """Return the climate of the weather model at a place, arrays of shape (1, k)."""
    place = np.array([latitude_deg]), np.array([0.0])
    return weather_columns(WeatherField(0, month), *place, altitude_m, calm=True)


def air_of_state(
    latitude_deg: float, month: float, number: int, altitude_m: FloatArray, *, aside: bool = False
) -> GasState:
    """Return the gases of one of the states of air; the last is the blend of the AFGL climates.

    All latitudes of a state have one longitude, or one :data:`ASIDE_DEG` east of it (``aside``).
    """
    if number == WEATHERS:
        return afgl.blended([climate_weights(latitude_deg, month)], altitude_m)
    pair = number // 2
    longitude = draws("longitude", month, pair).uniform(-180.0, 180.0)
    if aside:
        longitude += math.degrees(float(aside_rad(math.radians(latitude_deg))))
    field = WeatherField(seed_of("weather", month, pair), month, _warming_k(month, number), bool(number % 2))
    return weather_columns(field, np.array([latitude_deg]), np.array([longitude]), altitude_m)


def aside_rad(latitude_rad: ArrayLike) -> FloatArray:
    """Return by how much of longitude states aside stand farther east."""
    return np.asarray(math.radians(ASIDE_DEG) / np.maximum(np.cos(latitude_rad), LEAST_COSINE))


def _warming_k(month: float, number: int) -> float:
    """Return the amplitude of a state's warming, 0 for none; of all states of a month warmings have their own share."""
    happens, _ = draws("warming", month, 0).random(2)
    _, size = draws("warming", month, number).random(2)
    low, high = field.DRAWN_K
    return low + (high - low) * float(size) if (number + happens) / WEATHERS < field.chance(month) else 0.0


def thermal_model(
    air: GasState, some_bands: list[Band], latitude_deg: float, month: float, cover: Cover = CLEAR
) -> OpticalModel:
    """Return what the renderer needs of one uniform column of air with its ground.

    ``air``: arrays of shape (1, k), on any levels from 0 to 100 km; ``latitude_deg``, ``month``: of the ground.
    """
    levels = air.altitude_m
    haze = aerosol(cover.haze[0], levels, depth_below_10_km=cover.haze[1])
    emitting = EmittingAir(GRID_M, np.zeros(1), air.with_halocarbons(), haze, layers=cover.layers)
    made = tuple(_with_cloud(emitting.band(band, ""), cover.top_m) for band in some_bands)
    density = np.exp(np.interp(GRID_M, levels, np.log(air.pressure_pa[0] / (1.380649e-23 * air.temperature_k[0]))))
    index = rayleigh.refractivity(density, [bands.reference_wavelength_um(band) for band in some_bands])
    ground = uniform_ground(ground_k(latitude_deg, month, cover), 1.0)
    return OpticalModel(GRID_M, float(GRID_M[-1]), (), 0.0, refractivity=index, thermal=made, emission=ground)


def ground_k(latitude_deg: float, month: float, cover: Cover) -> float:
    """Return the temperature of the ground of a state [K]."""
    place = np.array([latitude_deg])
    sea, land = surface_temperature.sea_k(place, month), surface_temperature.land_k(place, month)
    return float((cover.land * land + (1 - cover.land) * sea)[0]) + cover.ground_warmer_k


def _with_cloud(band: EmittingBand, top_m: float) -> EmittingBand:
    """Return a band with a shell of opaque cloud from the ground to a top."""
    if top_m <= 0.0:
        return band
    black = OPAQUE_PER_M * np.clip((top_m - band.altitude_m) / 100.0 + 0.5, 0.0, 1.0)
    absorbed = np.broadcast_to(black, (band.count, len(black)))
    layers = np.array([[0.0, top_m], *band.layers.tolist()])
    more = band.layer_per_m + absorbed if band.layer_per_m.size else absorbed
    return replace(band, layer_per_m=more, layers=layers)


def thermal_profiles(model: OpticalModel, latitude_deg: float, some_bands: list[Band]) -> list[FloatArray]:
    """Return the profiles on ``HEIGHT_M`` of every band [W m-2 sr-1 um-1], lines along the parallel."""
    from horizonval.renderer.rays import thermal_radiance

    origin, direction = rays_along_parallels(np.radians([latitude_deg]), HEIGHT_M)
    found = thermal_radiance(model, WGS84.a_m, origin[0], direction[0], polar_radius_m=WGS84.b_m, nodes=NODES)
    return [found[band.name] / bands.width_um(band) for band in some_bands]


AIR_MODES, COVER_MODES = 5, 2
COVER_KINDS = ("scene", "veil") + ("below",) * COVER_MODES
LEAST_ALIKE, MOST_ALIKE = 0.05, 0.99
"""Correlations of places apart that some 70 states can tell from none, and from all."""
KEPT = ("calm", "air", "aside", "below")
VERSION = 3
"""Version of the states: raised where they change, so that stored months are recomputed."""


def _month_keys(some_bands: list[Band]) -> list[str]:
    return [f"{band.name} {what}" for band in some_bands for what in KEPT]


def thermal_month(some_bands: list[Band], month: float, progress: Progress) -> dict[str, FloatArray]:
    """Return the profiles of one month by band and kind.

    ``calm`` (A, H), ``air`` (A, N, H), ``aside`` (A, N - 1, H), ``below``.
    """
    levels = afgl.levels_m()
    found: dict[str, list[FloatArray]] = {key: [] for key in _month_keys(some_bands)}

    def add(latitude: float, what: str, models: list[OpticalModel]) -> None:
        rows = [thermal_profiles(model, latitude, some_bands) for model in models]
        for band, profiles in zip(some_bands, zip(*rows, strict=True), strict=True):
            found[f"{band.name} {what}"].append(np.array(profiles))

    for latitude in map(float, LATITUDE_DEG):
        progress.step(f"month {month:g}", f"latitude {latitude:g}")
        calm = calm_air(latitude, month, levels)
        airs = [air_of_state(latitude, month, k, levels) for k in range(WEATHERS + 1)]
        asides = [air_of_state(latitude, month, k, levels, aside=True) for k in range(WEATHERS)]
        covers = [cover_of(latitude, month, k) for k in range(COVERS)]
        add(latitude, "calm", [thermal_model(calm, some_bands, latitude, month)])
        add(latitude, "air", [thermal_model(air, some_bands, latitude, month) for air in airs])
        add(latitude, "aside", [thermal_model(air, some_bands, latitude, month) for air in asides])
        add(latitude, "below", [thermal_model(calm, some_bands, latitude, month, cover) for cover in covers])
    return {key: np.array(values) for key, values in found.items()}


def thermal_table(
    some_bands: list[Band], work: Path, progress: Progress, months: FloatArray = MONTHS
) -> list[LimbTemplates]:
    """Return the tables of thermal bands; months that lie in the folder ``work`` already are read from there."""
    parts = []
    names = "-".join(band.name for band in some_bands)
    for month in months:
        path = work / f"thermal-{names}-{month:g}-v{VERSION}.npz"
        make = partial(thermal_month, some_bands, float(month), progress)
        parts.append(kept_arrays(path, _month_keys(some_bands), make))
    return [_assembled(band, parts, months) for band in some_bands]


@dataclass(frozen=True)
class CoverModes:
    """``mean`` and ``left_variance`` (A, B, H), ``modes`` (A, B, K, H) and ``correlation_rad`` (K,)."""

    mean: FloatArray
    modes: FloatArray
    left_variance: FloatArray
    correlation_rad: FloatArray


def cover_modes(departures: FloatArray, months: FloatArray, *, around: bool) -> CoverModes:
    """Return the modes of scenes with clouds, with thin ones, and the rest.

    ``departures``: (A, B, COVERS, H) from the same air without clouds; ``around``: the months are the whole year.
    """
    cloudy = np.array([[is_cloudy(float(m), k) for k in range(COVERS)] for m in months], dtype=float)
    whole = scene_mode(departures, cloudy[None], CLOUDS, around=around)
    left = departures - whole.of_state
    thin = np.array(
        [[[has_cirrus(lat, float(m), k) for k in range(COVERS)] for m in months] for lat in LATITUDE_DEG],
        dtype=float,
    )
    often = np.array([[cirrus_chance(lat, float(m)) for m in months] for lat in LATITUDE_DEG])
    veil = scene_mode(left, thin, often[..., None], around=around)
    rest = empirical_modes(left - veil.of_state, edge_weights(HEIGHT_M), COVER_MODES, around=around)
    return CoverModes(
        rest.mean + whole.mean + veil.mean,
        np.concatenate([whole.mode[:, :, None], veil.mode[:, :, None], rest.modes], axis=2),
        rest.left_variance,
        np.array([np.pi, np.pi, *[CLOUD_RELIEF_THERMAL.correlation_rad] * COVER_MODES]),
    )


def _assembled(band: Band, parts: list[dict[str, FloatArray]], months: FloatArray) -> LimbTemplates:
    calm, air, aside, below = (np.stack([part[f"{band.name} {what}"] for part in parts], axis=1) for what in KEPT)
    # the climate of all states, the last of the air, counts once for each place of the parallel
    of_air = empirical_modes(
        np.concatenate([air, aside, air[:, :, -1:]], axis=2) - calm, edge_weights(HEIGHT_M), AIR_MODES, around=True
    )
    of_cover = cover_modes(below - calm, months, around=True)
    return LimbTemplates(
        band_kind="thermal",
        band_um=bands.limits_um(band),
        height_m=HEIGHT_M,
        axes=(np.radians(LATITUDE_DEG), months),
        mean=calm[:, :, 0] + of_air.mean + of_cover.mean,
        modes=np.concatenate([of_air.modes, of_cover.modes], axis=2),
        mode_kinds=("air",) * AIR_MODES + COVER_KINDS,
        correlation_rad=np.concatenate(
            [lengths_of_air(of_air.coefficients), everywhere(of_cover.correlation_rad, len(LATITUDE_DEG))], axis=1
        ),
        left_sigma=np.sqrt(of_air.left_variance + of_cover.left_variance),
        made_by=f"tests/data/make_limb_templates.py, states {VERSION}: {WEATHERS + 1} of air and "
        f"{COVERS} of what is below at every place",
    )


def lengths_of_air(coefficients: FloatArray) -> FloatArray:
    """Return the lengths [rad] of modes along the meridian and along the parallel, shape (A, K, 2).

    From the correlation r of places apart by the chord d, ``l = d / sqrt(2 ln 1/r)``, all months together: with the
    latitudes on both sides along the meridian, and as many along the parallel. At the poles, where there is no
    parallel, both are that of the meridian. ``coefficients``: (A, B, 2 WEATHERS + 2, K), of states at one longitude,
    the climate of all, the same states aside, the climate again.
    """
    at, aside = (coefficients[:, :, k : k + WEATHERS] for k in (0, WEATHERS + 1))
    latitude = np.radians(LATITUDE_DEG)
    steps = np.zeros((len(latitude), len(latitude) - 1))
    steps[1:] += np.eye(len(latitude) - 1)
    steps[:-1] += np.eye(len(latitude) - 1)
    apart = np.full(len(latitude) - 1, 2.0 * np.sin(0.5 * (latitude[1] - latitude[0])))
    meridian = _lengths(at[1:], at[:-1], steps, apart)
    beside = np.eye(len(latitude)) + BESIDE * (np.eye(len(latitude), k=1) + np.eye(len(latitude), k=-1))
    beside[:, [0, -1]] = 0.0
    turn = aside_rad(latitude)
    parallel = _lengths(at, aside, beside, 2.0 * np.cos(latitude) * np.sin(0.5 * turn))
    parallel[[0, -1]] = meridian[[0, -1]]
    return np.stack([meridian, parallel], axis=-1)


def _lengths(a: FloatArray, b: FloatArray, together: FloatArray, apart: FloatArray) -> FloatArray:
    """Return lengths (A, K) of coefficients (P, B, N, K) and those ``apart`` (P,); ``together`` (A, P) adds pairs."""
    both, one, other = (together @ np.sum(x * y, axis=(1, 2)) for x, y in ((a, b), (a, a), (b, b)))
    r = np.clip(both / np.sqrt(one * other), LEAST_ALIKE, MOST_ALIKE)
    square = (together @ apart**2) / np.maximum(together.sum(axis=1), 1e-300)
    return np.asarray(np.sqrt(square[:, None] / (-2.0 * np.log(r))))
