"""Points where a soft limb is steepest, and the covariance that the detector's noise gives a cone through them.

**Position.** The area under a profile (:mod:`horizonval.estimation.limb.edges`) is exact for a hard edge and any
symmetric spread. Air has a tail of tens of kilometres, and how much of it counts depends on the window and the field
angle. The steepest position is where a ray's optical depth passes one, which depends on the air and hardly on window,
saturation, clouds or Sun. The profile is read by bilinear interpolation in equal steps of angle towards the cone's
axis, smoothed by a Gaussian of one pixel, and differentiated; a parabola through the largest step and its neighbours
gives the position.

**Covariance.** Residuals of the points hold patterns that another exposure repeats (phase of the pixels, clouds, shape
of the Earth). The noise is therefore propagated through the search, which is linear in the image except for its last
step. With slopes ``s-, s0, s+`` about the steepest sample, ``c = s- - 2 s0 + s+`` and the parabola's top ``p = (s- -
s+) / (2 c)``, a small change of the image moves a point by

    dp = ((1/2 - p) ds- + 2 p ds0 - (1/2 + p) ds+) / c

and, slopes being sums over samples, by ``sum_k w_k dI_k``. Samples that are interpolated linearly between independent
pixels of variance ``v``, at any phase, have the covariance ``v B(x)`` at the distance ``x``, with ``B`` the cubic
spline of unit area. Along the limb neighbours share pixels, too: over points ``d`` pixels apart ``B`` adds up to ``1 /
d``, which makes a sum over points as uncertain as one of independent points with that much more variance.

**Noise of the pixels** is measured near the limb by Immerkaer's operator, which is blind to edges and smooth shading:
one variance in space, and one that grows in proportion to the grey level, as for counted electrons. Where space is cut
off at the converter's lowest level, that of the Earth's side is used for all. Texture of the ground finer than two
pixels counts as noise.

Neglected: the effect of noise on the direction of the profiles and the choice of points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.ndimage import gaussian_filter1d, map_coordinates

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.cone import arc_order, cone_gain
from horizonval.estimation.limb.picture import IMMERKAER, MEDIAN_TO_SIGMA, median, noise_sigma
from horizonval.estimation.limb.pyramid import trace_limb
from horizonval.geometry.camera import CameraModel, project

SEARCH_PX = 6.0
"""Search range for the steepest position about a point of the limb search."""
NEEDED_PX = 4.0
"""How much of a profile must lie in the image to both sides, and is read beyond the search: the smoothing's reach."""
REACH_PX = SEARCH_PX + NEEDED_PX
STEP_PX = 0.5
"""Sample spacing: half of the smoothing, so that a parabola through three samples finds the maximum."""
SIGMA_PX = 1.0
"""Smoothing along a profile: about a lens's own blur."""
PASSES = 2
"""Passes; the second samples the profile about the position of the first."""
ROUNDING = 1e-9
"""Slope, relative to the image's largest level, that interpolation leaves of a uniform image."""


def to_steepest(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, bright_inside: bool
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Move lines of sight across the limb to the steepest position; return (m, 3), and their input rows (m,).

    ``los_cam``: shape (n, 3), right to a few pixels; ``axis_cam``: shape (3,), of their cone; ``bright_inside``: grey
    level rises towards the axis. Points leave whose profile is not in the image or steepest outside the search.
    """
    kept = np.arange(len(los_cam))
    los = los_cam
    for _ in range(PASSES):
        if not len(los):
            break
        shift, good = _shift(image, camera, los, axis_cam, 1.0 if bright_inside else -1.0)
        inwards = inwards_of(los, axis_cam)
        los = (np.cos(shift)[:, None] * los + np.sin(shift)[:, None] * inwards)[good]
        kept = kept[good]
    return los, kept


def inwards_of(los: FloatArray, axis: FloatArray) -> FloatArray:
    """Return unit vectors (n, 3) across lines of sight (n, 3) towards an axis."""
    inwards = axis - los * (los @ axis)[:, None]
    return np.asarray(inwards / np.linalg.norm(inwards, axis=1)[:, None])


def _shift(
    image: FloatArray, camera: CameraModel, los: FloatArray, axis: FloatArray, sign: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return how far inwards [rad] the steepest place lies, and whether there is one."""
    offset_px, profile, in_view = _profiles(image, camera, los, axis)
    slope = sign * gaussian_filter1d(profile, SIGMA_PX / STEP_PX, axis=1, order=1)
    slope[(np.abs(offset_px) > SEARCH_PX) | ~in_view] = -np.inf
    best, (before, middle, after) = _steepest(slope)
    good = in_view[:, np.abs(offset_px) <= NEEDED_PX].all(axis=1) & np.isfinite(before) & np.isfinite(after)
    # Interpolation leaves rounding on a level image, which is no slope.
    good &= middle > ROUNDING * float(max(image.max(), -image.min()))
    with np.errstate(invalid="ignore", divide="ignore"):
        parabola = 0.5 * (before - after) / (before - 2.0 * middle + after)
    parabola = np.clip(np.where(good, parabola, 0.0), -1.0, 1.0)
    rad_per_px = 1.0 / max(camera.fx, camera.fy)
    return (offset_px[best] + STEP_PX * np.nan_to_num(parabola)) * rad_per_px, good


def _profiles(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return offsets inwards (k,) [px], levels there (n, k), those of the rim beyond it, and which are in the image."""
    offset_px = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    angle = offset_px * (1.0 / max(camera.fx, camera.fy))
    inwards = inwards_of(los_cam, axis_cam)
    rays = np.cos(angle)[None, :, None] * los_cam[:, None] + np.sin(angle)[None, :, None] * inwards[:, None]
    uv, in_front = project(camera, rays)
    most = (camera.width - 1.0, camera.height - 1.0)
    with np.errstate(invalid="ignore"):
        in_view = in_front & ((uv >= 0.0) & (uv <= most)).all(axis=-1)
    u, v = np.moveaxis(np.clip(np.nan_to_num(uv), 0.0, most), -1, 0)
    return offset_px, map_coordinates(image, [v, u], order=1), in_view


def _steepest(slope: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the column of the largest slope of every profile (n, k), and it with its neighbours, shape (3, n)."""
    best = np.clip(np.argmax(slope, axis=1), 1, slope.shape[1] - 2)
    return best, slope[np.arange(len(slope)), best + np.array([[-1], [0], [1]])]


DISTANCES_PX = np.concatenate([np.arange(-29.0, -4.0, 2.0), np.arange(5.0, 30.0, 2.0)])
"""Distances inside the limb of the pixels that noise is read from: none of the limb's own profile, the same light."""
MOST_PLACES = 512
"""Places along the limb: more than a variance known to two percent takes."""
FEWEST_PIXELS = 50
"""Smallest number of pixels of either side: their variance is then known to a fifth."""
NEAR_TOP_PX = 2.0
"""Largest distance of a point from the steepest sample: twice the smoothing is the same edge."""
CLIPPED_SHARE = 0.1
"""Share of space pixels at one lowest level above which noise is clipped."""
SATURATED_SHARE = 0.97
"""Share of full scale from which a pixel is saturated; converter noise may keep it a little below."""


@dataclass(frozen=True)
class PixelNoise:
    """Variance of a pixel by its grey level: ``floor`` at the level ``dark``, growing, and never below ``least``."""

    floor: float
    growth: float = 0.0
    dark: float = 0.0
    least: float = 0.0

    def variance(self, level: FloatArray) -> FloatArray:
        return np.maximum(self.floor + self.growth * (level - self.dark), self.least)


def pixel_noise(
    image: FloatArray, camera: CameraModel, axis_cam: FloatArray, rho_rad: float, full_scale: float | None = None
) -> PixelNoise:
    """Return the noise of an image (H, W) from pixels next to a cone's limb.

    Pixels near ``full_scale`` are saturated and show no noise.
    """
    trace = trace_limb(camera, axis_cam, rho_rad, 1.0, MOST_PLACES)
    places = np.rint(trace.uv + DISTANCES_PX[:, None, None] * trace.inwards).astype(np.intp)
    u, v = np.moveaxis(places, -1, 0)
    usable = (v > 0) & (u > 0) & (v < image.shape[0] - 1) & (u < image.shape[1] - 1)
    first = (v - 1) * image.shape[1] + u - 1
    window = first[usable, None, None] + np.arange(3) + image.shape[1] * np.arange(3)[:, None]
    near = image.ravel()[window]
    level, inside = near.mean(axis=(1, 2)), np.broadcast_to(DISTANCES_PX[:, None] > 0.0, u.shape)[usable]
    if full_scale is not None:
        unsaturated = level < SATURATED_SHARE * full_scale
        near, level, inside = near[unsaturated], level[unsaturated], inside[unsaturated]
    if min(np.count_nonzero(inside), np.count_nonzero(~inside)) < FEWEST_PIXELS:
        return PixelNoise(noise_sigma(image) ** 2)
    square = (np.einsum("ijk,jk->i", near, IMMERKAER) * (MEDIAN_TO_SIGMA / float(np.linalg.norm(IMMERKAER)))) ** 2
    of_ground, beyond = median(square[inside]), near[~inside, 1, 1]
    if float(np.mean(beyond == beyond.min())) > CLIPPED_SHARE:
        return PixelNoise(of_ground)
    dark, floor = median(level[~inside]), median(square[~inside])
    step = median(level[inside]) - dark
    return PixelNoise(floor, (of_ground - floor) / step if step else 0.0, dark, min(floor, of_ground))


def noise_covariance(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, noise: PixelNoise, sign: float
) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of (axis along basis 1, basis 2, half-angle).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. ``los_cam``: shape (n, 3), n >= 3,
    steepest positions; ``sign``: 1 if the level rises inwards, else -1. Raises ``LinAlgError``: no cone is determined.
    """
    offset_px, profile, _ = _profiles(image, camera, los_cam, axis_cam)
    # Reflected ends, as the search has them.
    slope_of = sign * gaussian_filter1d(np.eye(len(offset_px)), SIGMA_PX / STEP_PX, axis=0, order=1)
    slope = profile @ slope_of.T
    # The points are steepest places already: another edge further off is none of theirs.
    best, (before, middle, after) = _steepest(np.where(np.abs(offset_px) <= NEAR_TOP_PX, slope, -np.inf))
    bend = before - 2.0 * middle + after
    bend = np.where(bend < 0.0, bend, -np.inf)[:, None]  # A point without a top has none that moves.
    top = np.clip(0.5 * (before - after)[:, None] / bend, -1.0, 1.0)
    weight = (0.5 - top) * slope_of[best - 1] + 2.0 * top * slope_of[best] - (0.5 + top) * slope_of[best + 1]
    weight *= np.sqrt(noise.variance(profile)) / bend
    apart = np.abs(offset_px[:, None] - offset_px[None, :])
    shared = np.nan_to_num(BSpline.basis_element(np.arange(-2.0, 3.0), extrapolate=False)(apart))
    rad_per_sample = STEP_PX / max(camera.fx, camera.fy)
    variance = rad_per_sample**2 * np.einsum("ij,ij->i", weight @ shared, weight)
    order = arc_order(los_cam, axis_cam)
    step_px = np.linalg.norm(np.diff(los_cam[order], axis=0), axis=1) * max(camera.fx, camera.fy)
    # The mean distance to both neighbours; a gap is no distance.
    variance[order] /= np.clip(0.5 * (np.append(step_px, step_px[-1]) + np.insert(step_px, 0, step_px[0])), 0.1, 1.0)
    # A point that the image moves inwards is seen at a smaller angle from the axis.
    gain = cone_gain(los_cam, axis_cam)
    return np.asarray((gain * variance) @ gain.T)
