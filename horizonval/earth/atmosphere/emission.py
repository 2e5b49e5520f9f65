"""Thermal bands for renderer and truth: absorption and temperature of a scene's air over height and latitude.

A band is a set of g points (:mod:`horizonval.earth.spectral.thermal_absorption`), each solved as if monochromatic and
summed::

    L = sum over g of [ integral of S_g(T) exp(-tau_g) dtau_g  +  (ground, cloud or Sun behind) exp(-tau_g) ]

The air is given at levels of height for every row of latitude. Between levels the absorption is linear in its logarithm
and the temperature is linear. Between rows the renderer takes ``extinction`` and ``source`` of
:meth:`EmittingBand.columns` as linear in the sine of latitude, beyond the last row as constant. Air that varies with
longitude too has columns on a map (:mod:`horizonval.earth.weather.field`), bilinear between.

The absorption follows from pressure, temperature and gases (:mod:`horizonval.earth.gases.rrtmg`). The levels depend on
the air:

- AFGL climates and their blends by latitude and month: :func:`horizonval.earth.gases.afgl.levels_m`. A blend by
  latitude has a row for every latitude in sight (:mod:`horizonval.earth.atmosphere.climate`); its state is blended, not
  its absorption, and its troposphere over the poles is colder (:mod:`horizonval.earth.weather.zonal_climate`);
- weather and profiles of many places: columns on a map, on fewer levels, integrated on 250 m to 1 km;
- any other profile: 100 m;
- an atmosphere file: its own grey absorption on its own nodes;
- none: nothing absorbs.

Columns over high ground begin there: below it nothing absorbs or emits, although the ground itself lies on the
ellipsoid. Over an ``earth`` columns on a map begin at the height of the land poleward of 62 deg, and rows of latitude
at the mean height of the Antarctic around their circle (sea counts as 0). Elsewhere they begin at 0: over plateaus, and
with rows over Greenland, there is too much warm air.

Particles absorb at the middle of the g point's band, beyond 18.5 um as at 18.5 um. Their scattering is neglected (at 10
um one part in eight of a stratospheric particle's extinction, half of rural air's, which lies below the water vapour).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.special import expn

from horizonval.core.arrays import FloatArray
from horizonval.core.digests import content_digest
from horizonval.earth.atmosphere import aerosol, climate
from horizonval.earth.atmosphere.air import AS_IT_IS, TOP_M, Air, AirChange
from horizonval.earth.atmosphere.solar_rule import check_sunlight
from horizonval.earth.clouds.layers import ThinLayer
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral import bands, sunlight, thermal_absorption
from horizonval.earth.spectral.planck import radiance_per_wavenumber
from horizonval.earth.weather.field import ColumnMap, latitude_longitude_deg
from horizonval.earth.weather.zonal_climate import with_cold_poles
from horizonval.spec.camera import Band
from horizonval.spec.scene import SceneSpec

COLDEST_K, WARMEST_K, STEP_K = 80.0, 400.0, 1.0
"""Range and step of the spline through S(T); its error is below 1e-8 of S."""
_OPAQUE, _THIN = 300.0, 1e-3
GROUND_STEP_M = 250.0
"""Height over which a column over high ground begins: the step of the map's grid, so that its depth is right."""


@dataclass(frozen=True)
class SourceSpline:
    """S_g(T) by a spline between COLDEST_K and WARMEST_K; beyond them by the slower exact formula.

    ``wavenumber_per_cm`` (q,) and ``weight_per_cm`` (g, q) are those of an :class:`EmittingBand`.
    """

    wavenumber_per_cm: FloatArray
    weight_per_cm: FloatArray
    spline: CubicSpline

    def __call__(self, temperature_k: ArrayLike) -> FloatArray:
        """Return S [W m-2 sr-1]; shape of the temperature followed by (g,)."""
        temperature = np.asarray(temperature_k, dtype=np.float64)
        value = np.asarray(self.spline(np.clip(temperature, COLDEST_K, WARMEST_K)))
        outside = (temperature < COLDEST_K) | (temperature > WARMEST_K)
        if np.any(outside):
            planck = radiance_per_wavenumber(self.wavenumber_per_cm, temperature[outside][:, None])
            value[outside] = planck @ self.weight_per_cm.T
        return value

    def of(self, part: slice) -> SourceSpline:
        """Return the spline of some of the g points."""
        spline = CubicSpline.construct_fast(self.spline.c[:, :, part], self.spline.x)
        return SourceSpline(self.wavenumber_per_cm, self.weight_per_cm[part], spline)


@dataclass(frozen=True)
class EmittingBand:
    """One thermal band of a camera with the air in front of it.

    Attributes
    ----------
    wavelength_um : ndarray, shape (g,)
        Nominal, per g point.
    altitude_m : ndarray, shape (n,)
        Grid of the renderer from 0 to the top; extinction and source are linear between its nodes.
    sin_latitude : ndarray, shape (m,)
        Of geodetic latitude, rising in equal steps; a single value means the same air everywhere. With a map: one value
        without meaning, and m below is the number of the map's columns.
    level_m : ndarray, shape (k,)
    ln_extinction : ndarray, shape (g, m, k)
        Logarithm of the extinction [1/m] at the levels.
    temperature_k : ndarray, shape (m, k)
    source_wavenumber_per_cm, source_weight_per_cm : ndarray, shapes (q,) and (g, q)
        ``S_g(T) = sum_q weight[g, q] B_nu(wavenumber[q], T)``, W m-2 sr-1.
    sun_radiance : ndarray, shape (g,)
        Mean radiance of the Sun's disc outside the atmosphere [W m-2 sr-1].
    column_map : ColumnMap or None
        Positions of the columns of air that varies with longitude.
    layer_per_m : ndarray, shape (g, n) or (0, 0)
        Extinction of thin cloud on ``altitude_m``.
    layers : ndarray, shape (k, 2)
        Base and top of its layers [m].
    each_layer_per_m : ndarray, shape (k, g, n) or (0, 0, 0)
        ``layer_per_m`` of each layer, where one has gaps.
    ground_m : ndarray, shape (m,) or (0,)
        Height at which each column begins, if not 0.
    """

    name: str
    wavelength_um: FloatArray
    altitude_m: FloatArray
    sin_latitude: FloatArray
    level_m: FloatArray
    ln_extinction: FloatArray
    temperature_k: FloatArray
    source_wavenumber_per_cm: FloatArray
    source_weight_per_cm: FloatArray
    sun_radiance: FloatArray
    column_map: ColumnMap | None = None
    layer_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    layers: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    each_layer_per_m: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0)))
    ground_m: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def is_uniform(self) -> bool:
        """Whether the air is the same everywhere."""
        return self.column_map is None and len(self.sin_latitude) == 1

    @cached_property
    def content_digest(self) -> str:
        """The digest of all fields; for weather it takes 0.1 s."""
        return content_digest(*(getattr(self, item.name) for item in fields(self)))

    def coarser(self) -> EmittingBand:
        """Return the band with fewer columns of its map, for slowly varying quantities such as the sky's mean."""
        if self.column_map is None:
            return self
        place, kept = self.column_map.coarser()
        return replace(self.of_columns(kept), column_map=place)

    def of_columns(self, kept: NDArray[np.intp]) -> EmittingBand:
        """Return the band with some of its columns; their positions are unchanged."""
        return replace(
            self,
            ln_extinction=self.ln_extinction[:, kept],
            temperature_k=self.temperature_k[kept],
            ground_m=self.ground_m[kept] if len(self.ground_m) else self.ground_m,
        )

    def between(self, values: FloatArray, normal: FloatArray) -> FloatArray:
        """Return values of the columns, shape (g, m), interpolated to unit normals (n, 3), shape (g, n)."""
        if self.column_map is None:
            return np.stack([np.interp(normal[:, 2], self.sin_latitude, row) for row in values])
        x, y = self.column_map.plane(normal)
        return np.asarray(sum(values[:, i] * w for i, w in self.column_map.corners(x, y)))

    @property
    def count(self) -> int:
        """Number of g points."""
        return len(self.wavelength_um)

    def source(self, temperature_k: ArrayLike) -> FloatArray:
        """Return S_g(T) [W m-2 sr-1]; shape of the temperature followed by (g,)."""
        temperature = np.asarray(temperature_k, dtype=np.float64)[..., None]
        return radiance_per_wavenumber(self.source_wavenumber_per_cm, temperature) @ self.source_weight_per_cm.T

    def source_spline(self) -> SourceSpline:
        """Return a fast S_g(T) for many temperatures."""
        nodes = np.arange(COLDEST_K, WARMEST_K + STEP_K, STEP_K)
        spline = CubicSpline(nodes, self.source(nodes))
        return SourceSpline(self.source_wavenumber_per_cm, self.source_weight_per_cm, spline)

    def columns(self) -> tuple[FloatArray, FloatArray]:
        """Return extinction [1/m] and source function [W m-2 sr-1] on ``altitude_m``, shapes (g, m, n)."""
        return self.extinction_at(self.altitude_m), np.moveaxis(self.source_spline()(self.air_k(self.altitude_m)), 2, 0)

    def sky_irradiance(self) -> FloatArray:
        """Return the mean radiance of the sky over the ground [W m-2 sr-1], shape (g, m): irradiance over pi.

        A Lambert ground of emissivity e sends up ``e S`` and ``1 - e`` times this. The formula is exact for plane
        layers whose source is linear in optical depth, with dark space behind::

            sky = integral of S 2 E_2(tau) dtau,    E_2 = -dE_3/dtau,    E_3 = -dE_4/dtau

        On a round Earth low rays meet less air: the sky is darker by at most 0.13 % of the ground's S in any g point,
        0.05 % in a band.
        """
        extinction, source = self.columns()
        layer = 0.5 * (extinction[..., 1:] + extinction[..., :-1]) * np.diff(self.altitude_m)
        tau = np.concatenate([np.zeros((*layer.shape[:-1], 1)), np.cumsum(layer, axis=-1)], axis=-1)
        tau = np.minimum(tau, _OPAQUE)
        third = expn(3, tau)
        fourth = (np.exp(-tau) - tau * third) / 3.0
        passed, step = 2.0 * (third[..., :-1] - third[..., 1:]), np.diff(tau, axis=-1)
        moment = 2.0 * (fourth[..., :-1] - fourth[..., 1:] - step * third[..., 1:])
        thick = step > _THIN
        # The mean place of what is seen of a layer; the middle of a thin one, where the moments cancel.
        upper = np.divide(moment, step * passed, out=np.full_like(step, 0.5), where=thick & (passed > 1e-30))
        mean = source[..., :-1] * (1.0 - upper) + source[..., 1:] * upper
        return np.asarray(np.sum(mean * passed, axis=-1))

    def extinction_at(self, altitude_m: ArrayLike) -> FloatArray:
        """Return the extinction [1/m] at heights (n,), shape (g, m, n)."""
        i, w = self._locate(altitude_m)
        z = np.asarray(altitude_m, dtype=np.float64)
        share = w[:, None]
        gas = np.empty((self.ln_extinction.shape[1], len(z), self.count))
        # The g points of a column lie side by side, as kernels and rays read them; one column stays in a cache.
        for column, ln_levels in zip(gas, np.moveaxis(self.ln_extinction, 1, 0), strict=True):
            ln = np.ascontiguousarray(ln_levels.T)
            np.exp(ln[i] * (1.0 - share) + ln[i + 1] * share, out=column)
        if self.ground_m.any():
            gas *= self._above_ground(z)[..., None]
        if len(self.layers):
            gas += np.stack([np.interp(z, self.altitude_m, row) for row in self.layer_per_m], axis=-1)
        return np.moveaxis(gas, -1, 0)

    def _above_ground(self, z: FloatArray) -> FloatArray:
        """Return the share of the air around heights (n,) above the ground of each column, shape (m, n)."""
        low, high = np.maximum(z - 0.5 * GROUND_STEP_M, 0.0), z + 0.5 * GROUND_STEP_M
        return np.clip((high - self.ground_m[:, None]) / (high - low), 0.0, 1.0)

    def air_k(self, altitude_m: ArrayLike) -> FloatArray:
        """Return the temperature at heights (n,), shape (m, n)."""
        i, w = self._locate(altitude_m)
        return self.temperature_k[:, i] * (1.0 - w) + self.temperature_k[:, i + 1] * w

    def _locate(self, altitude_m: ArrayLike) -> tuple[np.ndarray, FloatArray]:
        z = np.clip(np.asarray(altitude_m, dtype=np.float64), self.level_m[0], self.level_m[-1])
        i = np.clip(np.searchsorted(self.level_m, z, side="right") - 1, 0, len(self.level_m) - 2)
        return i, (z - self.level_m[i]) / (self.level_m[i + 1] - self.level_m[i])


MAP_STEP_DEG = 3.0
"""Distance between columns of weather. In the middle of four columns temperatures are off by 0.14 K rms."""
MOST_ALONG_A_SIDE = 37
"""Largest number of columns along a side; from far away they are farther apart (6.5 deg below a geostationary camera).
"""
MAP_LEVEL_M = np.concatenate(
    [
        np.arange(0.0, 14e3, 1e3),
        np.arange(14e3, 18e3, 250.0),
        np.arange(18e3, 50e3, 1e3),
        np.arange(50e3, 1e5 + 1.0, 2e3),
    ]
)
"""Levels of columns on a map, fine where the absorption jumps (:func:`horizonval.earth.gases.afgl.levels_m`)."""
MAP_GRID_M = np.concatenate(
    [np.arange(0.0, 20e3, 250.0), np.arange(20e3, 60e3, 500.0), np.arange(60e3, TOP_M + 1.0, 1e3)]
)
GroundHeights = Callable[[FloatArray, FloatArray | None], FloatArray]
"""Heights [m] at which columns begin, from latitudes and longitudes (m,) [deg]; None for rows of latitude."""
LEAST_PER_M = 1e-300
"""Extinction that replaces zero where a logarithm is needed."""


@dataclass(frozen=True)
class EmittingAir:
    """The air of a scene for its thermal bands, before a band is chosen.

    ``altitude_m``: shape (n,), grid of the renderer; ``sin_latitude``: shape (m,), one value with a ``column_map``;
    ``state``: on the levels (k,) of height, arrays of shape (m, k); ``particles``: on the same levels; ``change``: how
    the bands' air differs, with the absorption per molecule of ``state``; ``column_map``: positions of the columns that
    vary with longitude, or None; ``ground_m``: shape (m,) or (0,), height at which each column begins.
    """

    altitude_m: FloatArray
    sin_latitude: FloatArray
    state: GasState
    particles: aerosol.Aerosol
    change: AirChange = AS_IT_IS
    column_map: ColumnMap | None = None
    layers: tuple[ThinLayer, ...] = ()
    ground_m: FloatArray = field(default_factory=lambda: np.zeros(0))

    def band(self, band: Band, where: str) -> EmittingBand:
        """Return a thermal band; errors as :func:`horizonval.earth.spectral.thermal_absorption.g_points`."""
        points = thermal_absorption.g_points(band, where=where)
        levels, kelvin = self.state.altitude_m, self.state.temperature_k
        gas = points.ln_absorption(self.state) + self.change.ln_density(levels, kelvin)
        return EmittingBand(
            name=band.name,
            wavelength_um=points.wavelength_um,
            altitude_m=self.altitude_m,
            sin_latitude=self.sin_latitude,
            level_m=levels + self.change.raised_m,
            ln_extinction=self._with_particles(gas, points.wavelength_um),
            temperature_k=kelvin + self.change.warmer_k,
            source_wavenumber_per_cm=points.wavenumber_per_cm,
            source_weight_per_cm=points.weight_per_cm,
            sun_radiance=points.sun_radiance(),
            column_map=self.column_map,
            ground_m=self.ground_m,
            **self._layers(points.wavelength_um),
        )

    def _layers(self, wavelength_um: FloatArray) -> dict[str, Any]:
        """Return the fields of a band about thin cloud."""
        if not self.layers:
            return {}
        raised = self.change.raised_m
        absorbed = [layer.infrared_per_m(self.altitude_m, wavelength_um, raised) for layer in self.layers]
        heights = np.array([(layer.base_m + raised, layer.top_m + raised) for layer in self.layers])
        kept: dict[str, Any] = {"layer_per_m": np.sum(absorbed, axis=0), "layers": heights}
        if any(layer.gaps is not None for layer in self.layers):
            kept["each_layer_per_m"] = np.array(absorbed)
        return kept

    def _with_particles(self, ln_gas: FloatArray, wavelength_um: FloatArray) -> FloatArray:
        if not self.particles.kinds:
            return ln_gas
        absorbed = {}
        for wavelength in np.unique(wavelength_um):
            extinct, scattered, _ = self.particles.at(min(float(wavelength), aerosol.MAX_UM))
            absorbed[wavelength] = extinct - scattered
        per_m = np.stack([absorbed[w] for w in wavelength_um])
        # in place, and only as high as there are particles: arrays of weather are large
        low = ln_gas[..., : np.flatnonzero(per_m.any(axis=0)).max(initial=-1) + 1]
        both = np.exp(low)
        both += per_m[:, None, : low.shape[-1]]
        np.log(both, out=low)
        return ln_gas


def emitting_air(
    air: Air, scene: SceneSpec, change: AirChange = AS_IT_IS, ground: GroundHeights | None = None
) -> EmittingAir:
    """Return the air of a scene whose atmosphere is neither ``none`` nor a file.

    ``by_latitude_month`` without a fixed latitude has a row of air for every latitude in sight; weather and profiles of
    many places have columns on a map; otherwise one row serves the whole frame. ``air``: unchanged column below the
    satellite; ``ground``: heights at which columns begin, default 0.
    """
    rows, grid = np.zeros(1), air.altitude_m
    place, ground_m = None, np.zeros(0)
    if air.columns is not None:
        place = map_in_sight(scene)
        latitude, longitude = latitude_longitude_deg(place.normals())
        state = air.columns(latitude, longitude, MAP_LEVEL_M)
        grid = MAP_GRID_M
        ground_m = ground_m if ground is None else ground(latitude, longitude)
    elif air.climates:
        climates: tuple[Mapping[str, float], ...] = (air.climates,)
        latitude = np.array([scene.atmosphere.latitude_deg or 0.0])
        if climate.varies(scene):
            rows = climate.rows_in_sight(scene.platform.latitude_deg, scene.platform.altitude_km * 1e3)
            climates = climate.row_weights(rows, climate.month_of_rows(scene))
            latitude = np.degrees(np.arcsin(rows))
            ground_m = ground_m if ground is None else ground(latitude, None)
        state = afgl.blended(climates, afgl.levels_m(), scene.atmosphere.co2_ppm)
        if scene.atmosphere.profile == climate.BY_LATITUDE_MONTH:
            state = with_cold_poles(state, latitude, climate.month_of_rows(scene))
    else:
        state = air.state.gas_state().columns()
    if scene.atmosphere.halocarbons:
        state = state.with_halocarbons()
    atmosphere = scene.atmosphere
    haze = aerosol.aerosol(
        atmosphere.aerosol, state.altitude_m, depth_below_10_km=atmosphere.aerosol_optical_depth_550nm
    )
    return EmittingAir(
        altitude_m=grid,
        sin_latitude=rows,
        state=state,
        particles=change.particles(haze),
        change=change,
        column_map=place,
        layers=air.layers,
        ground_m=ground_m,
    )


def map_in_sight(scene: SceneSpec, step_deg: float = MAP_STEP_DEG) -> ColumnMap:
    """Return positions of the columns that a satellite's rays can meet, ``step_deg`` apart, or more from far."""
    latitude, longitude = math.radians(scene.platform.latitude_deg), math.radians(scene.platform.longitude_deg)
    below = math.cos(latitude) * np.array([math.cos(longitude), math.sin(longitude), math.tan(latitude)])
    reach = climate.reach_rad(scene.platform.altitude_km * 1e3)
    widest = 2.0 * math.atan(2.0 * math.tan(0.5 * reach) / (MOST_ALONG_A_SIDE - 1))
    return ColumnMap.around(below, reach, max(math.radians(step_deg), widest))


def grey_band(
    band: Band,
    altitude_m: FloatArray,
    temperature_k: FloatArray,
    absorption_per_m: FloatArray,
    where: str,
    pieces: int = 1,
) -> EmittingBand:
    """Return a thermal band with the same absorption at all its wavelengths, one column everywhere.

    ``altitude_m``, ``temperature_k``, ``absorption_per_m``: shape (n,), at levels, between which absorption and source
    are linear; ``where``: file and key of the band, for the error message; ``pieces``: number of g points of the band,
    for a ground with a spectrum. Raises ``UserError``: band reaching beyond the Sun's known spectrum.
    """
    check_sunlight(band, where)
    wavelength, weight_um = bands.sampled(band)
    sun = sunlight.irradiance(wavelength) * weight_um
    cut = np.linspace(0, len(wavelength), pieces + 1).astype(int)
    owner = np.searchsorted(cut, np.arange(len(wavelength)), side="right") - 1
    mine = (owner == np.arange(pieces)[:, None]) & (weight_um > 0)
    mine = mine[mine.any(axis=1)]
    count = len(mine)
    absorbed = np.log(np.maximum(absorption_per_m, LEAST_PER_M))
    return EmittingBand(
        name=band.name,
        wavelength_um=mine @ (weight_um * wavelength) / (mine @ weight_um),
        altitude_m=altitude_m,
        sin_latitude=np.zeros(1),
        level_m=altitude_m,
        ln_extinction=np.broadcast_to(absorbed, (count, 1, len(altitude_m))).copy(),
        temperature_k=temperature_k[None, :],
        source_wavenumber_per_cm=1e4 / wavelength,
        source_weight_per_cm=mine * weight_um * (1e4 / wavelength**2),
        sun_radiance=mine @ sun / sunlight.disc_projected_solid_angle(),
    )


def no_air_band(band: Band, ground_k: float, where: str, pieces: int = 1) -> EmittingBand:
    """Return a thermal band over a planet without air."""
    z = np.array([0.0, TOP_M])
    return grey_band(band, z, np.full(2, ground_k), np.zeros(2), where, pieces)
