r"""How the limb moves in an image when the camera turns or moves, or when the limb rises: exact, of an ellipsoid.

Scaled by the axes ``s`` the ellipsoid is the unit sphere, the camera stands at ``p = r / s`` and looks along
``e = d / s``. The tangent cone's function (:func:`horizonval.geometry.horizon.limb_side`, scaled)::

    F = -p . e - sqrt(|p|^2 - 1) |e|

is positive inside the limb and zero on it, and its derivatives are closed::

    dF/de = -p - k e / |e|,    dF/dp = -e - |e| p / k,    k = sqrt(|p|^2 - 1)
    dF/dd = (dF/de) / s,       dF/dr = (dF/dp) / s
    dF/dh = -sum over axes of (p dF/dp + e dF/de) / s          all axes longer by the height h of the limb
    dF/dtheta = d x dF/dd                                     the camera turns by theta, and what it sees with it

Light that hangs on the height over the ground moves with the contours of F: from a change dF by a motion of the camera
it follows by ``dI = (dI/dF) dF``, and ``dI/dF = grad I . grad F / |grad F|^2`` in the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, unproject


@dataclass(frozen=True, eq=False)
class LimbMotion:
    """Of n pixels.

    Attributes
    ----------
    value : ndarray, shape (n,)
        F.
    by_pixel : ndarray, shape (2, n)
        Its change by column and row [1/px].
    by_pose : ndarray, shape (7, n)
        By a turn in camera axes [1/rad], by position in Earth-fixed axes [1/m], by the height of the limb [1/m].
    """

    value: FloatArray
    by_pixel: FloatArray
    by_pose: FloatArray

    @property
    def distance_px(self) -> FloatArray:
        """How far inside the limb the pixels lie in the image, shape (n,)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.value / np.hypot(*self.by_pixel))

    @property
    def height_m(self) -> FloatArray:
        """How high above the limb the pixels look past the Earth, shape (n,): the rise that brings the limb to them."""
        return np.asarray(-self.value / self.by_pose[6])


def limb_motion(
    camera: CameraModel, uv: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray
) -> LimbMotion:
    """Return how the limb moves over pixels.

    Parameters
    ----------
    camera : CameraModel
    uv : ndarray, shape (n, 2)
        Column and row.
    cam_from_itrs : ndarray, shape (3, 3)
    r_itrs : ndarray, shape (3,)
        Outside the ellipsoid [m].
    axes_m : ndarray, shape (3,)
        Semi-axes, the height of the limb included.

    Returns
    -------
    LimbMotion
        NaN where a pixel sees nothing. An image of one row has no change by row, and one of one column none by column:
        nothing in it shows a motion that way.
    """
    p = r_itrs / axes_m
    k = float(np.sqrt(p @ p - 1.0))
    los = unproject(camera, uv).T
    scaled = (cam_from_itrs.T @ los) / axes_m[:, None]
    length = np.linalg.norm(scaled, axis=0)
    by_scaled = -p[:, None] - k * scaled / length
    by_place = -scaled - length * (p / k)[:, None]
    by_direction = cam_from_itrs @ (by_scaled / axes_m[:, None])
    by_height = -((p / axes_m) @ by_place + np.einsum("ij,ij->j", scaled / axes_m[:, None], by_scaled))
    by_pixel = np.zeros((2, uv.shape[0]))
    for axis, size in enumerate((camera.width, camera.height)):
        if size > 1:
            half = np.array([0.5, 0.0]) if axis == 0 else np.array([0.0, 0.5])
            across = unproject(camera, uv + half).T - unproject(camera, uv - half).T
            by_pixel[axis] = np.einsum("ij,ij->j", by_direction, across)
    turn = np.cross(los, by_direction, axis=0)
    return LimbMotion(
        value=-p @ scaled - k * length,
        by_pixel=by_pixel,
        by_pose=np.concatenate([turn, by_place / axes_m[:, None], by_height[None]]),
    )
