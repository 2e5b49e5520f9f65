"""The selection of limb points that lie at one height above the Earth.

Levels are read outside and inside of every point across the limb. Points are left out that are

* *saturated*: where the bright side reaches full scale the edge is that of the air's tail, kilometres too high;
* *faded*: towards the terminator the limb darkens and rises, so that points whose step is a small share of the step
  elsewhere on the limb are left out;
* *faint*: where the Sun's direction is known, so is the height towards the terminator
  (:mod:`horizonval.estimation.guard.sunlit`), and a point need only exceed the noise;
* *restless*: the outer side varies (Sun's halo, Moon, ghost) by more than a share of the step;
* *alone*: points outside of any unbroken stretch of some length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.cone import arc_order
from horizonval.estimation.limb.picture import ROSE_SIGMAS, Picture
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import tangent_basis

BoolArray = NDArray[np.bool_]

SATURATED_SHARE = 0.97
"""Share of full scale from which a pixel is saturated; converter noise may keep it a little below."""
FADED_SHARE = 0.3
"""Smallest step relative to the limb's strong steps (their 90th percentile)."""
RESTLESS_SHARE = 0.25
"""Largest range of outer levels relative to the limb's typical step, its upper quartile."""
SMOOTHED_RAD = float(np.deg2rad(4.0))
"""Length of limb, by azimuth, over which the step is averaged first: clouds vary faster along it than sunlight."""
GAP_PX = 6.0
"""Largest gap between neighbours of one stretch, whose points are a pixel apart."""
SHORTEST_STRETCH_PX = 20.0
"""Two profiles long: over less the bright and dark sides of a cloud's edge decide."""
NEAR_PX = (3.0, 4.0, 5.0, 6.0)
"""Distances from the limb at which its sides are read: from beyond a lens's blur to the search range."""
DEEP_PX = (6.0, 8.0, 10.0, 12.0)
"""Twice the distances: levels of Earth and space themselves."""


@dataclass(frozen=True)
class Sides:
    """Grey levels at both sides of limb points, shape (n,) each.

    ``inner``, ``outer``: 3 to 12 px within and outside; ``peak``: maximum within 6 px inside, the reach of a profile;
    ``spread``: half the range of outer levels; ``azimuth``: about the cone's axis [rad].
    """

    inner: FloatArray
    outer: FloatArray
    peak: FloatArray
    spread: FloatArray
    azimuth: FloatArray


def read_sides(picture: Picture, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray) -> Sides:
    """Read the image at both sides of limb points (n, 3), along the direction to the cone's axis."""
    inwards = axis_cam - los_cam * (los_cam @ axis_cam)[:, None]
    inwards /= np.linalg.norm(inwards, axis=1)[:, None]
    rad_per_px = 1.0 / max(camera.fx, camera.fy)
    distances = np.array(NEAR_PX + DEEP_PX)
    steps = np.array([distances, -distances]) * rad_per_px
    inside, outside = _levels(picture.mean, camera, los_cam + steps[:, :, None, None] * inwards)
    # A pixel outside the image has no level; a point has at least its nearest ones.
    inner, outer = _median(inside), _median(outside)
    near = inside[: len(NEAR_PX)]
    peak = np.where(np.isnan(near), -np.inf, near).max(axis=0)
    lit = ~np.isnan(outside)
    highest, lowest = np.where(lit, outside, -np.inf).max(axis=0), np.where(lit, outside, np.inf).min(axis=0)
    spread = np.where(lit.any(axis=0), 0.5 * (highest - lowest), 0.0)
    across = los_cam @ tangent_basis(axis_cam)
    return Sides(inner, outer, peak, spread, np.arctan2(across[:, 1], across[:, 0]))


def saturated(sides: Sides, full_scale: float) -> BoolArray:
    """Return which points have a saturated Earth side."""
    return np.asarray((sides.peak >= SATURATED_SHARE * full_scale) & (sides.inner > sides.outer))


def faded(sides: Sides) -> BoolArray:
    """Return which points have a step, averaged over a piece of limb, far below what it is elsewhere."""
    step = smoothed(np.abs(sides.inner - sides.outer), sides.azimuth)
    return np.asarray(step < FADED_SHARE * np.percentile(step, 90.0))


def faint(sides: Sides, noise: float, bright_inside: bool = True) -> BoolArray:
    """Return which points have a limb, averaged over a piece, below the pixel noise; the brighter side is compared."""
    step = sides.peak - sides.outer if bright_inside else sides.outer - sides.inner
    return np.asarray(smoothed(step, sides.azimuth) < ROSE_SIGMAS * noise)


def restless(sides: Sides) -> BoolArray:
    """Return which points have an outer side that varies by more than a share of the limb's typical step."""
    return np.asarray(sides.spread > RESTLESS_SHARE * np.percentile(np.abs(sides.inner - sides.outer), 75.0))


def _levels(image: NDArray[np.float32], camera: CameraModel, d_cam: FloatArray) -> FloatArray:
    """Return the levels of the pixels that directions (..., 3) fall on; NaN outside the image."""
    uv, in_front = project(camera, d_cam)
    height, width = image.shape
    good: BoolArray = np.logical_and(in_front, np.isfinite(uv).all(axis=-1))
    column, row = np.moveaxis(np.rint(np.where(good[..., None], uv, -1.0)).astype(np.int64), -1, 0)
    good &= (column >= 0) & (row >= 0) & (column < width) & (row < height)
    out = np.full(good.shape, np.nan)
    out[good] = image[row[good], column[good]]
    return out


def _median(values: FloatArray) -> FloatArray:
    """Return the medians of the columns of (k, n) without their NaN; 0 for a column that holds nothing else."""
    ordered = np.sort(values, axis=0)
    count = len(values) - np.isnan(values).sum(axis=0)
    column = np.arange(values.shape[1])
    low, high = ordered[np.maximum(count - 1, 0) // 2, column], ordered[count // 2 % len(values), column]
    return np.where(count > 0, np.where(count % 2 == 1, low, (low + high) / 2.0), 0.0)


def alone(los_cam: FloatArray, camera: CameraModel) -> BoolArray:
    """Return which points form no long unbroken stretch: spots between clouds, which affect them too."""
    uv, _ = project(camera, los_cam)
    order = arc_order(los_cam, fit_cone(los_cam).axis_cam)
    step = np.hypot(*np.diff(np.vstack([uv[order], uv[order[:1]]]), axis=0).T)
    breaks = np.flatnonzero(step > GAP_PX)
    bad = np.zeros(len(los_cam), dtype=bool)
    if not len(breaks):
        return bad
    # A stretch runs from behind one break to the next, round the circle.
    piece = np.searchsorted(breaks, np.arange(len(order)), side="left") % len(breaks)
    length = np.bincount(piece, weights=np.where(step > GAP_PX, 0.0, step), minlength=len(breaks))
    bad[order] = length[piece] < SHORTEST_STRETCH_PX
    return bad


def smoothed(values: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return the mean of values over the neighbours within half of SMOOTHED_RAD of azimuth."""
    order = np.argsort(azimuth, kind="stable")
    a = azimuth[order]
    total = np.concatenate([[0.0], np.cumsum(values[order])])
    low = np.searchsorted(a, a - 0.5 * SMOOTHED_RAD, side="left")
    high = np.searchsorted(a, a + 0.5 * SMOOTHED_RAD, side="right")
    out = np.empty_like(values)
    out[order] = (total[high] - total[low]) / (high - low)
    return out
