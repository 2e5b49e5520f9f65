"""What a scene's atmosphere is made of, on the grid that the optical properties are made on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.atmosphere import climate, climate_rows, columns, profile_file
from horizonval.earth.atmosphere.aerosol import Aerosol, aerosol
from horizonval.earth.atmosphere.air_change import AS_IT_IS, AirChange
from horizonval.earth.atmosphere.placed_profiles import PlacedProfiles
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, names, profile
from horizonval.earth.clouds.layers import ThinLayer, layers_of
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.weather import real_states
from horizonval.spec.scene import SceneSpec

NO_ATMOSPHERE = "none"
TOP_M = 100_000.0
STEP_M = 100.0
Columns = Callable[[FloatArray, FloatArray, FloatArray], GasState]
"""From latitudes and longitudes (c,) [deg] and heights (k,) [m] to the gases there."""


@dataclass(frozen=True)
class Air:
    """Gases and particles of a scene: one column, where they vary that of one place.

    Attributes
    ----------
    state : AtmosphereProfile
        On 0 to 100 km by 100 m.
    climates : mapping of str to float
        The AFGL climates that it is a blend of, with weights; empty for ``us76`` and a profile from a file.
    aerosol : Aerosol
        On the same altitudes, thin cloud among it; without kinds for none.
    with_ozone : bool
        Whether ozone absorbs sunlight.
    columns : callable or None
        Of weather, and of profiles of many places from a file.
    layers : tuple of ThinLayer
        Of thin cloud.
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
    """Return the gases and particles of a scene with an atmosphere of its own (neither ``none`` nor ``file``).

    This is the one way to a column of a scene's air: where that varies over the Earth, the column of any place.

    Parameters
    ----------
    scene : SceneSpec
        Its atmosphere; for ``by_latitude_month`` also latitude and epoch of the platform.
    base_dir : Path, optional
        Folder against which ``atmosphere.profile_file`` is resolved; default the current one.
    change : AirChange
        How the air differs from the scene's.
    place_deg : tuple of two floats, optional
        Geodetic latitude and longitude of the column; default that of the point below the satellite. Of no account
        where the air is the same everywhere.

    Raises
    ------
    UserError
        Unknown profile, or a profile's file refused.
    """
    atmosphere = scene.atmosphere
    place = (scene.platform.latitude_deg, scene.platform.longitude_deg) if place_deg is None else place_deg
    z = np.linspace(0.0, TOP_M, round(TOP_M / STEP_M) + 1)
    climates: Mapping[str, float] = {}
    many: Columns | None = None
    weather = columns.weather_of(scene)
    if atmosphere.profile_file is not None:
        path = (base_dir or Path()) / atmosphere.profile_file
        placed = PlacedProfiles(profile_file.read_profiles(path, co2_ppm=atmosphere.co2_ppm))
        state = placed.profiles[0].profile
        if placed.vary:
            many = placed.columns
            state = columns.as_profile(many(np.array([place[0]]), np.array([place[1]]), z), state.name)
    elif weather is not None:
        many = partial(columns.weather_columns, weather, co2_ppm=atmosphere.co2_ppm)
        state = columns.as_profile(many(np.array([place[0]]), np.array([place[1]]), z), columns.WEATHER)
    elif atmosphere.profile.startswith(real_states.PREFIX):
        name = atmosphere.profile.removeprefix(real_states.PREFIX)
        state = columns.real_profile(name, where=f"{scene.scene.name}: atmosphere.profile")
    elif atmosphere.profile == climate.BY_LATITUDE_MONTH:
        latitude = atmosphere.latitude_deg
        latitude = place[0] if latitude is None else latitude
        climates = climate.climate_weights(latitude, climate_rows.month(scene))
        state = climate.blended(climates)
    else:
        known = [*names(), climate.BY_LATITUDE_MONTH, columns.WEATHER, NO_ATMOSPHERE]
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
    """Return particles with those of thin cloud among them."""
    columns = [layer.column(altitude_m, raised_m) for layer in layers]
    kinds = (*particles.kinds, *(layer.particle for layer in layers))
    return Aerosol(kinds, np.concatenate([particles.extinction_550_per_m, *(c[None, :] for c in columns)]))
