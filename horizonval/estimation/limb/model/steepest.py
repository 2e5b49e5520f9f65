"""Sub-pixel position of a soft limb: where the profile along the limb's own normal is steepest.

The area under a profile (:mod:`horizonval.estimation.limb.subpixel`) is exact for a hard edge and for any symmetric
spread. Air is neither: its tail goes on for tens of kilometres, and how much of it counts depends on the window's
length across the limb, which changes with the slant of a column against it and with the field angle. The steepest
place is where a ray's optical depth passes one. That is a property of the air and hardly of window, saturation, clouds
or Sun. On rendered limbs seen from 300 to 1500 km the bow that is left along an arc pulls the nadir by 0.03 deg
(median); with the area it is 0.11 deg.

The profile is read by bilinear interpolation in equal steps of angle along the direction to the cone's axis, smoothed
by a Gaussian of one pixel, and differentiated; a parabola through the largest step and its neighbours gives the place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d, map_coordinates

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, project

SEARCH_PX = 6.0
"""As far as the steepest place is sought from the point that a search has found. Chosen."""
NEEDED_PX = 4.0
"""How much of a profile must lie in the image to both sides, and is read beyond the search: the smoothing's reach."""
REACH_PX = SEARCH_PX + NEEDED_PX
STEP_PX = 0.5
"""Between samples: half of the smoothing, so that a parabola through three of them holds its top."""
SIGMA_PX = 1.0
"""Of the smoothing along a profile: about a lens's own blur."""
PASSES = 2
"""The second reads the profile about the place that the first has found."""
ROUNDING = 1e-9
"""Of the image's largest level: a slope as small is what interpolation leaves of a level image."""


def to_steepest(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, bright_inside: bool
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Move lines of sight across the limb to the steepest place of the image.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : CameraModel
    los_cam : ndarray, shape (n, 3)
        Unit lines of sight to the limb, right to a few pixels.
    axis_cam : ndarray, shape (3,)
        Axis of the cone through them; profiles run towards it.
    bright_inside : bool
        Whether the grey level rises towards the axis.

    Returns
    -------
    los_cam : ndarray, shape (m, 3)
        Points whose profile lies within the image and has its steepest place inside the search, m <= n.
    kept : ndarray of int, shape (m,)
        Their rows in the input.
    """
    kept = np.arange(len(los_cam))
    los = los_cam
    for _ in range(PASSES):
        if not len(los):
            break
        shift, good = _shift(image, camera, los, axis_cam, 1.0 if bright_inside else -1.0)
        inwards = _inwards(los, axis_cam)
        los = (np.cos(shift)[:, None] * los + np.sin(shift)[:, None] * inwards)[good]
        kept = kept[good]
    return los, kept


def _inwards(los: FloatArray, axis: FloatArray) -> FloatArray:
    inwards = axis - los * (los @ axis)[:, None]
    return np.asarray(inwards / np.linalg.norm(inwards, axis=1)[:, None])


def _shift(
    image: FloatArray, camera: CameraModel, los: FloatArray, axis: FloatArray, sign: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return how far inwards [rad] the steepest place lies, and whether there is one."""
    offset_px, uv, in_view = profile_places(camera, los, axis)
    profile = map_coordinates(image, [uv[:, 1], uv[:, 0]], order=1).reshape(in_view.shape)
    slope = sign * gaussian_filter1d(profile, SIGMA_PX / STEP_PX, axis=1, order=1)
    slope[(np.abs(offset_px) > SEARCH_PX) | ~in_view] = -np.inf
    best = steepest_sample(slope)
    row = np.arange(len(los))
    before, middle, after = slope[row, best - 1], slope[row, best], slope[row, best + 1]
    good = in_view[:, np.abs(offset_px) <= NEEDED_PX].all(axis=1) & np.isfinite(before) & np.isfinite(after)
    # Interpolation leaves rounding on a level image, which is no slope.
    good &= middle > ROUNDING * float(max(image.max(), -image.min()))
    with np.errstate(invalid="ignore", divide="ignore"):
        parabola = 0.5 * (before - after) / (before - 2.0 * middle + after)
    parabola = np.clip(np.where(good, parabola, 0.0), -1.0, 1.0)
    rad_per_px = 1.0 / max(camera.fx, camera.fy)
    return (offset_px[best] + STEP_PX * np.nan_to_num(parabola)) * rad_per_px, good


def profile_places(
    camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return where the profiles across a limb are read.

    Parameters
    ----------
    camera : CameraModel
    los_cam : ndarray, shape (n, 3)
        Middles of the profiles.
    axis_cam : ndarray, shape (3,)
        Profiles run towards it.

    Returns
    -------
    offset_px : ndarray, shape (k,)
        Distance of the samples from the middle, inwards.
    uv : ndarray, shape (n k, 2)
        Pixel coordinates. Beyond the rim the profile goes on level, which makes no edge.
    in_view : ndarray of bool, shape (n, k)
        Which samples lie within the image.
    """
    offset_px = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    angle = offset_px * (1.0 / max(camera.fx, camera.fy))
    inwards = _inwards(los_cam, axis_cam)
    rays = np.cos(angle)[None, :, None] * los_cam[:, None] + np.sin(angle)[None, :, None] * inwards[:, None]
    uv, in_front = project(camera, rays.reshape(-1, 3))
    most = (camera.width - 1.0, camera.height - 1.0)
    with np.errstate(invalid="ignore"):
        in_view = in_front & ((uv >= 0.0) & (uv <= most)).all(axis=1)
    return offset_px, np.clip(np.nan_to_num(uv), 0.0, most), in_view.reshape(len(los_cam), len(offset_px))


def steepest_sample(slope: FloatArray) -> NDArray[np.int64]:
    """Return the column of the largest slope of every profile (n, k), with a neighbour to both sides."""
    return np.clip(np.argmax(slope, axis=1), 1, slope.shape[1] - 2)
