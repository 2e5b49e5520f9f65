r"""Radiance of the clear limb in a thermal band, integrated along exact rays.

**Integral.** With ``u`` below, the optical depth of a g point is the integral of ``k (ds/du) du``, which is smooth. The
path is cut at shells about 1 km apart; every piece has its depth ``D`` and its mean source ``M = integral of S dtau /
D`` by Simpson's rule in u. Within the piece the source is the parabola in tau through its values ``S0`` and ``S1`` at
the ends with that mean::

    integral of S exp(-tau) dtau = S0 (1 - b) + S1 (b - e) + (M - (S0 + S1)/2) 6 [(1 + e) - 2 b] / D,
    e = exp(-D),  b = (1 - e) / D

which is exact for thin pieces and tends to S0 for thick ones.

**Rays.** A ray lies in the vertical plane of its azimuth about the geocentric nadir ``z``,
``d = cos(theta) z + sin(theta) m``. Turned outward by ``dtheta`` its lowest point, at distance ``s_t``, rises by
``s_t (n . e) dtheta``, with ``n`` the ellipsoid's normal there and ``e`` the direction that ``d`` turns to: Newton's
method finds the angle of a height. Along the ray the height ``z`` is convex with its minimum ``h`` at the lowest point,
so that in the signed root ``u = +-sqrt(z - h)`` (minus on the observer's side) distance and latitude are smooth: on a
sphere ``s - s_t = u sqrt(2 (R + h) + u^2)``. A polynomial through exact points follows both to the millimetre.

**Refraction.** A ray in layered air keeps ``n (R + z) sin(theta)`` (Bouguer). With the height
``y = z + N(z) (R + z)``, N = n - 1, it is a straight line past a planet that is ``N(0) R`` larger, and its path is
``ds = (dz/dy) dt`` of the straight one's: extinction over y times dz/dy gives the bent ray's optical depth. A line's
lowest y is its distance from the geometric planet as seen from outside the air: what a horizon sensor takes as height.
Neglected: the turn of the verticals along the ray (1.1 deg at most, for a ray that grazes the ground; 3 arcsec at
40 km), by which a ray sees air a little farther on.

**Ground.** A ground of emissivity e and temperature T sends ``e S(T)``, and reflects ``1 - e`` of the sky's mean
radiance. Rays 10 km below the hard horizon leave the ground at 3 deg from the level, through ten to twenty times the
air of a vertical one: almost none of the reflected radiance gets out, so the sky is computed for some latitudes and
heights only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from horizonval.core.arrays import FloatArray
from horizonval.earth.atmosphere.emission import EmittingBand
from horizonval.earth.column import OpticalModel
from horizonval.earth.surface.ground_emission import (
    EmittingPlaces,
    GroundEmission,
    emitting_places,
    ground_emissivity,
    ground_k,
)
from horizonval.earth.weather.field import ColumnMap
from horizonval.geometry.ellipsoid import (
    Ellipsoid,
    geocentric_nadir,
    geodetic_from_itrs,
    surface_distance,
    surface_normal,
    tangent_point,
)
from horizonval.geometry.frames import north_east
from horizonval.geometry.horizon import horizon_by_azimuth

_NODES = 12
"""Points of the polynomials. 12 leave 0.1 mm of the distance from the lowest point on rays through 100 km of air."""


def directions(r_itrs: ArrayLike, azimuth_rad: ArrayLike, angle_rad: ArrayLike) -> FloatArray:
    """Return unit vectors, shape (..., 3), at azimuths (north to east) and angles [rad] about the geocentric nadir."""
    north, east = north_east(r_itrs)
    azimuth = np.asarray(azimuth_rad, dtype=np.float64)[..., None]
    angle = np.asarray(angle_rad, dtype=np.float64)[..., None]
    return np.cos(angle) * geocentric_nadir(r_itrs) + np.sin(angle) * (np.cos(azimuth) * north + np.sin(azimuth) * east)


def angle_of_height(r_itrs: ArrayLike, ellipsoid: Ellipsoid, azimuth_rad: ArrayLike, height_m: ArrayLike) -> FloatArray:
    """Return the angle [rad] from the geocentric nadir at which a ray's lowest geodetic height is ``height_m``.

    Azimuths and heights broadcast; heights below the observer's, negative for the depth of a chord. Right to 1e-3 m of
    height.
    """
    r = np.asarray(r_itrs, dtype=np.float64)
    azimuth, height = np.broadcast_arrays(
        np.asarray(azimuth_rad, dtype=np.float64), np.asarray(height_m, dtype=np.float64)
    )
    angle = horizon_by_azimuth(r, ellipsoid, azimuth)
    for _ in range(8):
        d = directions(r, azimuth, angle)
        s, lowest = tangent_point(r, d, ellipsoid)
        outward = directions(r, azimuth, angle + 0.5 * np.pi)
        rise = s * np.einsum("...i,...i->...", surface_normal(r + s[..., None] * d, ellipsoid), outward)
        angle = angle + (height - lowest) / rise
        if np.all(np.abs(height - lowest) < 1e-3):
            break
    return angle


@dataclass(frozen=True)
class RayPath:
    """Rays of one lowest height at several azimuths, up to ``top_m``, as polynomials in ``x = u / reach``.

    ``distance`` and ``sin_latitude``: coefficients, shape (azimuths, k), lowest power first; metres from the lowest
    point, and sine of the geodetic latitude. ``level``: those of the first two components of the ellipsoid's normal,
    shape (azimuths, k, 2); None where nobody asked for places.
    """

    lowest_m: float
    reach: float
    top_m: float
    distance: FloatArray
    sin_latitude: FloatArray
    level: FloatArray | None = None

    def part(self, few: slice) -> RayPath:
        """Return the rays of some azimuths."""
        return replace(
            self,
            distance=self.distance[few],
            sin_latitude=self.sin_latitude[few],
            level=None if self.level is None else self.level[few],
        )

    def metres_per_u(self, u: FloatArray) -> FloatArray:
        """Return ds/du [m^0.5], shape (azimuths, points)."""
        power = np.arange(1, self.distance.shape[1])
        return _polynomial(self.distance[:, 1:] * power, u / self.reach) / self.reach

    def sine_at(self, u: FloatArray) -> FloatArray:
        """Return the sine of the geodetic latitude, shape (azimuths, points)."""
        return _polynomial(self.sin_latitude, u / self.reach)

    def normal_at(self, u: FloatArray) -> FloatArray:
        """Return the ellipsoid's unit normals, shape (azimuths, points, 3): places by which columns are found."""
        assert self.level is not None
        x = u / self.reach
        return np.stack([_polynomial(self.level[..., k], x) for k in (0, 1)] + [self.sine_at(u)], axis=-1)


def ray_paths(
    r_itrs: ArrayLike,
    ellipsoid: Ellipsoid,
    azimuth_rad: ArrayLike,
    height_m: ArrayLike,
    top_m: float,
    *,
    with_places: bool = False,
) -> list[RayPath]:
    """Return, for every lowest height, the course between the passages of ``top_m`` of one ray per azimuth.

    Azimuths of shape (azimuths,), heights of shape (heights,), below the observer's and the top. ``with_places``: for
    air that varies with longitude.
    """
    r = np.asarray(r_itrs, dtype=np.float64)
    heights = np.asarray(height_m, dtype=np.float64)
    azimuth = np.asarray(azimuth_rad, dtype=np.float64)[:, None]
    d = directions(r, azimuth, angle_of_height(r, ellipsoid, azimuth, heights))
    s, lowest = tangent_point(r, d, ellipsoid)
    reach = np.sqrt(top_m - heights)
    # Even in number: none falls on the lowest point, where the root would magnify rounding.
    node = np.cos(np.pi * (np.arange(_NODES) + 0.5) / _NODES)
    along = node * (reach * np.sqrt(2.0 * (ellipsoid.a_m + heights) + reach**2))[:, None]
    place = r + (s[..., None] + along)[..., None] * d[..., None, :]
    latitude, longitude, z = geodetic_from_itrs(place, ellipsoid)
    u = np.copysign(np.sqrt(np.maximum(z - lowest[..., None], 0.0)), along)
    matrix = (u / reach[:, None])[..., None] ** np.arange(_NODES)
    values = np.stack([np.broadcast_to(along, z.shape), np.sin(latitude)], axis=-1)
    fitted = np.linalg.solve(matrix, values)
    level = None
    if with_places:
        across = np.stack([np.cos(longitude), np.sin(longitude)], axis=-1) * np.cos(latitude)[..., None]
        level = np.linalg.solve(matrix, across)
    return [
        RayPath(
            float(h),
            float(reach[n]),
            float(top_m),
            fitted[:, n, :, 0],
            fitted[:, n, :, 1],
            None if level is None else level[:, n],
        )
        for n, h in enumerate(heights.tolist())
    ]


def ground_points(r_itrs: ArrayLike, ellipsoid: Ellipsoid, azimuth_rad: FloatArray, height_m: float) -> FloatArray:
    """Return where rays of chord depth ``-height_m`` meet the ground [m], shape (azimuths, 3)."""
    r = np.asarray(r_itrs, dtype=np.float64)
    d = directions(r, azimuth_rad, angle_of_height(r, ellipsoid, azimuth_rad, height_m))
    return r + surface_distance(r, d, ellipsoid)[:, None] * d


def _polynomial(coefficients: FloatArray, x: FloatArray) -> FloatArray:
    total = np.zeros((len(coefficients), len(x)))
    for k in range(coefficients.shape[1] - 1, -1, -1):
        total = total * x + coefficients[:, k, None]
    return total


@dataclass(frozen=True)
class StraightHeights:
    """Heights over the larger planet of the module text, and how they stretch.

    ``rise_m``: by how much it is larger; ``top_m``: of the air; ``altitude_m``, ``height_m``: true heights and those
    over the larger planet; ``stretch``: dz/dy.
    """

    rise_m: float
    top_m: float
    altitude_m: FloatArray
    height_m: FloatArray
    stretch: FloatArray

    def of(self, altitude_m: FloatArray) -> FloatArray:
        """Return heights over the larger planet."""
        return np.interp(altitude_m, self.altitude_m, self.height_m)


def straight_heights(model: OpticalModel, mean_radius_m: float) -> StraightHeights:
    """Return the heights of a model's air; those of straight rays where its light is not bent."""
    z = model.altitude_m
    if model.refractivity is None:
        return StraightHeights(0.0, model.top_m, z, z, np.ones_like(z))
    excess = model.refractivity - model.refractivity[-1]
    y = z + excess * (mean_radius_m + z)
    rise = float(y[0])
    return StraightHeights(rise, float(y[-1]) - rise, z, y - rise, 1.0 / np.gradient(y, z))


SHELL_M = 1000.0
"""Thickness of the shells from 17 to 30 km; half of it and a quarter below 17 and 8 km, where water vapour changes
fast, two, four and eight times it above 30, 60 and 80 km."""

_THIN = 0.02
_OPAQUE = 80.0
_AZIMUTHS_AT_ONCE = 4
"""What is at hand for so many stays in a processor's cache: four fifths of the time of all at once."""


def shells_m(top_m: float, step_m: float = SHELL_M) -> FloatArray:
    """Return the heights [m] at which paths are cut, from 0 to ``top_m``."""
    parts = [
        np.arange(0.0, 8e3, 0.25 * step_m),
        np.arange(8e3, 17e3, 0.5 * step_m),
        np.arange(17e3, 30e3, step_m),
        np.arange(30e3, 60e3, 2.0 * step_m),
        np.arange(60e3, 80e3, 4.0 * step_m),
        np.arange(80e3, max(top_m, 80e3), 8.0 * step_m),
    ]
    shells = np.concatenate(parts)
    return np.append(shells[shells < top_m], top_m)


def layer_edges_m(band: EmittingBand, altitude_m: FloatArray) -> FloatArray:
    """Return the heights at which paths must be cut besides: where layers of thin cloud begin, bend and end."""
    inside = np.nonzero(band.layer_per_m.any(axis=0))[0] if len(band.layer_per_m) else np.zeros(0, dtype=np.intp)
    if not len(inside):
        return np.zeros(0)
    beside = np.concatenate([inside - 1, inside, inside + 1])
    return np.asarray(altitude_m[np.unique(np.clip(beside, 0, len(altitude_m) - 1))])


@dataclass(frozen=True)
class PointsInAir:
    """Points of rays, shape (points, azimuths), between columns and heights of a medium; one azimuth in uniform air.

    ``columns``: the columns that they lie between. ``weights``: sparse matrix, shape (points x azimuths, columns x
    heights), with the neighbours of each point.
    """

    shape: tuple[int, int]
    columns: NDArray[np.intp]
    weights: csr_array


class BandMedium:
    """Extinction and source of one band, laid out for rays: g point last. ``heights``: None where no light is bent.

    A column is computed when rays first pass it.
    """

    def __init__(self, band: EmittingBand, heights: StraightHeights | None = None) -> None:
        self._band, self._source = band, band.source_spline()
        self.count, z = band.count, band.altitude_m
        self.altitude_m = z if heights is None else heights.of(z)
        self._stretch = np.ones_like(z) if heights is None else np.interp(z, heights.altitude_m, heights.stretch)
        # Side by side: both of a point's neighbour lie together.
        self._both = np.empty((len(band.temperature_k), len(z), 2 * band.count))
        self._made = np.zeros(len(band.temperature_k), dtype=bool)
        self.sin_latitude = band.sin_latitude
        self.edges_m = layer_edges_m(band, self.altitude_m)
        self.column_map = band.column_map

    @property
    def absorbs(self) -> bool:
        """Whether there is anything in it that a ray could notice."""
        return bool(self._band.ln_extinction.max() > math.log(1e-30) or len(self._band.layers))

    @property
    def top_m(self) -> float:
        """Vacuum above."""
        return float(self.altitude_m[-1])

    @property
    def is_uniform(self) -> bool:
        """Whether the air is the same everywhere."""
        return self.column_map is None and len(self.sin_latitude) == 1

    @property
    def layout(self) -> tuple[bytes, ...]:
        """What points in it depend on: where columns, heights and edges of layers are."""
        lattice = self.column_map
        columns = [] if lattice is None else [lattice.axes, np.array([lattice.half, lattice.count])]
        return tuple(part.tobytes() for part in (self.altitude_m, self.sin_latitude, self.edges_m, *columns))

    def points(self, path: RayPath, u: FloatArray) -> PointsInAir:
        """Return where points of rays lie: between two heights, and two rows of latitude or four columns of a map."""
        height = np.maximum(path.lowest_m + u * u, 0.0)
        i = np.clip(np.searchsorted(self.altitude_m, height, side="right") - 1, 0, len(self.altitude_m) - 2)
        w = (height - self.altitude_m[i]) / (self.altitude_m[i + 1] - self.altitude_m[i])
        columns = self._columns(path, u)
        shape = (len(u), columns[0][1].shape[0])
        index, weight = np.empty((*shape, 2 * len(columns)), dtype=np.int32), np.empty((*shape, 2 * len(columns)))
        passed = np.zeros(len(self._made), dtype=bool)
        for n, (column, share) in enumerate(columns):
            passed[column] = True
            index[..., 2 * n] = (column * len(self.altitude_m) + i).T
            index[..., 2 * n + 1] = index[..., 2 * n] + 1
            weight[..., 2 * n] = (share * (1.0 - w)).T
            weight[..., 2 * n + 1] = (share * w).T
        ends = np.arange(0, index.size + 1, index.shape[-1], dtype=np.int32)
        nodes = len(self._made) * len(self.altitude_m)
        matrix = csr_array((weight.ravel(), index.ravel(), ends), shape=(len(ends) - 1, nodes))
        return PointsInAir(shape, np.flatnonzero(passed), matrix)

    def at(self, points: PointsInAir) -> tuple[FloatArray, FloatArray]:
        """Return extinction and source, shape (points, azimuths, g), by one product with a sparse matrix."""
        self._make(points.columns[~self._made[points.columns]])
        both = np.asarray(points.weights @ self._both.reshape(-1, 2 * self.count)).reshape(*points.shape, -1)
        return both[..., : self.count], both[..., self.count :]

    def _make(self, columns: NDArray[np.intp]) -> None:
        if len(columns):
            some, z = self._band.of_columns(columns), self._band.altitude_m
            self._both[columns, :, : self.count] = np.moveaxis(some.extinction_at(z), 0, -1) * self._stretch[:, None]
            self._both[columns, :, self.count :] = self._source(some.air_k(z))
            self._made[columns] = True

    def _columns(self, path: RayPath, u: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return the columns about the points of rays, and their weights, shape (azimuths, points) each."""
        if self.is_uniform:
            return [(np.zeros((1, len(u)), dtype=np.intp), np.ones((1, len(u))))]
        return self._rows(path, u) if self.column_map is None else self._corners(self.column_map, path, u)

    def _rows(self, path: RayPath, u: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return two rows of latitude."""
        step = self.sin_latitude[1] - self.sin_latitude[0]
        row = np.clip((path.sine_at(u) - self.sin_latitude[0]) / step, 0.0, len(self.sin_latitude) - 1)
        j = np.minimum(row.astype(np.intp), len(self.sin_latitude) - 2)
        v = row - j
        return [(j, 1.0 - v), (j + 1, v)]

    @staticmethod
    def _corners(lattice: ColumnMap, path: RayPath, u: FloatArray) -> list[tuple[np.ndarray, FloatArray]]:
        """Return four columns of a map.

        Written anew from the map's definition: the truth knows where columns stand, not how others read them.
        """
        normal = path.normal_at(u)
        along = normal @ lattice.axes.T
        plane = along[..., :2] / (1.0 + along[..., 2:])
        side = np.linspace(-lattice.half, lattice.half, lattice.count)
        plane = np.clip(plane, side[0], side[-1])
        low = np.clip(np.searchsorted(side, plane, side="right") - 1, 0, lattice.count - 2)
        share = (plane - side[low]) / (side[low + 1] - side[low])
        (i, j), (p, q) = np.moveaxis(low, -1, 0), np.moveaxis(share, -1, 0)
        return [
            ((j + b) * lattice.count + i + a, (p if a else 1.0 - p) * (q if b else 1.0 - q))
            for a in (0, 1)
            for b in (0, 1)
        ]


def limb_radiances(airs: Sequence[BandMedium], rays: Sequence[RayPath], *, step_m: float = SHELL_M) -> list[FloatArray]:
    """Return the radiance [W m-2 sr-1], shape (azimuths, heights), of rays past the ground, of each of several bands.

    The camera is above the air. ``step_m`` is the thickness of the shells; 1 km leaves 1e-4 of the plateau. Bands whose
    air has the same layout share the positions of points in it.
    """
    found = [np.zeros((len(rays[0].distance) if rays else 0, len(rays))) for _ in airs]
    for few in (slice(k, k + _AZIMUTHS_AT_ONCE) for k in range(0, len(found[0]) if airs else 0, _AZIMUTHS_AT_ONCE)):
        # One band after the other: the columns around a few azimuths stay in a processor's cache.
        passed: dict[tuple[bytes, ...], list[tuple[PointsInAir, FloatArray, FloatArray]]] = {}
        for air, radiance in zip(airs, found, strict=True):
            if air.layout not in passed:
                passed[air.layout] = [_through(air, path.part(few), step_m) for path in rays]
            for n, (points, metres_per_u, u) in enumerate(passed[air.layout]):
                radiance[few, n] = _integrate(*air.at(points), metres_per_u, u)[0].sum(axis=-1)
    return found


def _through(air: BandMedium, path: RayPath, step_m: float) -> tuple[PointsInAir, FloatArray, FloatArray]:
    """Return the points of rays past the ground, ds/du there, and u."""
    u = _cuts(path, path.lowest_m, step_m, air.edges_m)
    u = np.concatenate([-u[:0:-1], u])
    return air.points(path, u), path.metres_per_u(u).T[..., None], u


def ground_ray(air: BandMedium, path: RayPath, *, step_m: float = SHELL_M) -> tuple[FloatArray, FloatArray]:
    """Return path radiance [W m-2 sr-1] and transmission to the ground, shapes (azimuths, g).

    The rays' lowest height is negative: the depth of the chord.
    """
    u = -_cuts(path, 0.0, step_m, air.edges_m)[::-1]
    return _integrate(*air.at(air.points(path, u)), path.metres_per_u(u).T[..., None], u)


def _cuts(path: RayPath, start_m: float, step_m: float, edges_m: FloatArray) -> FloatArray:
    """Return u at the shells between ``start_m`` and the top, with the middles (in u) between: odd in number."""
    shells = shells_m(path.top_m, step_m)
    # Most of the air on a ray lies just above its lowest point. Shells of the same thickness there for all rays keep
    # their errors alike, which the slope of a profile needs more than its value.
    near = 0.5 * step_m * np.ceil(start_m / (0.5 * step_m)) + np.arange(8) * 0.5 * step_m
    shells = np.union1d(shells, near[near < path.top_m])
    shells = np.union1d(shells, edges_m[edges_m < path.top_m])
    # A sliver of a shell costs as much as a whole one.
    sliver = 0.05 * step_m if not len(edges_m) else 1.0
    ends = np.append(start_m, shells[shells > start_m + sliver])
    u = np.sqrt(ends - path.lowest_m)
    both = np.empty(2 * len(u) - 1)
    both[::2] = u
    both[1::2] = 0.5 * (u[1:] + u[:-1])
    return both


def _integrate(
    k: FloatArray, source: FloatArray, metres_per_u: FloatArray, u: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return radiance and transmission, shapes (azimuths, g), along ``u`` from the observer on.

    What is given at the points has them first: what is done for all rays and g points of a place lies together.
    """
    slope = k * metres_per_u
    source = np.ascontiguousarray(source)
    sixth = ((u[2::2] - u[:-2:2]) / 6.0)[:, None, None]
    depth = _simpson(slope, sixth)
    mean = _simpson(slope * source, sixth)
    mean /= np.maximum(depth, 1e-300)
    near, far = source[:-2:2], source[2::2]
    np.minimum(depth, _OPAQUE, out=depth)
    e = np.exp(-depth)
    # One of the two is at the threshold: without a choice between arrays, which takes as long as all the rest.
    thick, thin = np.maximum(depth, _THIN), np.minimum(depth, _THIN)
    within = np.minimum(e, math.exp(-_THIN))
    b = (1.0 - within) / thick
    bulge = 6.0 * (1.0 + within - 2.0 * b) / thick
    b += _thin_b(thin) - _thin_b(_THIN)
    bulge += _thin_bulge(thin) - _thin_bulge(_THIN)
    mean -= 0.5 * (near + far)
    mean *= bulge
    emitted = near * (1.0 - b)
    b -= e
    b *= far
    emitted += b
    emitted += mean
    passed = np.cumprod(e, axis=0)
    emitted[1:] *= passed[:-1]
    return emitted.sum(axis=0), passed[-1]


def _thin_b(depth: FloatArray | float) -> FloatArray | float:
    """Return b of thin pieces, to 1e-9."""
    return 1.0 - depth * (1 / 2 - depth * (1 / 6 - depth / 24))


def _thin_bulge(depth: FloatArray | float) -> FloatArray | float:
    """Return what stands behind M - (S0 + S1)/2 of thin pieces, to 1e-8."""
    return depth * (1.0 - depth * (1 / 2 - depth * 3 / 20))


def _simpson(values: FloatArray, sixth: FloatArray) -> FloatArray:
    """Return the integrals over pieces of which values have both ends and the middle."""
    total = 4.0 * values[1::2]
    total += values[:-2:2]
    total += values[2::2]
    total *= sixth
    return total


_SKY_ROWS, _SKY_STRIDE = 12, 5


@dataclass(frozen=True)
class GroundPlaces:
    """Where rays meet the ground.

    ``normal``: the ellipsoid's, shape (n, 3). ``cosine``: of the view to the vertical, shape (n,). ``places``: what
    emits there.
    """

    normal: FloatArray
    cosine: FloatArray
    places: EmittingPlaces


def ground_places(
    r_itrs: FloatArray, place_itrs: FloatArray, ellipsoid: Ellipsoid, sun_itrs: FloatArray, emission: GroundEmission
) -> GroundPlaces:
    """Return what is at places of shape (n, 3) seen from a camera, with the Sun in a direction."""
    latitude, longitude, _ = geodetic_from_itrs(place_itrs, ellipsoid)
    line = r_itrs - place_itrs
    line = line / np.linalg.norm(line, axis=-1, keepdims=True)
    normal = surface_normal(place_itrs, ellipsoid)
    cosine = np.einsum("ij,ij->i", normal, line)
    sun_longitude = float(np.arctan2(sun_itrs[1], sun_itrs[0]))
    return GroundPlaces(normal, cosine, emitting_places(emission, latitude, longitude, sun_longitude))


def ground_radiance(band: EmittingBand, emission: GroundEmission, at: GroundPlaces) -> FloatArray:
    """Return the radiance [W m-2 sr-1], shape (n, g), of the ground towards the camera."""
    places = at.places
    sky = _sky(band, at) if emission.kind != "uniform" or emission.emissivity < 1.0 else 0.0
    total = np.zeros((len(at.cosine), band.count))
    for kind, share in places.shares.items():
        e = ground_emissivity(emission, kind, band.wavelength_um, at.cosine[:, None])
        source = band.source(ground_k(emission, kind, places))
        total += share[:, None] * (e * source + (1.0 - e) * sky)
    return total


def _thinned(columns: FloatArray) -> FloatArray:
    """Return every so many heights of columns, and the highest; thin cloud is then right to the share that it is of a
    few steps, in the little that a ground reflects."""
    return np.concatenate([columns[..., :-1:_SKY_STRIDE], columns[..., -1:]], axis=-1)


def _sky(band: EmittingBand, at: GroundPlaces) -> FloatArray:
    """Return the mean radiance of the sky, shape (n, g)."""
    if band.column_map is not None:
        return _sky_of_map(band, band.column_map, at.normal)
    count = len(band.sin_latitude)
    rows = np.unique(np.linspace(0, count - 1, min(count, _SKY_ROWS)).round().astype(int))
    some = replace(
        band.of_columns(rows),
        altitude_m=_thinned(band.altitude_m),
        layer_per_m=_thinned(band.layer_per_m),
        sin_latitude=band.sin_latitude[rows],
    )
    return np.stack([np.interp(at.places.sin_latitude, some.sin_latitude, g) for g in some.sky_irradiance()], axis=-1)


def _sky_of_map(band: EmittingBand, lattice: ColumnMap, normal: FloatArray) -> FloatArray:
    """Return the same where columns stand on a map: that of the column next to each place."""
    nearest = np.argmax(normal @ lattice.normals().T, axis=1)
    columns, owner = np.unique(nearest, return_inverse=True)
    some = replace(
        band.of_columns(columns),
        altitude_m=_thinned(band.altitude_m),
        layer_per_m=_thinned(band.layer_per_m),
        sin_latitude=np.arange(len(columns), dtype=np.float64),
        column_map=None,
    )
    return some.sky_irradiance()[:, owner].T
