"""96 real states of the atmosphere, each a column by name: the air at one place on one day.

They are ECMWF analyses as distributed with the Community Radiative Transfer Model (CC0): ``ec2008-nn`` of 2006 and 2007
(M. Matricardi, ECMWF Technical Memorandum 564, 2008), ``ec1999-nn`` of 1992 and 1993. Both sets were selected to be
diverse: their spread is that of extremes.

Heights follow from pressure by hydrostatic balance with virtual temperature. Height 0 is at 1013.25 hPa: below the
surface, which may be a mountain's, the air continues with 6.5 K/km and the water vapour of the lowest level. Above the
last level, 0.005 hPa at some 83 km, temperature and mixing ratios are constant. The older set has no water vapour above
the tropopause (only a floor of 1e-6 kg/kg): the climate's is used there, and so is ozone's where it is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.tables import npz
from horizonval.earth.weather.hydrostatic import GAS_CONSTANT, LIGHTER_WATER, MOLAR_MASS_KG, gravity_m_s2

TABLE = "weather_profiles.npz"
PREFIX = "weather:"
"""Prefix of the names by which scenes refer to a state."""
SEA_LEVEL_HPA = 1013.25
_LAPSE_K_M = 6.5e-3
WATER_FLOOR_PPMV = 1.7
"""Floor of the older set's water vapour (1e-6 kg/kg, 1.6 ppm of the molecules), which means unknown."""


@dataclass(frozen=True)
class RealState:
    """One state on its own levels, from height 0 up; ``known_water``: bool, shape (n,).

    ``surface_m``: height of its surface. ``water_share`` and ``ozone_share``: mole fractions in moist air.
    """

    name: str
    date: date
    latitude_deg: float
    longitude_deg: float
    surface_m: float
    altitude_m: FloatArray
    pressure_pa: FloatArray
    temperature_k: FloatArray
    water_share: FloatArray
    ozone_share: FloatArray
    known_water: np.ndarray


def names() -> list[str]:
    """Return the names of all states, such as ``ec2008-12``."""
    return [str(name) for name in npz(TABLE)["name"]]


def real_state(name: str, where: str = "") -> RealState:
    """Return a state by name; raises ``UserError`` if it is unknown."""
    known = names()
    if name not in known:
        raise UserError(
            f"unknown state {name!r}", where=where, expected="one of " + ", ".join(nearest(name, known)[:12]) + ", ..."
        )
    table, i = npz(TABLE), known.index(name)

    def row(key: str) -> FloatArray:
        return np.asarray(table[key][i], dtype=np.float64)

    pressure = np.asarray(table["pressure_hpa"], dtype=np.float64)
    order = np.argsort(-pressure)
    surface_hpa, latitude = float(row("surface_pressure_hpa")), float(row("latitude_deg"))
    order = order[pressure[order] < surface_hpa]
    hpa, kelvin = pressure[order], row("temperature_k")[order]
    water, ozone = row("h2o_ppmv")[order] * 1e-6, row("o3_ppmv")[order] * 1e-6
    # down from the lowest level to where the sea would be, in steps of some 100 m; a surface below it is cut off
    if hpa[0] < SEA_LEVEL_HPA:
        below = np.linspace(np.log(SEA_LEVEL_HPA), np.log(hpa[0]), 40, endpoint=False)
        exponent = GAS_CONSTANT * _LAPSE_K_M / (MOLAR_MASS_KG * 9.80665)
        warmer = kelvin[0] * (np.exp(below) / hpa[0]) ** exponent
        hpa, kelvin = np.concatenate([np.exp(below), hpa]), np.concatenate([warmer, kelvin])
        water = np.concatenate([np.full(len(below), water[0]), water])
        ozone = np.concatenate([np.full(len(below), ozone[0]), ozone])
    virtual = kelvin * (1.0 + LIGHTER_WATER * water)
    scale = GAS_CONSTANT / MOLAR_MASS_KG * 0.5 * (virtual[1:] + virtual[:-1]) * -np.diff(np.log(hpa))
    height = np.zeros(len(hpa))
    for k, thickness in enumerate(scale):
        middle = height[k] + 0.5 * thickness / 9.8
        height[k + 1] = height[k] + thickness / float(gravity_m_s2(latitude, middle))
    floor = 1e6 * water <= WATER_FLOOR_PPMV if name.startswith("ec1999") else np.zeros(len(hpa), dtype=bool)
    return RealState(
        name=name,
        date=date.fromisoformat(str(table["date"][i])),
        latitude_deg=latitude,
        longitude_deg=float(row("longitude_deg")),
        surface_m=float(np.interp(-np.log(surface_hpa), -np.log(hpa), height)),
        altitude_m=height,
        pressure_pa=hpa * 100.0,
        temperature_k=kelvin,
        water_share=water,
        ozone_share=ozone,
        known_water=~floor,
    )


def description(name: str) -> str:
    """Return a line with the place and date of a state."""
    s = real_state(name)
    north, east = "N" if s.latitude_deg >= 0.0 else "S", "E" if s.longitude_deg >= 0.0 else "W"
    place = f"{abs(s.latitude_deg):.0f} {north}, {abs(s.longitude_deg):.0f} {east}"
    return f"The air over {place} on {s.date.isoformat()} (ECMWF)."
