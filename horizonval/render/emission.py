"""Thermal radiance along given rays through air that varies with latitude: no camera, no tables."""

from __future__ import annotations

import drjit as dr
import numpy as np

from horizonval.earth.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.earth.emission import EmittingBand
from horizonval.earth.ground_emission import GroundEmission
from horizonval.earth.surface import GroundModel
from horizonval.render.backend import activate
from horizonval.render.emission_columns import AirColumns
from horizonval.render.emission_ground import (
    GroundSource,
    emissivities,
    kinds_of,
    shares,
    temperatures_k,
)
from horizonval.render.emission_march import march_emission
from horizonval.render.planet import Planet, along
from horizonval.render.radiance import check_observers, unit_directions, vectors
from horizonval.render.straightened import straighten

NODES = 256
BATCH = 65536


def thermal_radiance(
    model: OpticalModel,
    radius_m: float,
    observer_m: FloatArray,
    direction: FloatArray,
    *,
    sun_itrs: tuple[float, float, float] = (1.0, 0.0, 0.0),
    polar_radius_m: float | None = None,
    nodes: int = NODES,
    ground: GroundModel | None = None,
) -> dict[str, FloatArray]:
    """Return the radiance of every thermal band of a model along rays, ground included, clouds left out.

    Parameters
    ----------
    model : OpticalModel
        Its ``thermal`` bands and ``emission`` are used, and its ``refractivity`` if there is one.
    radius_m : float
        Radius of the planet, at the equator.
    observer_m, direction : ndarray, shape (n, 3)
        Planet-centred Earth-fixed axes, at or above the ground; directions need not be normalised.
    sun_itrs : tuple of float
        Towards the Sun: the hour of the day on land.
    polar_radius_m : float, optional
        Of an oblate planet; heights and latitudes are then geodetic.
    nodes : int
        Evaluations along each ray. The default is within 1e-4 of the limit where there is light to speak of.
    ground : GroundModel, optional
        Where the snow line lies; without it land has no seasonal snow.

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
    planet = Planet(radius_m, polar_radius_m or radius_m)
    air = None if model.refractivity is None else straighten(model, planet)
    apparent = planet if air is None else air.planet
    sun = np.asarray(sun_itrs, dtype=np.float64)
    out: dict[str, FloatArray] = {}
    for band in model.thermal:
        assert model.emission is not None
        columns, source = AirColumns.of(band, air), GroundSource.of(band, model.emission)
        chunks = list(columns.chunks())
        radiance = np.zeros(len(direction))
        for first in range(0, len(direction), BATCH):
            part = slice(first, first + BATCH)
            o, d = vectors(observer_m[part]), vectors(direction[part])
            o = o if air is None else air.raised(o)
            mid, half, meets = apparent.chord(o, d)
            to_ground = meets & (mid > 0.0)
            through = []
            for chunk in chunks:
                more, passed, _ = march_emission(apparent, columns.top_m, chunk, o, d, to_ground, nodes)
                radiance[part] += np.array(more)
                through += [np.array(t) for t in passed]
            ends = np.flatnonzero(np.array(to_ground))
            if ends.size:
                _, normal = apparent.height_and_normal(along(o, d, mid - half))
                dr.eval(normal)
                up = np.stack([np.array(c) for c in normal], axis=1)[ends]
                cosine = -np.sum(up * direction[part][ends], axis=1)
                below = ground_radiance(source, model.emission, ground, up, cosine, sun)
                radiance[first + ends] += np.sum(np.stack(through)[:, ends] * below, axis=0)
        out[band.name] = radiance
    return out


def ground_radiance(
    source: GroundSource,
    emission: GroundEmission,
    ground: GroundModel | None,
    normal: FloatArray,
    cosine: FloatArray,
    sun: FloatArray,
) -> FloatArray:
    """Return what leaves the ground per g point, shape (g, n), at unit normals (n, 3) under view cosines (n,)."""
    band: EmittingBand = source.band
    spline, sky = band.source_spline(), source.sky_at(normal[:, 2])
    kinds, warmth = shares(emission, ground, normal), temperatures_k(emission, normal, sun)
    total = np.zeros_like(sky)
    for kind in kinds_of(emission):
        e = emissivities(emission, kind, band.wavelength_um, cosine)
        total += kinds[kind] * (e * spline(warmth[kind]).T + (1.0 - e) * sky)
    return total
