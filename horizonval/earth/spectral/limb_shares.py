"""How much each RRTMG band adds to what a sensor band sees of the limb: a quick estimate, good to a few per cent.

Rays through the US standard atmosphere, straight and over a round Earth, in shells between the levels of its
absorption;
tau of a shell from the mean of the absorption at its faces, its source that of its mean temperature. A ray with a
negative height meets a black ground.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.gases import afgl
from horizonval.earth.gases.gas_state import GasState
from horizonval.earth.spectral.planck import radiance_per_wavenumber
from horizonval.earth.spectral.thermal_absorption import GPoints

_RADIUS_M = 6.371e6
_CLIMATE = "us_standard"


def limb_radiances(points: GPoints, height_m: FloatArray, air: GasState | None = None) -> FloatArray:
    """Return the radiance of every g point [W m-2 sr-1] along rays.

    Parameters
    ----------
    points : GPoints
    height_m : ndarray, shape (n,)
        Tangent heights below 100 km, or below 0 (down to minus the Earth's radius, straight down) impact parameter less
        radius.
    air : GasState, optional
        One column; default the US standard atmosphere with today's halocarbons.

    Returns
    -------
    ndarray, shape (n, g)
    """
    if air is None:
        air = afgl.state(_CLIMATE, afgl.levels_m()).with_halocarbons()
    levels, temperature, ln_k = air.altitude_m, air.temperature_k, points.ln_absorption(air)
    rows = [_ray(points, float(h), levels, temperature, ln_k) for h in np.asarray(height_m, dtype=np.float64)]
    return np.stack(rows)


def _ray(points: GPoints, height_m: float, levels: FloatArray, temperature: FloatArray, ln_k: FloatArray) -> FloatArray:
    z = np.concatenate([[max(height_m, 0.0)], levels[levels > max(height_m, 0.0)]])
    k = np.exp(np.stack([np.interp(z, levels, row) for row in ln_k]))
    t = np.interp(z, levels, temperature)
    path = np.sqrt(np.maximum((_RADIUS_M + z) ** 2 - (_RADIUS_M + height_m) ** 2, 0.0))
    depth = 0.5 * (k[:, 1:] + k[:, :-1]) * np.diff(path)
    source = _source(points, 0.5 * (t[1:] + t[:-1]))
    near = depth[:, ::-1]
    order = near if height_m < 0 else np.concatenate([near, depth], axis=1)
    shells = source[:, ::-1] if height_m < 0 else np.concatenate([source[:, ::-1], source], axis=1)
    passed = np.exp(-np.concatenate([np.zeros((len(k), 1)), np.cumsum(order, axis=1)], axis=1))
    total = np.sum(shells * (passed[:, :-1] - passed[:, 1:]), axis=1)
    return total + (_source(points, t[:1])[:, 0] * passed[:, -1] if height_m < 0 else 0.0)


def _source(points: GPoints, kelvin: FloatArray) -> FloatArray:
    """Return S of every g point, shape (g, n)."""
    return points.weight_per_cm @ radiance_per_wavenumber(points.wavenumber_per_cm[:, None], kelvin)
