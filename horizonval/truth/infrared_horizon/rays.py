"""Rays past the Earth by azimuth and lowest height, and their course through shells of equal geodetic height.

A ray lies in the vertical plane of its azimuth about the geocentric nadir ``z``, ``d = cos(theta) z + sin(theta) m``.
Turned outward by ``dtheta`` its lowest point, at distance ``s_t``, rises by ``s_t (n . e) dtheta``, with ``n`` the
ellipsoid's normal there and ``e`` the direction that ``d`` turns to: Newton's method finds the angle of a height.

Along the ray the height ``z`` is convex with its minimum ``h`` at the lowest point, so that in the signed root
``u = +-sqrt(z - h)`` (minus on the observer's side) distance and latitude are smooth: on a sphere
``s - s_t = u sqrt(2 (R + h) + u^2)``. A polynomial through exact points follows both to the millimetre.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
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

    def parts(self, azimuths: int) -> Iterator[RayPath]:
        """Yield the rays of a few azimuths at a time."""
        for first in range(0, len(self.distance), azimuths):
            few = slice(first, first + azimuths)
            yield replace(
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
