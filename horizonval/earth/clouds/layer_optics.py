"""Optical properties of the particles of thin cloud, relative to their extinction at 550 nm.

Three tables by effective radius (``cloud_optics.json``; its README says where from): water droplets (4 to 30 um) and
ice crystals (10 to 60 um, severely rough habits) at six wavelengths from 0.45 to 0.9 um, and for the infrared their
absorption in the bands of RRTMG, 500 to 1390 cm-1; ice spheres of 0.02 to 0.2 um (noctilucent clouds), 0.2 to 1.05 um.
Between the entries everything is linear in the logarithm of radius and wavelength. Droplets and crystals are as at
0.45 um below it, and as at 0.9 um up to 1.05 um; beyond, ice and water absorb and nothing is known here.

A kind of particle is named ``ice 30`` or ``water 8``: phase and effective radius [um].

**Henyey and Greenstein's phase function** with the tables' asymmetry stands for the true one. It has no halo (the
22 deg one of smooth crystals is 1.5 to 3 times the light around it in a ring 2 deg wide; the tables are for rough
crystals, which have none), no rainbow or glory (two to four times it, within 5 deg of the direction away from the Sun),
and too weak a forward peak: within 2 deg of the Sun light scattered once is too dark by an order. Between 20 and
150 deg it is within some 30 per cent of the phase function of rough crystals, so that a layer's radiance is uncertain
by as much in a single direction, by far less in the mean over directions.

In the infrared what a layer scatters is left out (the emissivity rule): it absorbs and emits, and lets through the
rest. That takes some 5 % off the opacity of ice in windows. Ice of 0.2 um and less has no infrared here: at the
mesopause (130 to 150 K) an optical depth of 1e-4 would add 1e-4 of the radiance of the ground.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.tables import json_object
from horizonval.spec.earth import FINE_ICE_UM

_TABLE = "cloud_optics.json"
LONGEST_UM = 1.05
SHORTEST_UM = 0.2
REFERENCE_UM = 0.55


def particle(phase: str, effective_radius_um: float) -> str:
    """Return the name of a kind of particle."""
    return f"{phase} {effective_radius_um:g}"


def is_particle(kind: str) -> bool:
    """Return whether a kind of particle is one of thin cloud."""
    return kind.split(" ")[0] in ("ice", "water")


def sunlit(kind: str, wavelength_um: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return extinction and scattering per extinction at 550 nm, and asymmetry, one entry per wavelength.

    Raises
    ------
    UserError
        Wavelength outside 0.2 to 1.05 um.
    """
    wavelength = np.asarray(wavelength_um, dtype=np.float64)
    if wavelength.size and not (wavelength.min() >= SHORTEST_UM and wavelength.max() <= LONGEST_UM):
        raise UserError(
            f"no optical properties of thin cloud at {wavelength.min():g} to {wavelength.max():g} um",
            expected=f"wavelengths within {SHORTEST_UM:g} to {LONGEST_UM:g} um",
            fix="or leave out [[layer]]",
        )
    name, radius = _table(kind)
    table = json_object(_TABLE)[name]
    known = np.log(np.array(table["wavelength_um"]))

    def at(values: FloatArray, ln_wavelength: FloatArray) -> FloatArray:
        return np.asarray(np.interp(ln_wavelength, known, values))

    if name == "fine_ice":
        relative = np.exp(_by_radius(table, np.log(np.array(table["extinction_rel_550"])), radius))
        extinction = np.exp(at(np.log(relative), np.log(wavelength)))
        albedo = np.ones_like(extinction)
    else:
        mass = _by_radius(table, np.array(table["mass_extinction_m2_kg"]), radius)
        extinction = at(mass, np.log(wavelength)) / at(mass, np.log(np.array(REFERENCE_UM)))
        albedo = 1.0 - at(_by_radius(table, np.array(table["one_minus_ssa"]), radius), np.log(wavelength))
    asymmetry = at(_by_radius(table, np.array(table["asymmetry"]), radius), np.log(wavelength))
    return extinction, extinction * albedo, asymmetry


def infrared_absorption(kind: str, wavelength_um: ArrayLike) -> FloatArray:
    """Return the absorption in the infrared per extinction at 550 nm, one entry per wavelength, by RRTMG's bands."""
    wavenumber = 1e4 / np.asarray(wavelength_um, dtype=np.float64)
    name, radius = _table(kind)
    if name == "fine_ice":
        return np.zeros_like(wavenumber)
    everything = json_object(_TABLE)
    table, edges = everything[name], np.array(everything["rrtmg_edges_per_cm"], dtype=np.float64)
    mass = _by_radius(table, np.array(table["mass_extinction_m2_kg"]), radius)
    reference = np.interp(np.log(REFERENCE_UM), np.log(np.array(table["wavelength_um"])), mass)
    absorbed = _by_radius(table, np.array(table["infrared_absorption_m2_kg"]), radius)
    band = np.clip(np.searchsorted(edges, wavenumber, side="right") - 1, 0, len(edges) - 2)
    return np.asarray(absorbed[band] / reference)


def _table(kind: str) -> tuple[str, float]:
    """Return the name of a kind's table, and its effective radius [um]."""
    phase, radius = kind.split(" ")
    value = float(radius)
    return ("fine_ice" if phase == "ice" and value <= FINE_ICE_UM else phase), value


def _by_radius(table: dict[str, Any], values: FloatArray, radius_um: float) -> FloatArray:
    """Return rows of a table at an effective radius."""
    radii = np.log(np.array(table["effective_radius_um"], dtype=np.float64))
    x = np.clip(np.interp(np.log(radius_um), radii, np.arange(len(radii))), 0.0, len(radii) - 1.0)
    i = min(int(x), len(radii) - 2)
    return np.asarray(values[i] + (values[i + 1] - values[i]) * (x - i))
