"""Ground stations, and the directions they measure.

A direction in a station's axes (x east, y north, z up) with azimuth ``A`` from north through east and elevation ``E``::

    r_enu = (cos E sin A, cos E cos A, sin E)

and with longitude ``l`` and geodetic latitude ``p`` the rotation to Earth-fixed axes is (Hadinejad & Amiri 2020)::

    Rt = [[-sin l, -sin p cos l, cos p cos l],
          [ cos l, -sin p sin l, cos p sin l],
          [ 0,      cos p,       sin p      ]]

*Celestial coordinates*: right ascension ``a``, declination ``d`` and distance, in ``gcrs``: ``tan a = y / x``, ``sin d
= z / |r|``. The error of the right ascension is the angle about the axis, not multiplied by the cosine of the
declination: an arc on the sky is smaller.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import itrs_from_geodetic


@dataclass(frozen=True)
class Station:
    """A place on the ground: geodetic coordinates on WGS84."""

    name: str
    longitude_rad: float
    latitude_rad: float
    height_m: float

    @property
    def r_itrs(self) -> FloatArray:
        """Position [m], shape (3,)."""
        return itrs_from_geodetic(self.latitude_rad, self.longitude_rad, self.height_m)

    @property
    def itrs_from_enu(self) -> FloatArray:
        """The rotation ``Rt``, shape (3, 3)."""
        sl, cl = np.sin(self.longitude_rad), np.cos(self.longitude_rad)
        sp, cp = np.sin(self.latitude_rad), np.cos(self.latitude_rad)
        return np.array([[-sl, -sp * cl, cp * cl], [cl, -sp * sl, cp * sl], [0.0, cp, sp]])

    def azimuth_elevation(self, r_itrs: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return azimuth, in [0, 2 pi), and unrefracted elevation [rad] of Earth-fixed points (..., 3) [m]."""
        d = (np.asarray(r_itrs, float) - self.r_itrs) @ self.itrs_from_enu
        azimuth = np.mod(np.arctan2(d[..., 0], d[..., 1]), 2.0 * np.pi)
        return azimuth, np.arctan2(d[..., 2], np.hypot(d[..., 0], d[..., 1]))

    def directions_itrs(self, azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> FloatArray:
        """Return Earth-fixed unit vectors, shape (..., 3)."""
        return enu_directions(azimuth_rad, elevation_rad) @ self.itrs_from_enu.T


def enu_directions(azimuth_rad: ArrayLike, elevation_rad: ArrayLike) -> FloatArray:
    """Return unit vectors in east, north, up, shape (..., 3)."""
    az, el = np.broadcast_arrays(np.asarray(azimuth_rad, float), np.asarray(elevation_rad, float))
    return np.stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)], axis=-1)


ARCSEC = np.pi / 648000.0


def celestial(r_gcrs: ArrayLike) -> FloatArray:
    """Return right ascension and declination [rad] and distance [m], shape (..., 3), of positions (..., 3) [m]."""
    r = np.asarray(r_gcrs, float)
    x, y, z = np.moveaxis(r, -1, 0)
    return np.stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y)), np.linalg.norm(r, axis=-1)], axis=-1)


def celestial_errors(r_gcrs: ArrayLike, truth_gcrs: ArrayLike) -> FloatArray:
    """Return errors of right ascension and declination [arcsec] and distance [km], shape (..., 3)."""
    e = celestial(r_gcrs) - celestial(truth_gcrs)
    e[..., 0] = np.remainder(e[..., 0] + np.pi, 2.0 * np.pi) - np.pi
    return e / np.array([ARCSEC, ARCSEC, 1e3])


def rms(errors: ArrayLike) -> FloatArray:
    """Return the root mean square over the instants (last axis but one), shape (..., 3)."""
    return np.sqrt(np.mean(np.asarray(errors, float) ** 2, axis=-2))


def normalised_squares(r_gcrs: ArrayLike, covariances: ArrayLike, truth_gcrs: ArrayLike) -> FloatArray:
    """Return ``e^T P^-1 e``, shape (...), of positions (..., 3): 3 on average where the covariance is honest."""
    e = np.asarray(r_gcrs, float) - np.asarray(truth_gcrs, float)
    return np.einsum("...i,...i->...", e, np.linalg.solve(np.asarray(covariances, float), e[..., None])[..., 0])
