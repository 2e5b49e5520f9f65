"""The limb's position below the pixel, from whole pixels across it.

The row or column of pixels through a point of the limb crosses it at 45 deg or more. Its levels are not interpolated,
and ``x_i`` are the distances of the pixels' ends inside the cone [px].

**Edge** (:func:`points_of`, of the search). Gauss-Newton finds the least squares of ::

    I = b + a E(x - d) + c x E(x - d),     E: mean over the pixel of Phi(x / s)

Space ``b``, step ``a``, shading ``c`` and shift ``d`` are separate, the width ``s`` is common to all. The pixel's
extent is part of the model, so that a hard edge is located as well as a soft one. The edge is odd about its middle:
asymmetry by the air moves all of a limb equally, which is a change of height. Neglected: on bare ground, without air,
the radiance an angle ``x`` inside the limb goes as ``sqrt(x)``; a straight line in its place moves the limb by 0.04
px, all of it equally.

**Steepest position** (:func:`to_steepest`, of the guard). It is where a ray's optical depth passes one, which depends
on the air and hardly on window, saturation, clouds or Sun. With ``D_i`` the differences of neighbouring pixels,
smoothed by a Gaussian ``G`` of one pixel, it is the ``d`` of ``f = sum D_i (x_i - d) G(x_i - d) = 0``.

**Covariance** of a cone through steepest positions. Their residuals hold patterns that another exposure repeats (phase
of the pixels, clouds, shape of the Earth). The noise of the pixels is therefore propagated: ``f`` is linear in them,
and ``d`` moves by ``-df / f'``. Points of one row or column share their pixels and count as one.

**Noise of the pixels** is measured near the limb by Immerkaer's operator, which is blind to edges and smooth shading:
one variance in space, and one that grows in proportion to the grey level, as for counted electrons. Where space is cut
off at the converter's lowest level, that of the Earth's side is used for all. Texture of the ground finer than two
pixels counts as noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.cone import cone_gain, inwards_of
from horizonval.estimation.limb.evidence import INNERMOST, REACH_PX, SHIFTS_PX, WIDTHS_PX, enough_known, inner_reach
from horizonval.estimation.limb.picture import IMMERKAER, MEDIAN_TO_SIGMA, median, noise_sigma
from horizonval.estimation.limb.pyramid import PyramidLevel, trace_limb
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.rotation import off_axis_angle

STEPS = 6
"""Steps of Newton's method from a pixel away; the next would change less than a hundredth of a pixel."""
SETTLED_PX = 0.5
"""A last step as long as that leads nowhere."""
SHARPEST_PX = 0.02
"""Smallest width: such an edge is hard to a hundredth of a pixel."""
TINY = 1e-9
"""Regularisation of a flat profile's equations, and slope that rounding leaves of it, for levels of unit size."""
SIGMA_PX = 1.0
"""Smoothing of the steepest position: about a lens's own blur."""
SEARCH_PX, NEEDED_PX = 6.0, 4.0
"""Search range for the steepest position about a point, and what must lie in the image to both sides of it."""


@dataclass(frozen=True)
class Across:
    """Whole pixels across n points of a limb, from outside inwards.

    ``levels``, ``known``: shape (n, k); ``ends``: shape (n, k + 1), distances of the pixels' ends inside the cone [px];
    ``line``: shape (n, 3), the row or column and its middle pixel.
    """

    levels: FloatArray
    known: NDArray[np.bool_]
    ends: FloatArray
    line: FloatArray

    @staticmethod
    def read(
        level: PyramidLevel,
        camera: CameraModel,
        uv: FloatArray,
        inwards: FloatArray,
        axis_cam: FloatArray,
        rho_rad: float | FloatArray,
        px_rad: float | FloatArray,
        offsets: FloatArray,
    ) -> Across:
        """Read a level at offsets (k,) along rows and columns from places ``uv`` (n, 2) [px of the picture]."""
        middle = np.rint(uv / level.scale)
        along = np.abs(inwards) >= np.abs(inwards[:, ::-1])
        step = np.where(along, np.sign(inwards), 0.0)
        levels, known = level.at(middle[:, None] + offsets[:, None] * step[:, None])
        ends = np.append(offsets, offsets[-1] + 1.0) - 0.5
        los = unproject(camera, level.scale * (middle[:, None] + ends[:, None] * step[:, None]))
        distance = np.reshape(rho_rad, (-1, 1)) - off_axis_angle(los, axis_cam)
        ends = distance / np.reshape(px_rad, (-1, 1))
        known &= np.isfinite(ends[:, 1:] + ends[:, :-1])
        return Across(levels, known, ends, np.column_stack([along[:, 0], middle]))


def points_of(
    level: PyramidLevel,
    camera: CameraModel,
    axis_cam: FloatArray,
    rho_rad: float,
    width_px: float,
    bright_inside: bool,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return limb positions [px of the picture], shape (n, 2), by azimuth, with steps there and deep inside.

    ``camera``: of the picture; ``rho_rad``: half-angle, right to a pixel; ``width_px``: of the edge.
    """
    trace = trace_limb(camera, axis_cam, rho_rad, level.scale)
    if not len(trace.azimuth):
        return np.empty((0, 2)), np.empty(0), np.empty(0)
    offsets = np.arange(-REACH_PX, inner_reach(trace, rho_rad, level.scale) + 1.0)
    px_rad = level.scale * trace.px_rad
    across = Across.read(level, camera, trace.uv, trace.inwards, axis_cam, rho_rad, px_rad, offsets)
    enough = enough_known(across.known, offsets) & np.isfinite(across.ends).all(axis=1)
    trace, profiles = trace.take(enough), across.levels[enough]
    # Blur by a pixel's extent along the limb: standard deviation of a uniform distribution.
    beside = np.abs(trace.inwards).min(axis=1) / np.sqrt(12.0)
    shift, step, space, good = _fitted(profiles, across.ends[enough], beside, width_px)
    good &= (np.abs(shift) <= SHIFTS_PX[-1]) & ((step > 0.0) == bright_inside)
    order = np.flatnonzero(good)
    order = order[np.argsort(trace.azimuth[order], kind="stable")]
    uv = trace.uv[order] + level.scale * shift[order, None] * trace.inwards[order]
    return uv, step[order], profiles[order, -INNERMOST:].mean(axis=1) - space[order]


def _fitted(
    profiles: FloatArray, ends: FloatArray, beside: FloatArray, width_px: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return shift, step and space of profiles (n, k), shape (n,) each, and which of them have an edge.

    ``ends``: shape (n, k + 1); ``beside``: shape (n,), blur by the pixels' extent along the limb; ``width_px``: first
    width.
    """
    n = len(profiles)
    shift, step, space, shading = np.zeros((4, n))
    good = np.ones(n, dtype=bool)
    design = np.ones((n, 4, profiles.shape[1]))
    across = np.diff(ends, axis=1)
    width = width_px
    for _ in range(STEPS):
        x = ends - shift[:, None]
        blur = np.hypot(width, beside)[:, None]
        z = x / blur
        below, density = ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        edge = np.diff(x * below + blur * density, axis=1) / across
        slope, widened = np.diff(below, axis=1) / across, np.diff(density, axis=1) / across * (width / blur)
        x = 0.5 * (x[:, 1:] + x[:, :-1])
        # The derivative by the shift, with the levels of the step before.
        ratio = np.clip(shading / np.where(step != 0.0, step, np.inf), -1.0, 1.0)[:, None]
        design[:, 1], design[:, 3] = edge, edge * x / REACH_PX
        design[:, 2] = slope + ratio * (edge + x * slope) / REACH_PX
        gram = design @ design.transpose(0, 2, 1) + TINY * np.eye(4)
        both = np.linalg.solve(gram, design @ np.stack([profiles, widened], axis=2))
        levels = both[:, :, 0]
        space, step, shading = np.asarray(levels[:, [0, 1, 3]].T)
        good &= step != 0.0
        move = np.clip(-levels[:, 2] / np.where(good, step, np.inf), -1.0, 1.0)
        shift = np.clip(shift + move, -REACH_PX, REACH_PX)
        # The width by what neither levels nor shifts explain, at most twice or half of it at a time.
        near = good & (np.abs(shift) <= SHIFTS_PX[-1])
        left = profiles - np.einsum("ijk,ij->ik", design, levels)
        free = (near * step)[:, None] * (widened - np.einsum("ijk,ij->ik", design, both[:, :, 1]))
        wider = width + float((free * left).sum() / max((free * free).sum(), TINY))
        width = min(max(wider, SHARPEST_PX, 0.5 * width), WIDTHS_PX[-1], 2.0 * width)
    return shift, step, space, good & (np.abs(move) < SETTLED_PX)


def to_steepest(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, bright_inside: bool
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Move lines of sight across the limb to the steepest position; return (m, 3), and their input rows (m,).

    ``los_cam``: shape (n, 3), right to a few pixels; ``axis_cam``: shape (3,), of their cone; ``bright_inside``: grey
    level rises towards the axis. Points leave whose profile is not in the image or steepest outside the search.
    """
    across = _read_at(image, camera, los_cam, axis_cam)
    sign = 1.0 if bright_inside else -1.0
    middle = 0.5 * (across.ends[:, 1:] + across.ends[:, :-1])
    slope = sign * gaussian_filter1d(across.levels, SIGMA_PX, axis=1, order=1)
    slope[(np.abs(middle) > SEARCH_PX) | ~across.known] = -np.inf
    shift = middle[np.arange(len(slope)), np.argmax(slope, axis=1)]
    for _ in range(STEPS):
        f, change, _ = _about(across, shift)
        shift = shift + np.clip(-f / np.where(change != 0.0, change, np.inf), -SETTLED_PX, SETTLED_PX)
    _, change, _ = _about(across, shift)
    near = np.abs(middle - shift[:, None]) <= NEEDED_PX
    good = (near <= across.known).all(axis=1) & (np.abs(shift) <= SEARCH_PX)
    # Rounding leaves a slope on a level image, which is none.
    good &= sign * change < -TINY * float(max(image.max(), -image.min()))
    kept = np.flatnonzero(good)
    angle = shift[kept, None] / max(camera.fx, camera.fy)
    return np.cos(angle) * los_cam[kept] + np.sin(angle) * inwards_of(los_cam[kept], axis_cam), kept


def _read_at(image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray) -> Across:
    """Return the pixels of an image across lines of sight (n, 3), at distances from them [px of the optical axis]."""
    px_rad = 1.0 / max(camera.fx, camera.fy)
    uv, inner = project(camera, np.array([los_cam, los_cam + px_rad * inwards_of(los_cam, axis_cam)]))[0]
    # A row at 45 deg to the limb takes more of its pixels.
    reach = np.ceil(np.sqrt(2.0) * (SEARCH_PX + NEEDED_PX))
    level = PyramidLevel(np.asarray(image, dtype=np.float32), None, 1.0, 0.0)
    rho = off_axis_angle(los_cam, axis_cam)
    return Across.read(level, camera, uv, inner - uv, axis_cam, rho, px_rad, np.arange(-reach, reach + 1.0))


def _about(across: Across, shift: FloatArray | float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``f`` at shifts (n,) or one, its derivative, shape (n,) each, and that by the differences, (n, k - 1)."""
    x = (across.ends[:, 1:-1] - np.reshape(shift, (-1, 1))) / SIGMA_PX
    smooth = np.exp(-0.5 * x * x)
    step, moment = np.diff(across.levels, axis=1), x * smooth
    return (step * moment).sum(axis=1), (step * smooth * (x * x - 1.0)).sum(axis=1) / SIGMA_PX, moment


def noise_covariance(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, noise: PixelNoise
) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of (axis along basis 1, basis 2, half-angle).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. ``los_cam``: shape (n, 3), n >= 3,
    steepest positions. Raises ``LinAlgError``: no cone is determined.
    """
    across = _read_at(image, camera, los_cam, axis_cam)
    _, change, by_step = _about(across, 0.0)
    by_level = np.diff(by_step, axis=1, prepend=0.0, append=0.0)
    variance = (by_level**2 * noise.variance(across.levels)).sum(axis=1) / np.where(change != 0.0, change, np.inf) ** 2
    _, line, points = np.unique(across.line, axis=0, return_inverse=True, return_counts=True)
    # A point that the image moves inwards is seen at a smaller angle from the axis.
    gain = cone_gain(los_cam, axis_cam) / max(camera.fx, camera.fy)
    return np.asarray((gain * (variance * points[line.ravel()])) @ gain.T)


FEWEST_PIXELS = 50
"""Smallest number of pixels of either side: their variance is then known to a fifth."""
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
    """Return the noise of an image (H, W) from pixels next to a cone's limb, none of them of its own profile.

    Pixels near ``full_scale`` are saturated and show no noise.
    """
    # 512 points along the limb give a variance to two percent.
    trace = trace_limb(camera, axis_cam, rho_rad, 1.0, 512)
    distance = np.append(np.arange(-29.0, -4.0, 2.0), np.arange(5.0, 30.0, 2.0))
    places = np.rint(trace.uv + distance[:, None, None] * trace.inwards).astype(np.intp)
    usable = ((places > 0) & (places < (camera.width - 1, camera.height - 1))).all(axis=-1)
    u, v = places[usable].T
    inside = np.broadcast_to(distance[:, None] > 0.0, usable.shape)[usable]
    level = cv2.blur(image, (3, 3))[v, u]
    if full_scale is not None:
        unsaturated = level < SATURATED_SHARE * full_scale
        u, v, level, inside = u[unsaturated], v[unsaturated], level[unsaturated], inside[unsaturated]
    if min(np.count_nonzero(inside), np.count_nonzero(~inside)) < FEWEST_PIXELS:
        return PixelNoise(noise_sigma(image) ** 2)
    square = (cv2.filter2D(image, cv2.CV_64F, IMMERKAER)[v, u] * MEDIAN_TO_SIGMA) ** 2 / (IMMERKAER**2).sum()
    of_ground, beyond = median(square[inside]), image[v, u][~inside]
    if float(np.mean(beyond == beyond.min())) > CLIPPED_SHARE:
        return PixelNoise(of_ground)
    dark, floor = median(level[~inside]), median(square[~inside])
    step = median(level[inside]) - dark
    return PixelNoise(floor, (of_ground - floor) / step if step else 0.0, dark, min(floor, of_ground))
