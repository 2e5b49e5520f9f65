"""Thermal bands of a scene: from its atmosphere to :class:`horizonval.earth.atmosphere.emission.EmittingBand`.

What the air absorbs is looked up for its own pressure, temperature and gases (:mod:`horizonval.earth.gases.rrtmg`).
What the air is decides where its levels are:

- the AFGL climates and their blends by latitude and month: those of :func:`horizonval.earth.gases.afgl.levels_m`. A
  blend by latitude has a row for every latitude in sight, see :mod:`horizonval.earth.atmosphere.climate_rows`; its
  state is blended, not its absorption. Over the poles its troposphere is colder than any climate's
  (:mod:`horizonval.earth.weather.cold_poles`);
- weather and profiles of many places: columns on a map of what is in sight
  (:mod:`horizonval.earth.weather.column_map`), on fewer levels and marched on 250 m to 1 km. All else is the same
  everywhere;
- any other profile: 100 m;
- an atmosphere file: its own absorption, the same throughout a band (grey), on its own nodes;
- none: nothing absorbs.

Over the ground of an ``earth`` columns on a map begin at the height of the land poleward of 62 deg, and rows of
latitude at the mean height of the Antarctic around their circle (sea counts as 0): air that is not there does not
shine. Elsewhere they begin at 0: over plateaus, and with rows over Greenland, there is too much warm air.

Halocarbons of today's amounts come with all gases unless ``atmosphere.halocarbons`` is off.

Particles absorb at the middle of the g point's band; what they scatter there is left out (at 10 um one part in eight of
a stratospheric particle's extinction, half of rural air's, which lies below the water vapour). Beyond 18.5 um they
absorb as at 18.5 um.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import aerosol, climate, climate_rows
from horizonval.earth.atmosphere.air import TOP_M, Air
from horizonval.earth.atmosphere.air_change import AS_IT_IS, AirChange
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.atmosphere.solar_rule import check_sunlight
from horizonval.earth.clouds.layers import ThinLayer
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral import bands, sunlight, thermal_absorption
from horizonval.earth.weather.cold_poles import with_cold_poles
from horizonval.earth.weather.column_map import ColumnMap, latitude_longitude_deg
from horizonval.spec.camera import Band
from horizonval.spec.scene import SceneSpec

MAP_STEP_DEG = 3.0
"""Between columns of weather. In the middle of four, where that is worst, the error against the weather drawn there is
0.14 K rms (1.2 K at most) of temperature, 0.2 % rms (1.1 %) of radiance in 14.0 to 16.3 um and 30 m rms (210 m) of the
height of half of it (three winter days from 20 and 65 N). With 2.5 deg it is 0.09 K, 0.15 % and 20 m rms, with 3.5 deg
0.2 K, 0.3 % and 40 m, with 5 deg 0.3 K, 0.6 % and 60 m."""
MOST_ALONG_A_SIDE = 37
"""Columns; from far away they stand farther apart: 6.5 deg below a geostationary camera, 3.8 deg at its limb."""
MAP_LEVEL_M = np.concatenate(
    [
        np.arange(0.0, 14e3, 1e3),
        np.arange(14e3, 18e3, 250.0),
        np.arange(18e3, 50e3, 1e3),
        np.arange(50e3, 1e5 + 1.0, 2e3),
    ]
)
"""Levels of columns on a map: fine where the absorption jumps, see :func:`horizonval.earth.gases.afgl.levels_m`."""
MAP_GRID_M = np.concatenate(
    [np.arange(0.0, 20e3, 250.0), np.arange(20e3, 60e3, 500.0), np.arange(60e3, TOP_M + 1.0, 1e3)]
)
GroundHeights = Callable[[FloatArray, FloatArray | None], FloatArray]
"""Heights [m] at which columns begin, from latitudes and longitudes (m,) [deg]; None for rows of latitude."""
LEAST_PER_M = 1e-300
"""Extinction that stands for none where a logarithm is needed."""


@dataclass(frozen=True)
class EmittingAir:
    """The air of a scene as its thermal bands see it, before a band is chosen.

    Attributes
    ----------
    altitude_m : ndarray, shape (n,)
        The grid to march on.
    sin_latitude : ndarray, shape (m,)
        One value where there is a ``column_map``.
    state : GasState
        On the levels (k,) of height, arrays of shape (m, k).
    particles : Aerosol
        On the same levels.
    change : AirChange
        How the bands' air differs; absorption per molecule stays that of ``state``.
    column_map : ColumnMap or None
        Where the columns of ``state`` stand if they vary with longitude.
    layers : tuple of ThinLayer
        Of thin cloud.
    ground_m : ndarray, shape (m,) or (0,)
        Height at which each column begins.
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
        """Return what a band keeps of thin cloud."""
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
        return np.log(np.exp(ln_gas) + np.stack([absorbed[w] for w in wavelength_um])[:, None, :])


def emitting_air(
    air: Air, scene: SceneSpec, change: AirChange = AS_IT_IS, ground: GroundHeights | None = None
) -> EmittingAir:
    """Return the air of a scene that has gases of its own (neither ``none`` nor an atmosphere file).

    For ``by_latitude_month`` without a latitude of its own there is a row of air for every latitude in sight, for
    weather and profiles of many places columns on a map; else one row serves the whole frame.

    Parameters
    ----------
    air : Air
        Of the scene, as it is: the column below the satellite.
    scene : SceneSpec
    change : AirChange
        How the bands' air differs from it.
    ground : callable, optional
        Where columns begin; without it all do at 0.
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
        if climate_rows.varies(scene):
            rows = climate_rows.rows_in_sight(scene.platform.latitude_deg, scene.platform.altitude_km * 1e3)
            climates = climate_rows.weights(rows, climate_rows.month(scene))
            latitude = np.degrees(np.arcsin(rows))
            ground_m = ground_m if ground is None else ground(latitude, None)
        state = afgl.blended(climates, afgl.levels_m(), scene.atmosphere.co2_ppm)
        if scene.atmosphere.profile == climate.BY_LATITUDE_MONTH:
            state = with_cold_poles(state, latitude, climate_rows.month(scene))
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
    """Return where columns stand that a satellite's rays can meet, a step apart or more from far."""
    latitude, longitude = math.radians(scene.platform.latitude_deg), math.radians(scene.platform.longitude_deg)
    below = math.cos(latitude) * np.array([math.cos(longitude), math.sin(longitude), math.tan(latitude)])
    reach = climate_rows.reach_rad(scene.platform.altitude_km * 1e3)
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

    Parameters
    ----------
    band : Band
    altitude_m, temperature_k, absorption_per_m : ndarray, shape (n,)
        Levels and grid to march on in one: absorption and source are linear between.
    where : str
        File and key of the band, for the error message.
    pieces : int
        Into how many g points the band is cut, for the sake of a ground with a spectrum.

    Raises
    ------
    UserError
        Band reaching beyond the Sun's known spectrum.
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
    """Return a thermal band over a planet without air; its columns hold nothing up to 100 km."""
    z = np.array([0.0, TOP_M])
    return grey_band(band, z, np.full(2, ground_k), np.zeros(2), where, pieces)
