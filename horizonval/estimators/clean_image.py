"""An image with one edge: the limb that is trusted.

For methods that take every edge of an image. Far from the limb, inside and outside, each pixel gets the mean level of
its side; within a band about the limb the image stays as it is where the limb is trusted. Where it is not, both sides
get the level of space, and the inner level sinks to it slowly along the limb so that no edge is made where there was
none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.geometry.camera import Camera, pixel_grid, unproject
from horizonval.limb.cone import Cone, off_axis_angle, tangent_basis

FloatArray = NDArray[np.float64]

BAND_PX = 12.0
BLEND_PX = 6.0
RAMP_RAD = 0.35
BINS = 720


def cleaned(image: FloatArray, camera: Camera, cone: Cone, los_cam: FloatArray) -> FloatArray:
    """Return the cleaned image, shape (H, W), float64.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : Camera
    cone : Cone
    los_cam : ndarray, shape (n, 3)
        Trusted limb points.
    """
    grey = np.asarray(image, dtype=np.float64)
    d_cam = unproject(camera, pixel_grid(camera))
    seen = np.asarray(np.isfinite(d_cam).all(axis=-1))
    d_cam = np.where(seen[..., None], d_cam, (0.0, 0.0, 1.0))
    rho = float(off_axis_angle(los_cam, cone.axis_cam).mean())
    depth_px = (rho - off_axis_angle(d_cam, cone.axis_cam)) * max(camera.fx, camera.fy)
    near = seen & (np.abs(depth_px) > 4.0) & (np.abs(depth_px) <= BAND_PX)
    basis = tangent_basis(cone.axis_cam)
    across = d_cam @ basis
    column = _bin(np.arctan2(across[..., 1], across[..., 0]))
    points = los_cam @ basis
    trusted = np.zeros(BINS, dtype=bool)
    trusted[_bin(np.arctan2(points[:, 1], points[:, 0]))] = True
    trusted = _closed(trusted)
    weight = _ramp(trusted)
    at_limb = near & trusted[column]
    inner = float(np.median(grey[at_limb & (depth_px > 0)])) if (at_limb & (depth_px > 0)).any() else float(grey.max())
    outer = float(np.median(grey[at_limb & (depth_px < 0)])) if (at_limb & (depth_px < 0)).any() else float(grey.min())
    flat = np.where(depth_px > 0, outer + (inner - outer) * weight[column], outer)
    # The band fades into the flat level: no step where it ends.
    keep = np.clip((BAND_PX - np.abs(depth_px)) / BLEND_PX, 0.0, 1.0) * trusted[column]
    return np.where(seen, keep * grey + (1.0 - keep) * flat, outer)


def _bin(azimuth: FloatArray) -> NDArray[np.int64]:
    return np.floor((azimuth + np.pi) / (2.0 * np.pi) * BINS).astype(np.int64) % BINS


def _closed(trusted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Close gaps of up to 2 deg."""
    reach = 2
    grown = np.any([np.roll(trusted, k) for k in range(-reach, reach + 1)], axis=0)
    return np.asarray(~np.any([np.roll(~grown, k) for k in range(-reach, reach + 1)], axis=0))


def _ramp(trusted: NDArray[np.bool_]) -> FloatArray:
    """Return 1 where trusted, sinking linearly to 0 over ``RAMP_RAD`` to either side."""
    if not trusted.any():
        return np.zeros(BINS)
    where = np.flatnonzero(trusted)
    gap = np.abs(np.arange(BINS)[:, None] - where[None, :])
    gap = np.minimum(gap, BINS - gap).min(axis=1) * (2.0 * np.pi / BINS)
    return np.clip(1.0 - gap / RAMP_RAD, 0.0, 1.0)
