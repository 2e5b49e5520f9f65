"""Thermal absorption of air that has no table of its own, from the tables of the six AFGL climates.

A g point's absorption per molecule of air follows from pressure, temperature and the gases. At each pressure of the new
profile it is read from all six climates and laid through them as a function of temperature T and ozone's share o::

    ln(k / n) = mean + a (T - mean T) / 10 K + b (ln o - mean ln o) / 0.3 + what is left, by inverse squares of distance

a and b by least squares, held back a little (ridge 0.2), so that six points do not make them wild. What the line leaves
over at the six climates is spread by the inverse square of the distance in the same two coordinates: a profile that is
one of the climates gets that climate's own absorption. Beyond the climates the line goes on for 15 K and 0.45 in ln o,
then stays. Water vapour comes along as it does with temperature among the climates; carbon dioxide is the scene's.

How good that is, found by leaving one climate out and predicting it from the other five (limb radiance, US standard,
tropical, midlatitude winter and both subarctic climates, by bands; subarctic winter lies 20 K outside of the five):

============== ======================== ============ ============
band           ground to 30 km          30 to 50 km  60 km
============== ======================== ============ ============
14.0-16.3 um   0.4 %                    2 %          2 %
8-14 um        5 %, at 6 km 7 %         7 %          6 %
10.5-12.5 um   6 %, at 6 to 16 km 20 %  8 %          6 %
============== ======================== ============ ============
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.profiles import AtmosphereProfile, profile
from horizonval.earth.spectral import thermal_absorption
from horizonval.earth.spectral.thermal_absorption import GPoints
from horizonval.earth.tables import npz

_UNIT_K, _UNIT_LN_OZONE = 10.0, 0.3
_BEYOND = 1.5
"""How far beyond the climates the line goes on, in the units above."""
_RIDGE = 0.2
_SAME = 1e-9
"""Square of a distance that counts as none."""


def ln_absorption(
    points: GPoints, state: AtmosphereProfile, co2_ppm: float, climates: Sequence[str] | None = None
) -> FloatArray:
    """Return the logarithm of the absorption [1/m] of air with a given state, shape (g, n).

    Parameters
    ----------
    points : GPoints
    state : AtmosphereProfile
        On n altitudes; pressure, temperature, air and ozone are used.
    co2_ppm : float
        Of the lower atmosphere.
    climates : sequence of str, optional
        Which to borrow from; default all six.
    """
    names = thermal_absorption.climates() if climates is None else climates
    # Pressure falls with altitude; np.interp wants rising abscissae.
    at = -np.log(state.pressure_pa)
    known = [_climate(name) for name in names]
    place = np.stack([_coordinates(np.interp(at, c[0], c[1]), np.interp(at, c[0], c[2])) for c in known])
    absorbed = []
    for name, (level, _, _, ln_air) in zip(names, known, strict=True):
        per_molecule = points.ln_absorption({name: 1.0}, co2_ppm) - ln_air
        absorbed.append([np.interp(at, level, row) for row in per_molecule])
    ln_k = np.array(absorbed)
    target = _coordinates(state.temperature_k, np.log(state.number_density_o3 / state.number_density_air))
    return _interpolated(place, ln_k, target) + np.log(state.number_density_air)


def _coordinates(temperature_k: FloatArray, ln_ozone: FloatArray) -> FloatArray:
    """Return the two coordinates, shape (2, n)."""
    return np.stack([temperature_k / _UNIT_K, ln_ozone / _UNIT_LN_OZONE])


@cache
def _climate(name: str) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return -ln of pressure, temperature, ln of ozone's share, and ln of the air's density at the tables' levels."""
    table, i = npz("thermal_ck.npz"), thermal_absorption.climates().index(name)
    levels = thermal_absorption.levels_m()
    pressure, air = (
        np.asarray(table[key][i], dtype=np.float64) for key in ("pressure_pa", "air_number_density_per_m3")
    )
    gases = profile(name).at(levels)
    ozone = np.log(gases.number_density_o3 / gases.number_density_air)
    return -np.log(pressure), thermal_absorption.temperature_k(name, levels), ozone, np.log(air)


def _interpolated(place: FloatArray, values: FloatArray, target: FloatArray) -> FloatArray:
    """Return values (c, g, n) known at places (c, 2, n) laid through to other places (2, n), shape (g, n)."""
    x, y = place - place.mean(axis=0), values - values.mean(axis=0)
    to = np.clip(target - place.mean(axis=0), x.min(axis=0) - _BEYOND, x.max(axis=0) + _BEYOND)
    squares = np.einsum("cin,cjn->nij", x, x) + _RIDGE * np.eye(2)
    slope = np.linalg.solve(squares, np.einsum("cin,cgn->nig", x, y))
    distance = ((place - target) ** 2).sum(axis=1)
    weight = 1.0 / np.maximum(distance, _SAME)
    residual = y - np.einsum("cin,nig->cgn", x, slope)
    spread = np.einsum("cn,cgn->gn", weight / weight.sum(axis=0), residual)
    return values.mean(axis=0) + np.einsum("in,nig->gn", to, slope) + spread
