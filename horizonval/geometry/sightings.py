"""Position of a satellite from directions that ground stations measure at the same instants.

After Hadinejad & Amiri 2020, "Passive satellite localisation". A direction in a station's axes (x east, y north, z up)
with azimuth ``A`` from north through east and elevation ``E``, at longitude ``l`` and geodetic latitude ``p``::

    r_enu = (cos E sin A, cos E cos A, sin E)

    r_itrs = [[-sin l, -sin p cos l, cos p cos l],
              [ cos l, -sin p sin l, cos p sin l],
              [ 0,      cos p,       sin p      ]] r_enu

The position is the point with the least sum of squared distances to the lines of sight ``L_i + d u_i``::

    x = (sum_i M_i)^-1 sum_i M_i L_i,     M_i = I - u_i u_i^T

For two stations it is the middle of the shortest line between the lines of sight, as published.

*Adaptive filter.* Akhlaghi, Zhou & Huang, "Adaptive adjustment of noise covariance in Kalman filter for dynamic state
estimation", IEEE PES General Meeting 2017. The measurement ``y`` is a position. With the innovation ``d = y - H x-``,
the residual ``e = y - H x+``, the gain ``K`` and a forgetting factor ``alpha``::

    R_k = alpha R_{k-1} + (1 - alpha) (e e^T + H P- H^T)
    Q_k = alpha Q_{k-1} + (1 - alpha) (K d d^T K^T)

in the order predict, gain, update, adapt. The motion is that of a point mass's attraction, constant over a step:
neglecting its change costs ``w^3 r dt^3 / 6``, a millimetre for steps of 0.1 s and 1.4 m for 1 s in low orbit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import itrs_from_geodetic
from horizonval.geometry.orbit import GM_M3_PER_S2

_FLOOR_M2 = 1e-4
"""Variance of 1 cm that the filter adds to a measured position, so that no covariance is singular, and to a motion."""


@dataclass(frozen=True)
class Station:
    """A place on the ground: geodetic longitude, latitude [deg] and height [m] on WGS84."""

    longitude_deg: float
    latitude_deg: float
    height_m: float

    @property
    def r_itrs(self) -> FloatArray:
        """Position [m], shape (3,)."""
        return itrs_from_geodetic(np.radians(self.latitude_deg), np.radians(self.longitude_deg), self.height_m)

    @property
    def itrs_from_enu(self) -> FloatArray:
        """The rotation from east, north, up to Earth-fixed axes, shape (3, 3)."""
        longitude, latitude = np.radians([self.longitude_deg, self.latitude_deg])
        (sl, cl), (sp, cp) = ((np.sin(x), np.cos(x)) for x in (longitude, latitude))
        return np.array([[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [0.0, cp, sp]])

    def azimuth_elevation(self, r_itrs: ArrayLike) -> FloatArray:
        """Return azimuth, in [0, 2 pi), and unrefracted elevation [rad], shape (..., 2), of points (..., 3) [m]."""
        east, north, up = np.moveaxis((np.asarray(r_itrs, float) - self.r_itrs) @ self.itrs_from_enu, -1, 0)
        azimuth = np.mod(np.arctan2(east, north), 2.0 * np.pi)
        return np.stack([azimuth, np.arctan2(up, np.hypot(east, north))], axis=-1)

    def directions(self, azimuth_elevation_rad: ArrayLike) -> FloatArray:
        """Return Earth-fixed unit vectors, shape (..., 3), of angles of shape (..., 2)."""
        azimuth, elevation = np.moveaxis(np.asarray(azimuth_elevation_rad, float), -1, 0)
        level = np.cos(elevation)
        enu = np.stack([level * np.sin(azimuth), level * np.cos(azimuth), np.sin(elevation)], axis=-1)
        return enu @ self.itrs_from_enu.T


def intersection(origins: ArrayLike, directions: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the points nearest to lines and their root mean square distances, shapes (..., 3) and (...).

    ``origins``: shape (m, 3); ``directions``: shape (..., m, 3), unit vectors, nan for a line that is left out. Both
    results are nan where fewer than two lines are left, or all are parallel to 1 arcsec.
    """
    start, u = np.asarray(origins, float), np.asarray(directions, float)
    used = np.isfinite(u).all(axis=-1)
    across = np.where(used[..., None, None], np.eye(3) - u[..., :, None] * u[..., None, :], 0.0)
    normal = across.sum(axis=-3)
    flat = np.linalg.eigvalsh(normal)[..., 0] < 1e-11
    normal = np.where(flat[..., None, None], np.eye(3), normal)
    # Relative to the first station: the difference of large numbers would cost digits.
    offset = start - start[0]
    right = np.einsum("...mij,mj->...i", across, offset)
    point = np.linalg.solve(normal, right[..., None])[..., 0]
    miss = np.linalg.norm(np.einsum("...mij,...mj->...mi", across, point[..., None, :] - offset), axis=-1)
    count = np.maximum(used.sum(axis=-1), 1)
    lost = np.where(flat, np.nan, 0.0)
    return start[0] + point + lost[..., None], np.sqrt(np.sum(miss**2, axis=-1) / count) + lost


def smoothed(directions: ArrayLike, width_steps: float) -> FloatArray:
    """Return unit vectors, shape (n, ..., 3), that are Gaussian means over time (axis 0, equal steps).

    ``width_steps``: standard deviation of the weights. Beyond both ends the series goes on by its last difference, so
    that a straight series stays as it is.
    """
    u = np.asarray(directions, float)
    reach = int(np.ceil(5.0 * width_steps))
    beyond = np.arange(1, reach + 1).reshape(-1, *(1 for _ in u.shape[1:]))
    padded = np.concatenate([u[0] - beyond[::-1] * (u[1] - u[0]), u, u[-1] + beyond * (u[-1] - u[-2])])
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width_steps) ** 2)
    total = np.sum([weight * padded[k : k + len(u)] for k, weight in enumerate(weights)], axis=0)
    return np.asarray(total / np.linalg.norm(total, axis=-1, keepdims=True))


def adaptive_filter(times_s: ArrayLike, positions_gcrs: ArrayLike, covariance: ArrayLike, alpha: float) -> FloatArray:
    """Return filtered positions, shape (n, 3), of measured ones [m].

    ``covariance``: of a measured position at the start, shape (3, 3) [m^2]; ``alpha``: forgetting factor in (0, 1]. The
    filter starts with the first position and its difference to the second.
    """
    t, y = np.asarray(times_s, float), np.asarray(positions_gcrs, float)
    r = np.asarray(covariance, float) + _FLOOR_M2 * np.eye(3)
    step = t[1] - t[0]
    x = np.concatenate([y[0], (y[1] - y[0]) / step])
    p, q = np.kron(np.diag([1.0, 2.0 / step**2]), r), _FLOOR_M2 * np.eye(6)
    found = []
    for k in range(len(t)):
        if k:
            dt = t[k] - t[k - 1]
            pull = -GM_M3_PER_S2 * x[:3] / np.linalg.norm(x[:3]) ** 3
            x = np.concatenate([x[:3] + dt * x[3:] + 0.5 * dt**2 * pull, x[3:] + dt * pull])
            move = np.kron([[1.0, dt], [0.0, 1.0]], np.eye(3))
            p = move @ p @ move.T + q
        seen = p[:3, :3]
        gain = np.linalg.solve(seen + r, p[:3]).T
        change = gain @ (y[k] - x[:3])
        x = x + change
        # Joseph's form stays symmetric and positive.
        keep = np.eye(6) - np.hstack([gain, np.zeros((6, 3))])
        p = keep @ p @ keep.T + gain @ r @ gain.T
        rest = y[k] - x[:3]
        r = alpha * r + (1.0 - alpha) * (np.outer(rest, rest) + seen)
        q = alpha * q + (1.0 - alpha) * np.outer(change, change)
        found.append(x[:3])
    return np.array(found)


def scatter(positions: ArrayLike) -> FloatArray:
    """Return the covariance [m^2] of a series of positions, shape (n, 3), from second differences: a variance of 6."""
    second = np.diff(np.asarray(positions, float), 2, axis=0)
    return np.asarray(second.T @ second / (6.0 * len(second)))


def celestial(r_gcrs: ArrayLike) -> FloatArray:
    """Return right ascension, in [0, 2 pi), declination [rad] and distance [m], shape (..., 3), of positions [m]."""
    x, y, z = np.moveaxis(np.asarray(r_gcrs, float), -1, 0)
    level = np.hypot(x, y)
    return np.stack([np.mod(np.arctan2(y, x), 2.0 * np.pi), np.arctan2(z, level), np.hypot(level, z)], axis=-1)
