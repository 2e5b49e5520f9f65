"""Radiance along given rays, without camera or film: scattered sunlight, thermal bands, and thermal rays to clouds."""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.earth.column import OpticalModel
from horizonval.earth.surface.ground_emission import ground_k
from horizonval.renderer.backend import activate
from horizonval.renderer.kernel.batching import RAY_TABLE, TableSize, make_batches
from horizonval.renderer.kernel.march import march
from horizonval.renderer.planet import Planet
from horizonval.renderer.refraction import BendingField, apparent_planet, ray_end, to_apparent_radius
from horizonval.renderer.scattering.shells import Quality
from horizonval.renderer.tables import table_of, vectors
from horizonval.renderer.thermal.emission_march import AirColumns, ColumnBatch, Stations, march_emission
from horizonval.renderer.thermal.emission_table import GroundSource, kinds_of, mirrored, places_below
from horizonval.renderer.types import Vec

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
        Evaluations along each ray. The default leaves an error below 1e-5, plus that of the tables.
    scattering : Quality, optional
        Of the tables of light scattered more than once; None for single scattering.
    progress : Progress, optional
    polar_radius_m : float, optional
        Of an oblate planet; the columns then lie over geodetic height.
    table : TableSize
        Resolution of the Sun's optical depths.

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
        radiance, _ = march(planet, model.top_m, batch, o, d, s, to_ground, nodes)
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
        Evaluations along each ray. The default is within 1e-4 of the limit, except in the faintest air.
    round_sky : bool
        Whether the sky that the ground reflects is marched over a round planet instead of plane layers. Exact for
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

    Parameters, result and errors as of :func:`thermal_radiance`; ``distance_m``, shape (n,): from the observer to the
    cloud, with refraction along the straight line of the apparent ray.
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
