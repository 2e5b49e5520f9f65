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

and, slopes being sums over pixels, by ``A dI``. With ``G`` the least-squares gain of a cone's (axis, axis, half-angle)
and independent pixels of variance ``v`` the covariance is ``G A diag(v) A^T G^T``, shared pixels included.

**Noise of the pixels** is measured near the limb by Immerkaer's operator, which is blind to edges and smooth shading:
one variance in space, and one that grows in proportion to the grey level, as for counted electrons. Where space is cut
off at the converter's lowest level, that of the Earth's side is used for all. Texture of the ground finer than two
pixels counts as noise.

Neglected: the effect of noise on the direction of the profiles and the choice of points.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.ndimage import gaussian_filter1d, map_coordinates

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import IMMERKAER, MEDIAN_TO_SIGMA, median, pixel_directions
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

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
    """Return where the profiles across a limb, from ``los_cam`` (n, 3) towards ``axis_cam`` (3,), are sampled.

    Result: offsets inwards (k,) [px]; pixel coordinates (n k, 2), beyond the rim those of the rim, which makes no edge;
    whether samples are in the image, (n, k).
    """
    offset_px = np.arange(-REACH_PX, REACH_PX + STEP_PX / 2, STEP_PX)
    angle = offset_px * (1.0 / max(camera.fx, camera.fy))
    inwards = inwards_of(los_cam, axis_cam)
    rays = np.cos(angle)[None, :, None] * los_cam[:, None] + np.sin(angle)[None, :, None] * inwards[:, None]
    uv, in_front = project(camera, rays.reshape(-1, 3))
    most = (camera.width - 1.0, camera.height - 1.0)
    with np.errstate(invalid="ignore"):
        in_view = in_front & ((uv >= 0.0) & (uv <= most)).all(axis=1)
    return offset_px, np.clip(np.nan_to_num(uv), 0.0, most), in_view.reshape(len(los_cam), len(offset_px))


def steepest_sample(slope: FloatArray) -> NDArray[np.int64]:
    """Return the column of the largest slope of every profile (n, k), with a neighbour to both sides."""
    return np.clip(np.argmax(slope, axis=1), 1, slope.shape[1] - 2)


NEAREST_PX, FARTHEST_PX = 5.0, 30.0
"""Distance from the limb of the pixels that noise is read from: none of the limb's own profile, the same light."""
FEWEST_PIXELS = 50
"""Smallest number of pixels of either side: their variance is then known to a fifth."""
NEAR_TOP_PX = 2.0
"""Largest distance of a point from the steepest sample: twice the smoothing is the same edge."""
CLIPPED_SHARE = 0.1
"""Share of space pixels at one lowest level above which noise is clipped."""
SATURATED_SHARE = 0.95
"""Share of full scale above which noise may be clipped."""
DIM_SHARE = 0.2
"""Share of the median step below which pixels say little about how the variance grows with the level."""


def pixel_variance(
    image: FloatArray, camera: CameraModel, axis_cam: FloatArray, rho_rad: float, full_scale: float | None = None
) -> FloatArray:
    """Return the noise variance of every pixel, shape (H, W), from the surroundings of a cone's limb.

    Pixels near ``full_scale`` are saturated and show no noise.
    """
    image32 = image.astype(np.float32)
    response = np.asarray(cv2.filter2D(image32, cv2.CV_32F, IMMERKAER), dtype=np.float64)
    square = response**2 * (MEDIAN_TO_SIGMA / float(np.linalg.norm(IMMERKAER))) ** 2
    level = np.asarray(cv2.blur(image32, (3, 3)), dtype=np.float64)
    usable = np.zeros(image.shape, dtype=bool)
    usable[1:-1, 1:-1] = True
    if full_scale is not None:
        usable &= level < SATURATED_SHARE * full_scale
    rows, depth_px = _beside(camera, axis_cam, rho_rad)
    seen = usable.ravel()[rows]
    inside, space = (np.unravel_index(rows[seen & side], image.shape) for side in (depth_px > 0.0, depth_px < 0.0))
    if len(inside[0]) < FEWEST_PIXELS or len(space[0]) < FEWEST_PIXELS:
        return np.full(image.shape, median(square[usable]))
    clipped = float(np.mean(image[space] == image[space].min())) > CLIPPED_SHARE
    if clipped:
        return np.full(image.shape, median(square[inside]))
    dark, floor = median(level[space]), median(square[space])
    step = level[inside] - dark
    bright = np.abs(step) > DIM_SHARE * median(np.abs(step))
    growth = median((square[inside][bright] - floor) / step[bright]) if bright.any() else 0.0
    return np.asarray(np.maximum(floor + growth * (level - dark), min(floor, median(square[inside]))))


def _beside(camera: CameraModel, axis_cam: FloatArray, rho_rad: float) -> tuple[NDArray[np.int64], FloatArray]:
    """Return which pixels, of the image in one row, lie beside a limb, and how far inside of it [px]."""
    px_per_rad = max(camera.fx, camera.fy)
    directions = pixel_directions(camera).reshape(-1, 3)
    # By the cosine first, a little further than it takes: one product in place of an arc tangent for every pixel.
    reach = (FARTHEST_PX + 1.0) / px_per_rad
    nearest, farthest = np.cos(np.clip([rho_rad - reach, rho_rad + reach], 0.0, np.pi))
    cosine = directions @ axis_cam
    rows = np.flatnonzero((cosine <= nearest + 1e-12) & (cosine >= farthest - 1e-12))
    depth_px = (rho_rad - off_axis_angle(directions[rows], axis_cam)) * px_per_rad
    near = (np.abs(depth_px) > NEAREST_PX) & (np.abs(depth_px) < FARTHEST_PX)
    return rows[near], depth_px[near]


def noise_covariance(
    image: FloatArray,
    camera: CameraModel,
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    variance: FloatArray,
    bright_inside: bool,
) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of (axis along basis 1, basis 2, half-angle).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. ``los_cam``: shape (n, 3), n >= 3,
    steepest positions; ``variance``: shape (H, W), independent pixel noise. Raises ``LinAlgError``: no cone is
    determined.
    """
    moved = _response(image, camera, los_cam, axis_cam, 1.0 if bright_inside else -1.0)
    across = los_cam @ tangent_basis(axis_cam)
    across /= np.linalg.norm(across, axis=1)[:, None]
    # A point that the image moves inwards is seen at a smaller angle from the axis.
    jacobian = np.column_stack([across, np.ones(len(across))])
    gain = np.linalg.solve(jacobian.T @ jacobian, jacobian.T)
    # Of a megapixel image the limb's points have seen some thousand pixels.
    seen = np.zeros(variance.size, dtype=bool)
    seen[moved.indices] = True
    pixels = np.flatnonzero(seen)
    places = np.searchsorted(pixels, moved.indices)
    moved = sparse.csr_matrix((moved.data, places, moved.indptr), shape=(len(los_cam), len(pixels)))
    of_pixels = (moved.T @ gain.T).T
    covariance = (of_pixels * variance.ravel()[pixels]) @ of_pixels.T
    return np.asarray(0.5 * (covariance + covariance.T))


def _response(
    image: FloatArray, camera: CameraModel, los: FloatArray, axis: FloatArray, sign: float
) -> sparse.csr_matrix:
    """Return how far inwards [rad] a unit of every pixel's grey level moves every point, shape (n, pixels)."""
    offset_px, uv, _ = profile_places(camera, los, axis)
    n, samples = len(los), len(offset_px)
    bilinear = _bilinear(uv, camera)
    # Reflected ends, as the search has them.
    slope_of = sign * gaussian_filter1d(np.eye(samples), SIGMA_PX / STEP_PX, axis=0, order=1)
    slope = (bilinear @ image.ravel()).reshape(n, samples) @ slope_of.T
    row = np.arange(n)
    # The points are steepest places already: another edge further off is none of theirs.
    best = steepest_sample(np.where(np.abs(offset_px) <= NEAR_TOP_PX, slope, -np.inf))
    before, middle, after = slope[row, best - 1], slope[row, best], slope[row, best + 1]
    bend = before - 2.0 * middle + after
    bend = np.where(bend < 0.0, bend, -np.inf)  # A point without a top has none that moves.
    top = np.clip(0.5 * (before - after) / bend, -1.0, 1.0)
    kernel = (
        ((0.5 - top) / bend)[:, None] * slope_of[best - 1]
        + (2.0 * top / bend)[:, None] * slope_of[best]
        - ((0.5 + top) / bend)[:, None] * slope_of[best + 1]
    )
    kernel *= STEP_PX / max(camera.fx, camera.fy)
    of_samples = sparse.csr_matrix(
        (kernel.ravel(), np.arange(n * samples), np.arange(0, n * samples + 1, samples)), shape=(n, n * samples)
    )
    return of_samples @ bilinear


def _bilinear(uv: FloatArray, camera: CameraModel) -> sparse.csr_matrix:
    """Return the weights that interpolate an image at places (k, 2), shape (k, H W)."""
    first = np.clip(np.floor(uv).astype(np.int64), 0, (camera.width - 2, camera.height - 2))
    right, down = (uv - first).T
    corner = first[:, 1] * camera.width + first[:, 0]
    columns = np.stack([corner, corner + 1, corner + camera.width, corner + camera.width + 1], axis=1)
    weights = np.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down], axis=1)
    ends = np.arange(0, 4 * len(uv) + 1, 4)
    return sparse.csr_matrix((weights.ravel(), columns.ravel(), ends), shape=(len(uv), camera.width * camera.height))
