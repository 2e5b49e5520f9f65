"""Where the satellite is, where its heads look, and the rays that climb through the limb.

A circular orbit of radius R, inclined by i, with its node on the zero meridian, at the argument of latitude u::

    r = R (cos u, sin u cos i, sin u sin i),    x = dr/du / R,    z = -r / R,    y = z x x

x is forward, y right, z the geocentric nadir (lvlh). A head at azimuth alpha looks into the plane of z and
``m = x cos alpha + y sin alpha``; its rays are ``z cos eta + m sin eta`` with the nadir angle eta. The planet does not
turn beneath the orbit: nothing here depends on longitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, itrs_from_geodetic, tangent_height
from horizonval.geometry.frames import north_east
from horizonval.geometry.horizon import horizon_by_azimuth

HEADS = ("forward", "right", "aft", "left")
VANTAGE_M = 4e6
"""From where the limb along a parallel is looked at: far outside the air."""


@dataclass(frozen=True)
class Heads:
    """Positions round an orbit and the four vertical planes the heads look into.

    Attributes
    ----------
    argument_rad : ndarray, shape (p,)
        Argument of latitude.
    r_itrs : ndarray, shape (p, 3)
        Position [m].
    nadir : ndarray, shape (p, 3)
        Geocentric.
    level : ndarray, shape (p, 4, 3)
        Level unit vectors that the heads look towards.
    azimuth_rad : ndarray, shape (4,)
        Of the heads, from forward to the right.
    horizon_rad : ndarray, shape (p, 4)
        Nadir angle of the ellipsoid's horizon: what a sensor is taken to know and to correct for.
    """

    argument_rad: FloatArray
    r_itrs: FloatArray
    nadir: FloatArray
    level: FloatArray
    azimuth_rad: FloatArray
    horizon_rad: FloatArray

    def directions(self, offset_rad: ArrayLike) -> FloatArray:
        """Return unit directions, shape (p, 4, n, 3), that lie above the horizon by angles of shape (p, 4, n)."""
        eta = (self.horizon_rad[..., None] + np.asarray(offset_rad, dtype=np.float64))[..., None]
        return np.cos(eta) * self.nadir[:, None, None, :] + np.sin(eta) * self.level[:, :, None, :]


def heads_round_orbit(
    radius_m: float, inclination_rad: float, positions: int, first_head_rad: float = 0.0, ellipsoid: Ellipsoid = WGS84
) -> Heads:
    """Return the heads at evenly spread positions, the first over the ascending node."""
    u = np.arange(positions, dtype=np.float64) * (2 * math.pi / positions)
    c, s, ci, si = np.cos(u), np.sin(u), math.cos(inclination_rad), math.sin(inclination_rad)
    up = np.stack([c, s * ci, s * si], axis=-1)
    forward = np.stack([-s, c * ci, c * si], axis=-1)
    right = np.cross(-up, forward)
    alpha = first_head_rad + np.arange(4, dtype=np.float64) * (math.pi / 2)
    level = np.cos(alpha)[:, None] * forward[:, None, :] + np.sin(alpha)[:, None] * right[:, None, :]
    r = radius_m * up
    horizon = np.empty((positions, 4))
    for i in range(positions):
        north, east = north_east(r[i])
        horizon[i] = horizon_by_azimuth(r[i], ellipsoid, np.arctan2(level[i] @ east, level[i] @ north))
    return Heads(u, r, -up, level, alpha, horizon)


def offsets_of_heights(heads: Heads, height_m: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return the angles above the horizon [rad], shape (p, 4, n), at which rays have lowest heights (n,).

    Secant steps on :func:`horizonval.geometry.ellipsoid.tangent_height`, which is smooth through the ground; to 1 mm.
    """
    goal = np.broadcast_to(np.asarray(height_m, dtype=np.float64), (*heads.horizon_rad.shape, np.size(height_m)))
    origin = heads.r_itrs[:, None, None, :]
    # On a sphere of radius rho = D sin(eta) the height is D sin(eta + x) - rho.
    distance = np.linalg.norm(heads.r_itrs, axis=-1)[:, None, None]
    rho = distance * np.sin(heads.horizon_rad)[..., None]
    x = np.arcsin((rho + goal) / distance) - heads.horizon_rad[..., None]
    for _ in range(20):
        error = tangent_height(origin, heads.directions(x), ellipsoid) - goal
        if np.all(np.abs(error) < 1e-3):
            break
        x = x - error / (distance * np.cos(heads.horizon_rad[..., None] + x))
    return x


def rays_along_parallels(
    latitude_rad: ArrayLike, height_m: ArrayLike, ellipsoid: Ellipsoid = WGS84
) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions, shapes (m, n, 3), of rays towards the east that are lowest at given places.

    The lowest point lies at latitude (m,) and geodetic height (n,). Along 500 km on either side the ray leaves the
    parallel by less than 0.4 deg up to 60 deg of latitude.
    """
    latitude, height = np.meshgrid(np.asarray(latitude_rad, float), np.asarray(height_m, float), indexing="ij")
    lowest = itrs_from_geodetic(latitude, 0.0, height, ellipsoid)
    east = np.array([0.0, 1.0, 0.0])
    return lowest - VANTAGE_M * east, np.broadcast_to(east, lowest.shape)
