"""An image with one edge: the limb that is trusted.

For methods that take every edge of an image. Within a band about the limb the image stays as it is; further in, each
direction from the nadir has the level that the band ends with there, and deep inside all have the same; further out all
is the level of space. A piece of limb that is not trusted is painted over with that level, and its neighbours sink to
it slowly: a step at the end of a piece would be an edge of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.pixel_directions import PIXEL_DIRECTIONS
from horizonval.estimation.limb.shape.cone import limb_directions
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.cone import Cone
from horizonval.geometry.directions import off_axis_angle, tangent_basis

BoolArray = NDArray[np.bool_]

BAND_PX = 12.0
BLEND_PX = 6.0
CLEAR_PX = 4.0
"""Nearer to the limb than this the level is not read."""
RAMP_PX = 40.0
"""Length of limb over which it sinks: a tenth of the steepness of an edge of a few pixels."""
FADE_PX = 40.0
"""Depth over which all directions get one level: towards the nadir they crowd."""
GAP_PX = 2.5
"""Gaps between points up to twice this are none."""
RIM_PX = 8.0
"""No point is looked for so near to the image's rim; that none is there is no reason for distrust."""
BINS = 720
SMOOTHED_BINS = 9


def cleaned(image: FloatArray, camera: CameraModel, cone: Cone, los_cam: FloatArray) -> FloatArray:
    """Return the cleaned image, shape (H, W), float64.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : CameraModel
    cone : Cone
    los_cam : ndarray, shape (n, 3)
        Trusted limb points.
    """
    grey = np.asarray(image, dtype=np.float64)
    d_cam = PIXEL_DIRECTIONS.of(camera)
    seen = np.asarray(np.isfinite(d_cam).all(axis=-1))
    d_cam = np.where(seen[..., None], d_cam, (0.0, 0.0, 1.0))
    focal = max(camera.fx, camera.fy)
    rho = float(off_axis_angle(los_cam, cone.axis_cam).mean())
    depth_px = (rho - off_axis_angle(d_cam, cone.axis_cam)) * focal
    column = _bins(d_cam, cone)
    px_per_bin = np.sin(rho) * focal * 2.0 * np.pi / BINS
    trusted = np.zeros(BINS, dtype=bool)
    trusted[_bins(los_cam, cone)] = True
    trusted = _closed(trusted, int(np.ceil(GAP_PX / px_per_bin)))
    looked = np.zeros(BINS, dtype=bool)
    looked[_bins(limb_directions(camera, cone.axis_cam, rho, RIM_PX), cone)] = True
    weight = np.clip(_distance(looked & ~trusted) * px_per_bin / RAMP_PX, 0.0, 1.0)
    near = seen & (np.abs(depth_px) > CLEAR_PX) & (np.abs(depth_px) <= BAND_PX) & trusted[column]
    outside = grey[near & (depth_px < 0)]
    outer = float(np.median(outside)) if len(outside) else float(grey.min())
    inner = _inner_levels(grey, near & (depth_px > BAND_PX - BLEND_PX), column, outer)
    mix = np.exp(-np.maximum(depth_px - BAND_PX, 0.0) / FADE_PX)
    level = mix * inner[column] + (1.0 - mix) * float(np.median(inner[trusted]))
    contrast = 1.0 - mix * (1.0 - weight[column])
    flat = np.where(depth_px > 0.0, level, outer)
    # The band fades into the flat level: no step where it ends.
    keep = np.clip((BAND_PX - np.abs(depth_px)) / BLEND_PX, 0.0, 1.0)
    whole = keep * grey + (1.0 - keep) * flat
    return np.where(seen, outer + contrast * (whole - outer), outer)


def _bins(d_cam: FloatArray, cone: Cone) -> NDArray[np.int64]:
    across = d_cam @ tangent_basis(cone.axis_cam)
    azimuth = np.arctan2(across[..., 1], across[..., 0])
    return np.floor((azimuth + np.pi) / (2.0 * np.pi) * BINS).astype(np.int64) % BINS


def _inner_levels(grey: FloatArray, member: BoolArray, column: NDArray[np.int64], default: float) -> FloatArray:
    """Return the mean of an image's members by bin, smoothed; empty bins get what lies between their neighbours."""
    count = np.bincount(column[member], minlength=BINS)
    filled = np.flatnonzero(count)
    if not len(filled):
        return np.full(BINS, default)
    total = np.bincount(column[member], weights=grey[member], minlength=BINS)
    level = np.interp(np.arange(BINS), filled, total[filled] / count[filled], period=BINS)
    return np.asarray(uniform_filter1d(level, SMOOTHED_BINS, mode="wrap"))


def _closed(trusted: BoolArray, reach: int) -> BoolArray:
    """Close gaps of up to twice ``reach`` bins."""
    grown = np.any([np.roll(trusted, k) for k in range(-reach, reach + 1)], axis=0)
    return np.asarray(~np.any([np.roll(~grown, k) for k in range(-reach, reach + 1)], axis=0))


def _distance(where: BoolArray) -> FloatArray:
    """Return every bin's distance to the nearest one that is set [bins]; the number of bins if none is."""
    places = np.flatnonzero(where)
    if not len(places):
        return np.full(BINS, float(BINS))
    gap = np.abs(np.arange(BINS)[:, None] - places[None, :])
    return np.asarray(np.minimum(gap, BINS - gap).min(axis=1), dtype=np.float64)
