"""Gases in solar bands, in one column and in the columns around it.

At a wavelength, with number densities n, cross sections s, and absorption per air mass and per cm of water::

    k_molecules  = n_air s_Rayleigh
    k_absorption = n_ozone s_ozone(T) + n_NO2 s_NO2 + a_mixed (air mass per metre) + a_water (water per metre)

Where the air varies, columns have the same positions as those of thermal bands
(:mod:`horizonval.earth.atmosphere.emission`): rows of equal latitude, or a map of the area in sight. They are stored as
differences from the column below the camera, on levels of :data:`STEP_M`: the difference of two columns is smooth even
where a layer of thin cloud, the same in both, is not. Linear interpolation between levels has a relative error of at
most 6e-4 (a scale height of 7 km). Particles are the same everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere import climate
from horizonval.earth.atmosphere.air import TOP_M, Air, AirChange, as_profile
from horizonval.earth.atmosphere.emission import map_in_sight
from horizonval.earth.atmosphere.profiles import AtmosphereProfile
from horizonval.earth.atmosphere.solar_rule import SolarRule
from horizonval.earth.column import ColumnPlaces
from horizonval.earth.gases import nitrogen_dioxide, ozone, rayleigh, sunlight_absorption
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.weather.field import latitude_longitude_deg
from horizonval.spec.scene import SceneSpec

STEP_M = 500.0
MAP_STEP_DEG = 6.0
"""Distance between columns on a map, twice that of thermal bands: sunlight depends on densities, not temperatures."""
ALIKE = 1e-4
"""Largest relative difference of the densities of air and ozone at which columns count as equal."""


@dataclass(frozen=True)
class SunlitGases:
    """What scatters and absorbs sunlight, arrays of shape (..., n).

    ``mixed`` and ``water``: relative air mass, and cm of precipitable water, in a metre.
    """

    number_density_air: FloatArray
    number_density_o3: FloatArray
    number_density_no2: FloatArray
    temperature_k: FloatArray
    mixed: FloatArray
    water: FloatArray

    @classmethod
    def of(cls, state: AtmosphereProfile, raised_m: float, *, with_gases: bool) -> SunlitGases:
        """Return the gases of one column, raised over the ground; without nitrogen dioxide unless ``with_gases``."""
        air = state.number_density_air
        no2 = nitrogen_dioxide.number_density_per_m3(state.altitude_m - raised_m, air)
        return cls(
            air,
            state.number_density_o3,
            no2 if with_gases else np.zeros_like(air),
            state.temperature_k,
            sunlight_absorption.air_mass_per_m(state.pressure_pa, state.number_density_air),
            sunlight_absorption.water_cm_per_m(state.pressure_pa, state.number_density_h2o),
        )

    def molecular_per_m(self, wavelength_um: float) -> FloatArray:
        """Return the scattering coefficient of molecules."""
        return np.asarray(self.number_density_air * rayleigh.cross_section_m2(wavelength_um))

    def absorption_per_m(self, rule: SolarRule, index: int) -> FloatArray:
        """Return the absorption of a rule's node."""
        no2_m2 = nitrogen_dioxide.cross_section_m2(float(rule.wavelength_um[index]))
        absorption = self.number_density_o3 * ozone.at_temperature_m2(
            rule.ozone_cold_m2[index], rule.ozone_warm_m2[index], self.temperature_k
        )
        absorption = absorption + self.number_density_no2 * no2_m2
        if rule.mixed_gases[index] or rule.water_vapour[index]:
            absorption = absorption + rule.mixed_gases[index] * self.mixed + rule.water_vapour[index] * self.water
        return np.asarray(absorption)


@dataclass(frozen=True)
class GasesInSight:
    """Columns over the area in sight: ``gases`` of shape (m, k), and ``below`` the camera (k,) on the same levels."""

    places: ColumnPlaces
    gases: SunlitGases
    below: SunlitGases

    def more_per_m(self, rule: SolarRule, index: int) -> tuple[FloatArray, FloatArray]:
        """Return how much the columns exceed that below in extinction and scattering of a node, (m, k) each."""
        wavelength = float(rule.wavelength_um[index])
        scattering = self.gases.molecular_per_m(wavelength) - self.below.molecular_per_m(wavelength)
        absorption = self.gases.absorption_per_m(rule, index) - self.below.absorption_per_m(rule, index)
        return scattering + absorption, scattering


def gases_in_sight(air: Air, scene: SceneSpec, change: AirChange) -> GasesInSight | None:
    """Return the changed columns of ``air`` that a scene's camera sees; None where all are equal (:data:`ALIKE`)."""
    z = np.linspace(0.0, TOP_M, round(TOP_M / STEP_M) + 1)
    rows, place = np.zeros(0), None
    if air.columns is not None:
        place = map_in_sight(scene, MAP_STEP_DEG)
        states = _profiles(air.columns(*latitude_longitude_deg(place.normals()), z))
    elif climate.varies(scene):
        rows = climate.rows_in_sight(scene.platform.latitude_deg, scene.platform.altitude_km * 1e3)
        states = [climate.blended(weights) for weights in climate.row_weights(rows, climate.month_of_rows(scene))]
    else:
        return None

    def changed(state: AtmosphereProfile) -> SunlitGases:
        lower = np.clip(z - change.raised_m, state.altitude_m[0], state.altitude_m[-1])
        there = state if np.array_equal(lower, state.altitude_m) else replace(state.at(lower), altitude_m=z)
        return SunlitGases.of(change.state(there), change.raised_m, with_gases=scene.atmosphere.gases_in_sunlight)

    below, all_gases = changed(air.state), [changed(state) for state in states]
    names = [field.name for field in fields(SunlitGases)]
    gases = SunlitGases(*(np.stack([getattr(each, name) for each in all_gases]) for name in names))
    pairs = ((gases.number_density_air, below.number_density_air), (gases.number_density_o3, below.number_density_o3))
    if all(np.allclose(a, b, rtol=ALIKE, atol=0.0) for a, b in pairs):
        return None
    return GasesInSight(ColumnPlaces(z, rows, place), gases, below)


def _profiles(state: GasState) -> Sequence[AtmosphereProfile]:
    return [
        as_profile(GasState(state.altitude_m, p, kelvin, {gas: values[i] for gas, values in state.vmr.items()}), "")
        for i, (p, kelvin) in enumerate(zip(state.pressure_pa, state.temperature_k, strict=True))
    ]
