"""Thermal radiance along rays that end on cloud tops: black bodies as warm as the air around them."""

from __future__ import annotations

import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.renderer.planet import Planet
from horizonval.renderer.plugin.backend import activate
from horizonval.renderer.rays.radiance import check_observers, unit_directions
from horizonval.renderer.rays.thermal_radiance import NODES
from horizonval.renderer.refraction.apparent_radius import apparent_planet
from horizonval.renderer.tables import table_of, vectors
from horizonval.renderer.thermal.emission_columns import AirColumns
from horizonval.renderer.thermal.emission_march import Stations, march_emission

BEYOND_M = 1.0
"""The march wants a second station; it stands so far beyond the first and is not read."""


def cloud_top_radiance(
    model: OpticalModel,
    radius_m: float,
    observer_m: FloatArray,
    direction: FloatArray,
    distance_m: FloatArray,
    *,
    polar_radius_m: float | None = None,
    nodes: int = NODES,
) -> dict[str, FloatArray]:
    """Return the radiance of every thermal band of a model along rays that end on opaque clouds inside the air.

    Parameters
    ----------
    model : OpticalModel
        Its ``thermal`` bands are used, and its ``refractivity`` if there is one.
    radius_m, polar_radius_m : float
        Of the planet, at the equator and at the poles.
    observer_m, direction : ndarray, shape (n, 3)
        As in :func:`horizonval.renderer.rays.thermal_radiance.thermal_radiance`.
    distance_m : ndarray, shape (n,)
        From the observer to the cloud; with refraction along the straight line of the apparent ray.
    nodes : int
        Evaluations along each ray.

    Returns
    -------
    dict of ndarray, shape (n,)
        W m-2 sr-1, by band name.

    Raises
    ------
    UserError
        An observer below the ground; a zero or non-finite vector.
    """
    activate()
    direction = unit_directions(direction, "dir")
    check_observers(observer_m, radius_m, polar_radius_m)
    apparent, air = apparent_planet(model, Planet(radius_m, polar_radius_m or radius_m))
    o, d = vectors(observer_m), vectors(direction)
    o = o if air is None else air.apparent_position(o)
    end = table_of(mi.Float64, np.asarray(distance_m, dtype=np.float64))
    stations = Stations(end, end + BEYOND_M, 2, 1)
    count = len(direction)
    out: dict[str, FloatArray] = {}
    for band in model.thermal:
        columns = AirColumns.of(band, air)
        radiance = np.zeros(count)
        for batch in columns.batches():
            _, _, at = march_emission(apparent, columns.top_m, batch, o, d, mi.Bool(False), nodes, stations)
            assert at is not None
            radiance += sum(np.array(part)[:count] for part in at)
        out[band.name] = radiance
    return out
