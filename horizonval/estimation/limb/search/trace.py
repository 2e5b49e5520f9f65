"""Where the limb of a cone runs in an image, and which way across it the Earth lies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.ranks import median
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.rotation import tangent_basis

AZIMUTHS = 768
"""At which a cone is looked at first. They are dense towards the middle of the image: a telescope sees a degree."""
STEP_RAD = 1e-5
"""Over which the way across the limb is taken: far above rounding, far below a pixel."""


@dataclass(frozen=True)
class Trace:
    """Places along the limb of a cone, in order of azimuth, n of them.

    Attributes
    ----------
    uv : ndarray, shape (n, 2)
        [px].
    inwards : ndarray, shape (n, 2)
        Unit vector across the limb, to the axis.
    px_rad : ndarray, shape (n,)
        Angle of a pixel across the limb.
    azimuth : ndarray, shape (n,)
        [rad], from -pi to pi.
    spacing : float
        Pixels of limb between two places.
    """

    uv: FloatArray
    inwards: FloatArray
    px_rad: FloatArray
    azimuth: FloatArray
    spacing: float

    @cached_property
    def middle_px_rad(self) -> float:
        """Median angle of a pixel across the limb."""
        return median(self.px_rad)

    def take(self, which: NDArray[np.bool_]) -> Trace:
        """Return some of the places."""
        return Trace(self.uv[which], self.inwards[which], self.px_rad[which], self.azimuth[which], self.spacing)


def trace_limb(
    camera: CameraModel, axis_cam: FloatArray, rho_rad: float, spacing_px: float, most: int | None = None
) -> Trace:
    """Return evenly spaced places along the limb of a cone that lie in the image.

    Parameters
    ----------
    camera : CameraModel
    axis_cam : ndarray, shape (3,)
    rho_rad : float
        Half-angle.
    spacing_px : float
        Of the places, at least.
    most : int, optional
        Places; of a longer limb they lie further apart.
    """
    basis = tangent_basis(axis_cam)
    middle = unproject(camera, np.array([(camera.width - 1) / 2.0, (camera.height - 1) / 2.0])) @ basis
    towards = float(np.arctan2(middle[1], middle[0])) if np.isfinite(middle).all() else 0.0
    t = np.linspace(-1.0, 1.0, AZIMUTHS)
    azimuth = towards + np.pi * t * np.abs(t)
    uv, seen = project(camera, on_cone(axis_cam, basis, rho_rad, azimuth))
    with np.errstate(invalid="ignore"):
        seen &= ((uv >= -0.5) & (uv <= (camera.width - 0.5, camera.height - 0.5))).all(axis=1)
        step = np.hypot(*np.diff(uv, axis=0).T)
    near = seen[1:] | seen[:-1]
    along = np.concatenate([[0.0], np.cumsum(np.where(near & np.isfinite(step), step, 0.0))])
    if along[-1] < 1.0:
        return Trace(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0), spacing_px)
    count = max(int(along[-1] / spacing_px), 2)
    count = count if most is None else min(count, most)
    wanted = (np.arange(count) + 0.5) * along[-1] / count
    azimuth = np.interp(wanted, along, azimuth)
    rho = rho_rad + STEP_RAD * np.array([0.0, -1.0, 1.0, 0.0])[:, None]
    around = np.array([azimuth, azimuth, azimuth, azimuth + STEP_RAD])
    # Across the limb in the image, which is not where the axis lies: at right angles to the limb itself.
    (uv, inner, outer, along_limb), (seen, seen_inner, seen_outer, _) = project(
        camera, on_cone(axis_cam, basis, rho, around)
    )
    with np.errstate(invalid="ignore"):
        seen &= seen_inner & seen_outer & ((uv >= 0.0) & (uv <= (camera.width - 1, camera.height - 1))).all(axis=1)
    tangent, radial = (along_limb - uv)[seen], (inner - outer)[seen]
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    normal /= np.maximum(np.hypot(*normal.T), 1e-300)[:, None]
    across = np.einsum("ij,ij->i", normal, radial)
    normal *= np.where(across < 0.0, -1.0, 1.0)[:, None]
    px_rad = 2.0 * STEP_RAD / np.maximum(np.abs(across), 1e-300)
    return Trace(uv[seen], normal, px_rad, np.arctan2(np.sin(azimuth[seen]), np.cos(azimuth[seen])), along[-1] / count)


def on_cone(axis: FloatArray, basis: FloatArray, rho: float | FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return lines of sight on cones, shape (..., 3), at azimuths (...) in a basis (3, 2) across their axis."""
    around = np.cos(azimuth)[..., None] * basis[:, 0] + np.sin(azimuth)[..., None] * basis[:, 1]
    return np.asarray(np.cos(rho)[..., None] * axis + np.sin(rho)[..., None] * around)
