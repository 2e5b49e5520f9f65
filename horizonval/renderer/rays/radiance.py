"""Scattered sunlight of every spectral node along given rays through layered air."""

from __future__ import annotations

import drjit as dr
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.earth.column import OpticalModel
from horizonval.renderer.kernel.batching import RAY_TABLE, TableSize, make_batches
from horizonval.renderer.kernel.march import march
from horizonval.renderer.planet import Planet
from horizonval.renderer.ray_path import SOLAR_CONCENTRATION
from horizonval.renderer.refraction.apparent_radius import to_apparent_radius
from horizonval.renderer.scattering.quality import Quality
from horizonval.renderer.tables import vectors

RAY_NODES = 2048


def radiance_along_rays(
    model: OpticalModel,
    radius_m: float,
    observer_m: FloatArray,
    direction: FloatArray,
    sun: FloatArray,
    nodes: int = RAY_NODES,
    scattering: Quality | None = None,
    progress: Progress | None = None,
    polar_radius_m: float | None = None,
    table: TableSize = RAY_TABLE,
) -> dict[str, FloatArray]:
    """Return the scattered sunlight of every spectral node along rays over a planet.

    Parameters
    ----------
    model : OpticalModel
    radius_m : float
        Radius of the planet, at the equator.
    observer_m : ndarray, shape (n, 3)
        Planet-centred, at or above the ground.
    direction, sun : ndarray, shape (n, 3)
        Need not be normalised.
    nodes : int
        Evaluations along each ray. The default leaves less than 1e-5 of error beside that of the tables.
    scattering : Quality, optional
        Of the tables of light scattered more than once; None for single scattering.
    progress : Progress, optional
        Told about tables that must be solved first.
    polar_radius_m : float, optional
        Of an oblate planet; the columns then lie over geodetic height.
    table : TableSize
        Resolution of the Sun's optical depths; that of images is made in a fraction of the time.

    Returns
    -------
    dict of ndarray, shape (n,)
        By node name: 1/sr for unit solar irradiance.

    Raises
    ------
    UserError
        An observer below the ground; a zero or non-finite vector.
    """
    direction = unit_directions(direction, "dir")
    sun = unit_directions(sun, "sun")
    check_observers(observer_m, radius_m, polar_radius_m)
    planet = Planet(radius_m, polar_radius_m or radius_m)
    o, d, s = vectors(observer_m), vectors(direction), vectors(sun)
    air = None
    if model.refractivity is not None:
        air = to_apparent_radius(model, planet)
        o, model, planet = air.apparent_position(o), air.model, air.planet
    ground_mid, _, meets = planet.chord(o, d)
    to_ground = meets & (ground_mid > 0.0)
    out: dict[str, FloatArray] = {}
    for group, batch in make_batches(model, planet, table, scattering, progress, air):
        radiance, _ = march(planet, model.top_m, batch, o, d, s, to_ground, nodes, SOLAR_CONCENTRATION)
        dr.eval(radiance)
        for node, value in zip(group, radiance, strict=False):
            out[node.name] = np.broadcast_to(np.array(value, dtype=float), (len(observer_m),)).copy()
    return out


def check_observers(observer_m: FloatArray, radius_m: float, polar_radius_m: float | None) -> None:
    """Refuse observers (n, 3) below the ground."""
    if not np.all(np.isfinite(observer_m)):
        raise UserError("observer position is not finite", expected="finite kilometres")
    stretched = observer_m * np.array([1.0, 1.0, radius_m / (polar_radius_m or radius_m)])
    below = np.linalg.norm(stretched, axis=1) < radius_m * (1.0 - 1e-9)
    if np.any(below):
        raise UserError(
            f"ray {int(np.argmax(below)) + 1} starts below the ground",
            expected=f"observers at least {radius_m / 1e3:g} km from the centre",
        )


def unit_directions(v: FloatArray, name: str) -> FloatArray:
    """Return rows (n, 3) with length 1; refuse what has none."""
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(v, axis=1)
    bad = ~np.isfinite(norm) | (norm == 0.0)
    if np.any(bad):
        raise UserError(f"{name}_x, {name}_y, {name}_z of ray {int(np.argmax(bad)) + 1} is no direction")
    return v / norm[:, None]
