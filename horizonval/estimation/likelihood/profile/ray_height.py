r"""How high above an ellipsoid a line of sight passes at its lowest point, with derivatives by everything in a pose.

Divided by the semi-axes ``s`` the ellipsoid is the unit sphere. A ray from ``p = r / s`` along ``e = d / s`` comes
nearest to its centre at ``q = p + l e`` with ``l = -p . e / e . e``, the distance along the ray in metres; there the
ray lies at the distance ``|q|`` from the centre, and over the ellipsoid at the height ::

    h = (|q| - 1) / |g|,        g = (q / |q|) / s,        n = g / |g|

with ``n`` the normal beneath. Below 0 the ray ends on the ground, and ``h`` is how deep it would come. The surface
``|q| = const`` is a scaled ellipsoid, not the one at an even height: less than ``2 f h^2 / a``, 5 m at 70 km.

The lowest point moves with a turn and a shift of the ray as its own place along the normal does::

    dh = l n . dd + n . dr

What ``g`` changes beside is less by ``h / a``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import cross

LEAST_ROOT = 0.01
"""Of a height as seen from itself: rays that high pass above the observer."""


@dataclass(frozen=True)
class RayHeight:
    """Of n lines of sight.

    Attributes
    ----------
    height_m : ndarray, shape (n,)
    distance_m : ndarray, shape (n,)
        From the observer to the lowest point.
    normal_cam : ndarray, shape (3, n)
        Unit normal of the ellipsoid beneath that point, in camera axes.
    by_rotation : ndarray, shape (3, n)
        By a rotation vector of the camera in its own axes, as in :mod:`.limb_angle` [m/rad].
    by_position : ndarray, shape (3, n)
        By the position in Earth-fixed axes [1]: the normal there.
    """

    height_m: FloatArray
    distance_m: FloatArray
    normal_cam: FloatArray
    by_rotation: FloatArray
    by_position: FloatArray

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> RayHeight:
        """Return some of them, by their numbers or by a mask."""
        return RayHeight(
            self.height_m[which],
            self.distance_m[which],
            self.normal_cam[:, which],
            self.by_rotation[:, which],
            self.by_position[:, which],
        )


def ray_height(los_cam: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray) -> RayHeight:
    """Return how high lines of sight pass.

    Parameters
    ----------
    los_cam : ndarray, shape (3, n)
        Unit vectors in camera axes.
    cam_from_itrs : ndarray, shape (3, 3)
    r_itrs : ndarray, shape (3,)
        Observer [m].
    axes_m : ndarray, shape (3,)
        Semi-axes of the ellipsoid.
    """
    p = r_itrs / axes_m
    e = (cam_from_itrs / axes_m).T @ los_cam
    distance = -(p @ e) / np.einsum("ij,ij->j", e, e)
    q = p[:, None] + distance * e
    size = np.sqrt(np.einsum("ij,ij->j", q, q))
    g = q / axes_m[:, None]
    steep = np.sqrt(np.einsum("ij,ij->j", g, g))
    normal = g / steep
    normal_cam = cam_from_itrs @ normal
    return RayHeight(
        height_m=(size - 1.0) * size / steep,
        distance_m=distance,
        normal_cam=normal_cam,
        by_rotation=distance * np.array(cross(normal_cam, los_cam)),
        by_position=normal,
    )


def level_distance(height_m: FloatArray, curve: float) -> tuple[FloatArray, FloatArray]:
    r"""Return the distances across a limb that belong to heights, and their derivative.

    Seen at the distance ``l``, a ray that is turned outwards by the angle ``b`` passes higher by ``y - curve y^2`` with
    ``y = l b``, ``curve = R / (2 l^2)``: pixels are even in ``y``, and not in height, by 3 % a pixel of 30 km.

    Parameters
    ----------
    height_m : ndarray
    curve : float
        [1/m].
    """
    root = np.sqrt(np.maximum(1.0 - 4.0 * curve * height_m, LEAST_ROOT))
    return 2.0 * height_m / (1.0 + root), 1.0 / root
