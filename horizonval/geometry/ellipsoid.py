"""The Earth as an ellipsoid of revolution: heights, verticals, and lines that meet or miss it.

Dividing every component by the ellipsoid's axes ``(a, a, b)`` turns the ellipsoid into the unit sphere and leaves
lines straight, so a line ``o + s d`` meets it where the scaled line ``o' + s d'`` is 1 from the centre::

    s = (-o'.d' -+ sqrt(|d'|^2 - |o' x d'|^2)) / |d'|^2

``|o' x d'|`` is computed as it stands and not as ``|o'|^2 |d'|^2 - (o'.d')^2``, which loses ``(distance / radius)^2``
units of precision: from two million kilometres, 1e5 of them.

The geodetic height is the signed distance to the nearest point of the ellipsoid. That point is ``a^2 p / (t + a^2)``,
``b^2 z / (t + b^2)`` (``p`` the distance from the axis), with ``t`` the largest root of::

    (a p / (t + a^2))^2 + (b z / (t + b^2))^2 = 1

(D. Eberly, "Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid", 2013, section 2). The reciprocal
of the left side's square root is concave and almost a straight line in ``t`` (exactly one for a sphere), so Newton on
it needs three or four steps from anywhere, the Earth's centre included, where the usual formulas choose a wrong root.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError


@dataclass(frozen=True)
class Ellipsoid:
    """Oblate ellipsoid of revolution about z with equatorial and polar radius [m]; UserError unless 0 < b <= a."""

    a_m: float
    b_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.a_m) and 0.0 < self.b_m <= self.a_m):
            raise UserError(
                f"ellipsoid with radii a = {self.a_m} m, b = {self.b_m} m", expected="0 < b <= a, both finite"
            )

    @property
    def axes_m(self) -> FloatArray:
        """Semi-axes ``(a, a, b)`` [m], shape (3,)."""
        return np.array([self.a_m, self.a_m, self.b_m])

    @property
    def is_sphere(self) -> bool:
        return self.a_m == self.b_m

    @property
    def flattening(self) -> float:
        """``(a - b) / a``: the difference of the radii is exact, ``1 - b / a`` would lose two digits."""
        return (self.a_m - self.b_m) / self.a_m

    @property
    def mean_radius_m(self) -> float:
        """Mean of the three semi-axes."""
        return (2.0 * self.a_m + self.b_m) / 3.0

    def raised(self, height_m: float) -> Ellipsoid:
        """Return the ellipsoid whose semi-axes are longer by a height."""
        return Ellipsoid(self.a_m + height_m, self.b_m + height_m)


WGS84 = Ellipsoid(6378137.0, 6378137.0 * (1.0 - 1.0 / 298.257223563))


_BLOCK = 16384


def sphere(radius_m: float) -> Ellipsoid:
    """Return the sphere of this radius [m]."""
    return Ellipsoid(radius_m, radius_m)


def _norm(v: FloatArray) -> FloatArray:
    return np.sqrt(np.einsum("...i,...i->...", v, v))


def _unit(v: FloatArray) -> FloatArray:
    return v / _norm(v)[..., None]


def itrs_from_geodetic(
    latitude_rad: ArrayLike, longitude_rad: ArrayLike, height_m: ArrayLike, ellipsoid: Ellipsoid = WGS84
) -> FloatArray:
    """Return the position [m], shape (..., 3), of geodetic coordinates (broadcast against each other)."""
    lat, lon, h = np.broadcast_arrays(
        np.asarray(latitude_rad, float), np.asarray(longitude_rad, float), np.asarray(height_m, float)
    )
    normal = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=-1)
    axes = ellipsoid.axes_m
    foot = axes**2 * normal / _norm(axes * normal)[..., None]
    return foot + h[..., None] * normal


def _latitude_root(p: FloatArray, z: FloatArray, beta: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return cosine and sine of the geodetic latitude, and the height, of points of the first quadrant.

    ``p`` from the axis and ``z`` from the equator, both in units of the equatorial radius; ``beta = (b / a)^2``.
    """
    # The floors stand for 1e-13 m: on the equatorial plane inside the evolute, and on the axis, they choose one of
    # the equally near points instead of dividing 0 by 0.
    p, z = np.maximum(p, 1e-20), np.maximum(z, 1e-20)
    root = math.sqrt(beta)
    zr = root * z
    lower, upper = np.maximum(p - 1.0, zr - beta), np.hypot(p, zr) - beta
    t = lower
    for _ in range(60):
        i, j = 1.0 / (t + 1.0), 1.0 / (t + beta)
        x2, y2 = (p * i) ** 2, (zr * j) ** 2
        n2 = x2 + y2
        new = np.clip(t + n2 * (np.sqrt(n2) - 1.0) / (x2 * i + y2 * j), lower, upper)
        done = np.all(np.abs(new - t) <= 4e-16 * (1.0 + np.abs(new)))
        t = new
        if done:
            break
    x, y = p / (t + 1.0), z / (t + beta)
    scale = np.hypot(x, y)
    return x / scale, y / scale, t * scale


def _foot(r_itrs: ArrayLike, ellipsoid: Ellipsoid) -> tuple[FloatArray, FloatArray]:
    """Return the outward unit normal at the nearest surface point, shape (..., 3), and the height [m], shape (...)."""
    r = np.asarray(r_itrs, float) / ellipsoid.a_m
    p = np.hypot(r[..., 0], r[..., 1])
    cos_lat, sin_lat, height = _latitude_root(p, np.abs(r[..., 2]), (ellipsoid.b_m / ellipsoid.a_m) ** 2)
    # On the axis itself the meridian is that of Greenwich, as atan2(0, 0) has it.
    on_axis = p == 0.0
    inverse = 1.0 / np.where(on_axis, 1.0, p)
    east = np.where(on_axis, 1.0, r[..., 0] * inverse)
    normal = np.stack([cos_lat * east, cos_lat * r[..., 1] * inverse, np.copysign(sin_lat, r[..., 2])], axis=-1)
    return normal, height * ellipsoid.a_m


def geodetic_from_itrs(r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return geodetic latitude [rad], longitude [rad] and height [m] of positions, shape (..., 3) [m].

    Height is right to the rounding of the coordinates (1 nm near the surface, 1 um two million kilometres away). On
    the polar axis the longitude is 0.
    """
    r = np.asarray(r_itrs, float)
    normal, height = _foot(r, ellipsoid)
    latitude = np.arctan2(normal[..., 2], np.hypot(normal[..., 0], normal[..., 1]))
    return latitude, np.arctan2(r[..., 1], r[..., 0]), height


def geodetic_height(r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the height above the ellipsoid [m], shape (...), negative inside, of positions of shape (..., 3)."""
    return _foot(r_itrs, ellipsoid)[1]


def surface_normal(r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the outward unit normal, shape (..., 3), at the surface point nearest to each position: the local up."""
    return _foot(r_itrs, ellipsoid)[0]


def geodetic_nadir(r_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the unit vector, shape (..., 3), from each position straight down on to the ellipsoid."""
    return -surface_normal(r_itrs, ellipsoid)


def geocentric_nadir(r_itrs: ArrayLike) -> FloatArray:
    """Return the unit vector, shape (..., 3), from each position to the Earth's centre."""
    return -_unit(np.asarray(r_itrs, float))


def line_intersections(
    o_itrs: ArrayLike, d_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84
) -> tuple[FloatArray, FloatArray]:
    """Return where lines ``o + s d`` (..., 3) enter and leave the ellipsoid; ``d`` need not be a unit vector.

    Returns
    -------
    s_near, s_far : ndarray, shape (...)
        Parameters ([m] for unit directions), ``s_near <= s_far``, negative behind ``o``; NaN where the line misses.
    """
    o, d = np.broadcast_arrays(np.asarray(o_itrs, float), np.asarray(d_itrs, float))
    o, d = o / ellipsoid.axes_m, d / ellipsoid.axes_m
    dd = np.einsum("...i,...i->...", d, d)
    moment = np.cross(o, d)
    disc = dd - np.einsum("...i,...i->...", moment, moment)
    middle = -np.einsum("...i,...i->...", o, d) / dd
    half = np.sqrt(np.where(disc >= 0.0, disc, np.nan)) / dd
    return middle - half, middle + half


def surface_distance(o_itrs: ArrayLike, d_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the distance [m], shape (...), along rays to the surface; ``+inf`` where they miss it.

    Parameters as in :func:`line_intersections`, with unit directions. From inside the ellipsoid it is the way out.
    """
    near, far = line_intersections(o_itrs, d_itrs, ellipsoid)
    first = np.where(near >= 0.0, near, far)
    return np.where(first >= 0.0, first, np.inf)


def tangent_point(
    o_itrs: ArrayLike, d_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84, *, ray: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return the position and the value of the lowest geodetic height along lines ``o + s d`` (unit ``d``).

    Height is the signed distance to a convex body, hence convex along a line: one minimum, found by Newton on
    ``normal . d = 0`` with the second derivative from the principal radii of curvature, inside a bracket. The bracket
    needs no search: the vertical through the minimum is perpendicular to ``d`` and passes within ``(a^2 - b^2) / b``
    (43 km) of the centre, so the minimum lies that close to the foot of the perpendicular from the centre.

    Returns
    -------
    s : ndarray, shape (...)
        Distance from ``o`` along ``d`` [m]; with ``ray`` not below 0.
    height : ndarray, shape (...)
        Lowest geodetic height [m]; minus the depth of the chord for lines through the ellipsoid. Converged to 1 um,
        plus the rounding of the coordinates (1 um for observers 2e9 m away).
    """
    o, d = np.broadcast_arrays(np.asarray(o_itrs, float), np.asarray(d_itrs, float))
    shape = o.shape[:-1]
    o, d = o.reshape(-1, 3), d.reshape(-1, 3)
    s, height = np.empty(len(o)), np.empty(len(o))
    # Blocks that stay in the processor's cache: twice as fast as a megapixel at once.
    for start in range(0, len(o), _BLOCK):
        block = slice(start, start + _BLOCK)
        s[block], height[block] = _tangent_block(o[block], d[block], ellipsoid, ray)
    return s.reshape(shape), height.reshape(shape)


def _tangent_block(o: FloatArray, d: FloatArray, ellipsoid: Ellipsoid, ray: bool) -> tuple[FloatArray, FloatArray]:
    a, b = ellipsoid.a_m, ellipsoid.b_m
    beta = (b / a) ** 2
    ox, oy, oz = np.ascontiguousarray(o.T)
    dx, dy, dz = np.ascontiguousarray(d.T)
    middle = -(ox * dx + oy * dy + oz * dz)
    reach = (a**2 - b**2) / b + 1.0
    lower, upper = middle - reach, middle + reach
    # The lowest point of the scaled line is within some metres of the answer where the line grazes the Earth.
    s = -(ox * dx + oy * dy + oz * dz / beta) / (dx * dx + dy * dy + dz * dz / beta)
    s = np.clip(s, lower, upper)
    for _ in range(60):
        x, y, z = ox + s * dx, oy + s * dy, oz + s * dz
        p = np.hypot(x, y)
        cos_lat, sin_lat, height = _latitude_root(p / a, np.abs(z) / a, beta)
        sin_lat = np.copysign(sin_lat, z)
        inverse = 1.0 / np.maximum(p, 1e-13)
        outward, eastward = (x * dx + y * dy) * inverse, (x * dy - y * dx) * inverse
        slope = cos_lat * outward + sin_lat * dz
        northward = cos_lat * dz - sin_lat * outward
        lower = np.where(slope <= 0.0, s, lower)
        upper = np.where(slope >= 0.0, s, upper)
        w = 1.0 - (1.0 - beta) * sin_lat**2
        prime, meridional = a * (w**-0.5 + height), a * (beta * w**-1.5 + height)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = s - slope / (eastward**2 / prime + northward**2 / meridional)
        new = np.where((new >= lower) & (new <= upper), new, 0.5 * (lower + upper))
        step = new - s
        s = new
        # The height left to gain is step^2 / (2 R): 1e-7 m after a step of 1 m.
        if np.all(np.abs(step) < 1.0):
            break
    if ray:
        s = np.maximum(s, 0.0)
    return s, geodetic_height(np.stack([ox + s * dx, oy + s * dy, oz + s * dz], axis=-1), ellipsoid)


def tangent_height(
    o_itrs: ArrayLike, d_itrs: ArrayLike, ellipsoid: Ellipsoid = WGS84, *, ray: bool = False
) -> FloatArray:
    """Return the lowest geodetic height [m] along lines (or rays); see :func:`tangent_point`."""
    return tangent_point(o_itrs, d_itrs, ellipsoid, ray=ray)[1]
