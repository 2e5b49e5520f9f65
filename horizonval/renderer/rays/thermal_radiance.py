"""Thermal radiance along given rays through air that varies with latitude: no camera, no tables."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.earth.column import OpticalModel
from horizonval.earth.surface.ground_emission import ground_k
from horizonval.renderer.planet import Planet
from horizonval.renderer.plugin.backend import activate
from horizonval.renderer.rays.radiance import check_observers, unit_directions
from horizonval.renderer.refraction.apparent_radius import apparent_planet
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.refraction.ray_end import ray_end
from horizonval.renderer.tables import vectors
from horizonval.renderer.thermal.emission_columns import AirColumns, ColumnBatch
from horizonval.renderer.thermal.emission_ground import GroundSource, kinds_of, mirrored, places_below
from horizonval.renderer.thermal.emission_march import march_emission
from horizonval.renderer.types import Vec

NODES = 256
BATCH = 65536
SKY_DIRECTIONS = 48
"""Zenith angles over which the sky is integrated."""

IntArray = NDArray[np.int64]


def thermal_radiance(
    model: OpticalModel,
    radius_m: float,
    observer_m: FloatArray,
    direction: FloatArray,
    *,
    sun_itrs: tuple[float, float, float] = (1.0, 0.0, 0.0),
    polar_radius_m: float | None = None,
    nodes: int = NODES,
    round_sky: bool = False,
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
    round_sky : bool
        Whether the sky that the ground reflects is marched over a round planet, and not that of plane layers. Exact for
        a uniform ground below air that is the same everywhere.

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
    bending = None if air is None else BendingField.of(air)
    sun = np.asarray(sun_itrs, dtype=np.float64)
    out: dict[str, FloatArray] = {}
    for band in model.thermal:
        assert model.emission is not None
        columns, source = AirColumns.of(band, air), GroundSource(band, model.emission)
        batches = list(columns.batches())
        sky = _marched_sky(apparent, columns, batches, nodes) if round_sky and model.emission.emissivity < 1.0 else None
        radiance = np.zeros(len(direction))
        for first in range(0, len(direction), BATCH):
            part = slice(first, first + BATCH)
            o, d = vectors(observer_m[part]), vectors(direction[part])
            o = o if air is None else air.apparent_position(o)
            mid, _, meets = apparent.chord(o, d)
            to_ground = meets & (mid > 0.0)
            ends = np.flatnonzero(np.array(to_ground))
            p, normal, up, vertical = _ground_points(apparent, bending, o, d, ends)
            cosine = -np.sum(normal * direction[part][ends], axis=1)
            first_g = 0
            for batch in batches:
                more, through, _ = march_emission(apparent, columns.top_m, batch, o, d, to_ground, nodes)
                radiance[part] += sum(np.array(m) for m in more)
                if ends.size:
                    points = slice(first_g, first_g + batch.used)
                    mirror = np.zeros((batch.used, len(ends)))
                    if source.mirrors:
                        above, _, _ = march_emission(apparent, columns.top_m, batch, p, up, mi.Bool(False), nodes // 2)
                        mirror = np.stack([np.array(a) for a in above])
                    reflected = source.sky_at(vertical, points) if sky is None else sky[points]
                    below = ground_radiance(source, points, vertical, cosine, sun, mirror, reflected)
                    radiance[first + ends] += sum(np.array(t)[ends] * b for t, b in zip(through, below, strict=True))
                first_g += batch.used
        out[band.name] = radiance
    return out


def _marched_sky(planet: Planet, columns: AirColumns, batches: Sequence[ColumnBatch], nodes: int) -> FloatArray:
    """Return the mean radiance of the sky over the ground, irradiance over pi, shape (g, 1): Gauss quadrature."""
    x, w = np.polynomial.legendre.leggauss(SKY_DIRECTIONS)
    mu, w = 0.5 * (x + 1.0), 0.5 * w
    radius = planet.mean_radius_m
    o = vectors(np.tile([0.0, 0.0, radius], (len(mu), 1)))
    d = vectors(np.stack([np.sqrt(1.0 - mu**2), np.zeros_like(mu), mu], axis=1))
    sphere, down = Planet(radius, radius), []
    for batch in batches:
        above, _, _ = march_emission(sphere, columns.top_m, batch, o, d, mi.Bool(False), nodes)
        down += [np.array(a) for a in above]
    return np.array([[float(2.0 * np.sum(w * mu * a))] for a in down])


def _ground_points(
    planet: Planet, bending: BendingField | None, o: Vec, d: Vec, index: IntArray
) -> tuple[Vec, FloatArray, Vec, FloatArray]:
    """Return where some rays meet the ground among straight rays: points, normals (n, 3), mirrored directions.

    The last are the verticals (n, 3) of the places that bent rays come from: at grazing they lie up to a degree nearer.
    """
    at = mi.UInt32(index)
    if not index.size:
        return o, np.zeros((0, 3)), d, np.zeros((0, 3))

    def gather(v: Vec) -> Vec:
        x, y, z = (dr.gather(mi.Float64, c, at) for c in v)
        return x, y, z

    o, d = gather(o), gather(d)
    p, normal, up = mirrored(planet, o, d)
    mid, half, _ = planet.chord(o, d)
    vertical = ray_end(planet, bending, o, d, mid - half).vertical
    dr.eval(p, normal, up, vertical)
    return p, np.stack([np.array(c) for c in normal], axis=1), up, np.stack([np.array(c) for c in vertical], axis=1)


def ground_radiance(
    source: GroundSource,
    points: slice,
    vertical: FloatArray,
    cosine: FloatArray,
    sun: FloatArray,
    mirror: FloatArray,
    sky: FloatArray,
) -> FloatArray:
    """Return what leaves the ground, shape (g, n), for the g points of a slice.

    At verticals (n, 3) under view cosines (n,); ``mirror`` (g, n) is the air along the reflected rays, ``sky`` (g, n)
    or (g, 1) the mean radiance above.
    """
    emission = source.emission
    places = places_below(emission, vertical, sun)
    total = np.zeros_like(mirror)
    for kind in kinds_of(emission):
        e = source.emissivities(kind, cosine, points)
        above = mirror if kind == "water" else sky
        warm = source.black(ground_k(emission, kind, places), points)
        total += places.shares[kind] * (e * warm + (1.0 - e) * above)
    return total
