r"""How far inside the limb of an ellipsoid a line of sight passes, with exact derivatives by everything in a pose.

Divided by the semi-axes ``s = (a + h, a + h, b + h)`` the ellipsoid, raised by the height ``h`` of the limb, is the
unit sphere, the observer stands at ``p = r / s`` and a line of sight runs along ``e ~ d / s``. With ``n = -p / |p|``::

    delta = asin(1 / |p|) - angle(e, n)

is positive inside the limb and zero on it. For a sphere it is the angle from the limb; for the Earth it departs from it
by the flattening times itself, and whoever needs a true distance divides by the gradient. Derivatives, with ``t`` the
unit vector from ``e`` towards ``n`` and ``q`` the one from ``n`` towards ``e``, and ``k = sqrt(|p|^2 - 1)``::

    d delta / d d = t / (|d / s| s)                       by the line of sight (it has no part along d)
    d delta / d p = (n / k - q) / |p|                     by the scaled position

A rotation of the camera by the small vector ``theta`` in its own axes turns what it sees by ``-theta``; ``h`` changes
``s`` and so both ``p`` and ``d / s``.

The raised ellipsoid is not quite the surface at height ``h``: less than ``h f^2 / 2``, 0.2 m at 40 km.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import cross


@dataclass(frozen=True)
class LimbAngle:
    """Of n lines of sight.

    Attributes
    ----------
    delta : ndarray, shape (n,)
        [rad], positive inside the limb.
    by_direction : ndarray, shape (3, n)
        By the line of sight in camera axes [rad per unit].
    by_rotation : ndarray, shape (3, n)
        By a rotation vector of the camera in its own axes: ``cam_from_itrs`` becomes ``exp([theta x]) cam_from_itrs``.
    by_position : ndarray, shape (3, n)
        By the position in Earth-fixed axes [rad/m].
    by_height : ndarray, shape (n,)
        By the height of the limb [rad/m].
    """

    delta: FloatArray
    by_direction: FloatArray
    by_rotation: FloatArray
    by_position: FloatArray
    by_height: FloatArray


def limb_angle(los_cam: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray) -> LimbAngle:
    """Return how far inside the limb lines of sight pass.

    Parameters
    ----------
    los_cam : ndarray, shape (3, n)
        Unit vectors in camera axes.
    cam_from_itrs : ndarray, shape (3, 3)
    r_itrs : ndarray, shape (3,)
        Observer [m].
    axes_m : ndarray, shape (3,)
        Semi-axes of the ellipsoid, the height of the limb included.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the observer stands on or below the limb.
    """
    p = r_itrs / axes_m
    size = float(np.sqrt(p @ p))
    if not size > 1.0:
        raise np.linalg.LinAlgError("the position lies below the limb")
    k = float(np.sqrt((size - 1.0) * (size + 1.0)))
    n = -p / size
    scaled = (cam_from_itrs / axes_m).T @ los_cam
    length = np.sqrt(np.einsum("ij,ij->j", scaled, scaled))
    e = scaled / length
    cosine = n @ e
    t = n[:, None] - cosine * e
    sine = np.maximum(np.sqrt(np.einsum("ij,ij->j", t, t)), 1e-300)
    t /= sine
    delta = np.arctan2(1.0, k) - np.arctan2(sine, cosine)
    by_scaled_direction = t / length
    by_direction = (cam_from_itrs / axes_m) @ by_scaled_direction
    q = (e - cosine * n[:, None]) / sine
    by_scaled_position = n[:, None] / (size * k) - q / size
    by_height = -((p / axes_m) @ by_scaled_position) - np.einsum(
        "ij,ij->j", scaled / axes_m[:, None], by_scaled_direction
    )
    return LimbAngle(
        delta=delta,
        by_direction=by_direction,
        by_rotation=np.array(cross(by_direction, los_cam)),
        by_position=by_scaled_position / axes_m[:, None],
        by_height=by_height,
    )
