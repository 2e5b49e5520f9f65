"""The limb's position below the pixel: an edge fitted to whole pixels across it.

The row or column of pixels through a point of the limb crosses it at 45 deg or more. With ``x`` the distance [px]
inside the cone, Gauss-Newton finds the least squares of ::

    I = b + a E(x - d) + c x E(x - d),     E: mean over the pixel of Phi(x / s)

Space ``b``, step ``a``, shading ``c`` and shift ``d`` are separate. The width ``s`` is common to all, in pixels if the
lens makes it, in angle if the air does; the one with the smaller residuals is taken. No level is interpolated and the
pixel's extent is part of the model, so that a hard edge is located as well as a soft one. The edge is odd about its
middle: asymmetry by the air moves all of a limb equally, which is a change of height. Neglected: on bare ground,
without air, the radiance an angle ``x`` inside the limb goes as ``sqrt(x)``; a straight line in its place moves the
limb by 0.04 px, all of it equally.

**Covariance** of a cone through such points. Their residuals hold patterns that another exposure repeats (phase of the
pixels, clouds, shape of the Earth). The noise of the pixels is therefore propagated through the fit, which is linear
in them. Points of one row or column share their pixels and count as one.

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
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.cone import cone_gain, inwards_of
from horizonval.estimation.limb.evidence import INNERMOST, REACH_PX, SHIFTS_PX, WIDTHS_PX, enough_known, inner_reach
from horizonval.estimation.limb.picture import IMMERKAER, MEDIAN_TO_SIGMA, median, noise_sigma
from horizonval.estimation.limb.pyramid import PyramidLevel, trace_limb
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.rotation import off_axis_angle

STEPS = 6
"""Gauss-Newton steps from a pixel away; the next would change less than a hundredth of a pixel."""
SHARPEST_PX = 0.02
"""Smallest width: such an edge is hard to a hundredth of a pixel."""
TINY = 1e-9
"""Regularisation of a flat profile's equations, for levels of unit size."""


@dataclass(frozen=True)
class FittedEdges:
    """Edges of n rows or columns across a limb.

    ``shift``: shape (n,), inwards [px]; ``step``, ``deep``: shape (n,), brightness at the edge and of the innermost
    pixels over space; ``good``: which are edges near the cone; ``levels``, ``by_level``: shape (n, k), the pixels, and
    the derivative of the shift by them; ``line``: shape (n, 3), the row or column.
    """

    shift: FloatArray
    step: FloatArray
    deep: FloatArray
    good: NDArray[np.bool_]
    levels: FloatArray
    by_level: FloatArray
    line: FloatArray


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
    reach = inner_reach(trace, rho_rad, level.scale)
    # A soft limb is as wide in angle all along, not in pixels.
    px_rad = level.scale * trace.middle_px_rad
    edges = _edges(level, camera, trace.uv, trace.inwards, axis_cam, rho_rad, px_rad, reach, width_px)
    order = np.flatnonzero(edges.good & ((edges.step > 0.0) == bright_inside))
    order = order[np.argsort(trace.azimuth[order], kind="stable")]
    shift = edges.shift[order] * px_rad / trace.px_rad[order]
    uv = trace.uv[order] + shift[:, None] * trace.inwards[order]
    return uv, edges.step[order], edges.deep[order]


def noise_covariance(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, noise: PixelNoise
) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of (axis along basis 1, basis 2, half-angle).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. ``los_cam``: shape (n, 3), n >= 3,
    points of the limb. Raises ``LinAlgError``: no cone is determined.
    """
    edges = _edges_at(image, camera, los_cam, axis_cam, 2)
    variance = (edges.by_level**2 * noise.variance(edges.levels)).sum(axis=1)
    _, line, points = np.unique(edges.line, axis=0, return_inverse=True, return_counts=True)
    # A point that the image moves inwards is seen at a smaller angle from the axis.
    gain = cone_gain(los_cam, axis_cam) / max(camera.fx, camera.fy)
    return np.asarray((gain * np.where(edges.good, variance * points[line.ravel()], 0.0)) @ gain.T)


def _edges_at(
    image: FloatArray, camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, steps: int = STEPS
) -> FittedEdges:
    """Return the edges at lines of sight (n, 3) in an image, in pixels of the optical axis."""
    px_rad = 1.0 / max(camera.fx, camera.fy)
    uv, inner = project(camera, np.array([los_cam, los_cam + px_rad * inwards_of(los_cam, axis_cam)]))[0]
    level = PyramidLevel(np.asarray(image, dtype=np.float32), None, 1.0, 0.0)
    rho = off_axis_angle(los_cam, axis_cam)[:, None]
    return _edges(level, camera, uv, inner - uv, axis_cam, rho, px_rad, REACH_PX, WIDTHS_PX[2], steps)


def _edges(
    level: PyramidLevel,
    camera: CameraModel,
    uv: FloatArray,
    inwards: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float | FloatArray,
    px_rad: float,
    reach_px: int,
    width_px: float,
    steps: int = STEPS,
) -> FittedEdges:
    """Return the edges of the rows or columns through places (n, 2) [px of the picture] of a level."""
    # A row at 45 deg to the limb takes more pixels to the same reach.
    offsets = np.arange(-np.ceil(np.sqrt(2.0) * REACH_PX), np.ceil(np.sqrt(2.0) * reach_px) + 1.0)
    middle = np.rint(uv / level.scale)
    along = np.abs(inwards) >= np.abs(inwards[:, ::-1])
    step = np.where(along, np.sign(inwards), 0.0)
    levels, known = level.at(middle[:, None] + offsets[:, None] * step[:, None])
    # Distance inside the cone of the ends of every pixel along its row or column.
    ends = np.append(offsets, offsets[-1] + 1.0) - 0.5
    los = unproject(camera, level.scale * (middle[:, None] + ends[:, None] * step[:, None]))
    x = (rho_rad - off_axis_angle(los, axis_cam)) / px_rad
    x = np.where(np.isfinite(x).all(axis=1, keepdims=True), x, np.inf)
    # The same window at every slant: an asymmetric edge is then at the same height all along.
    depth = 0.5 * (x[:, 1:] + x[:, :-1])
    within = (depth > -REACH_PX - 0.5) & (depth < reach_px + 0.5)
    columns = within.any(axis=0)
    levels, known, within, offsets = levels[:, columns], known[:, columns], within[:, columns], offsets[columns]
    x, ends = (one[..., np.append(columns, False) | np.insert(columns, 0, False)] for one in (x, ends))
    good = enough_known(known | ~within, offsets) & np.isfinite(x).all(axis=1)
    x = np.where(good[:, None], x, ends)
    # Of a pixel its size, and the standard deviation of its extent along the limb.
    direction = np.abs(inwards) / np.linalg.norm(inwards, axis=1)[:, None]
    pixel = np.diff(x, axis=1).mean(axis=1) / direction.max(axis=1)
    beside = pixel * direction.min(axis=1) / np.sqrt(12.0)
    weight = (known & within).astype(np.float64)
    # A lens's width is the same in pixels, the air's in angle: the one that some 256 profiles confirm.
    some = slice(None, None, max(len(uv) // 256, 1))

    def fitted(rows: slice, size: FloatArray, width: float, shift: FloatArray, steps: int) -> _Fit:
        return _fitted(levels[rows], weight[rows], x[rows], size[rows], beside[rows], good[rows], width, shift, steps)

    size, zero = pixel, np.zeros(len(uv))
    fit = fitted(some, pixel, width_px, zero[some], steps)
    if good.any() and np.ptp(pixel[good]) > 0.1:
        even = fitted(some, np.ones_like(pixel), fit.width, fit.shift, steps // 2)
        fit, size = (even, np.ones_like(pixel)) if even.misfit < fit.misfit else (fit, size)
    if some.step > 1:
        fit = fitted(slice(None), size, fit.width, zero, max(steps - 2, 2))
    good &= fit.settled & (np.abs(fit.shift) <= SHIFTS_PX[-1] * pixel)
    deep = levels[:, -INNERMOST:].mean(axis=1) - fit.space
    return FittedEdges(fit.shift, fit.step, deep, good, levels, fit.by_level, np.column_stack([along[:, 0], middle]))


@dataclass(frozen=True)
class _Fit:
    """Shift, step, space (n,) of profiles, which have an edge, derivatives of the shift by levels; width and misfit."""

    shift: FloatArray
    step: FloatArray
    space: FloatArray
    settled: NDArray[np.bool_]
    by_level: FloatArray
    width: float
    misfit: float


def _fitted(
    levels: FloatArray,
    weight: FloatArray,
    ends: FloatArray,
    size: FloatArray,
    beside: FloatArray,
    used: NDArray[np.bool_],
    width: float,
    shift: FloatArray,
    steps: int,
) -> _Fit:
    """Return the edges of profiles (n, k), from a first width and first shifts (n,).

    ``weight``: shape (n, k), 1 where a pixel counts, else 0; ``ends``: shape (n, k + 1), distances inside the cone;
    ``size``, ``beside``: shape (n,), unit of the width, and blur by a pixel's extent along the limb; ``used``: profiles
    that determine the width.
    """
    step, space, shading = np.zeros((3, len(levels)))
    profiles = weight * levels
    design = np.repeat(weight[:, None], 4, axis=1)
    across = np.diff(ends, axis=1)
    for _ in range(steps):
        x = ends - shift[:, None]
        blur = np.hypot(width * size, beside)[:, None]
        z = x / blur
        below, density = ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)
        edge = np.diff(x * below + blur * density, axis=1) / across
        slope, widened = (
            np.diff(below, axis=1) / across,
            np.diff(density, axis=1) / across * (width * size[:, None] ** 2 / blur),
        )
        x = 0.5 * (x[:, 1:] + x[:, :-1])
        # The derivative by the shift, with the levels of the step before.
        ratio = np.clip(shading / np.where(step != 0.0, step, np.inf), -1.0, 1.0)[:, None]
        widened *= weight
        design[:, 1], design[:, 3] = weight * edge, weight * edge * x / REACH_PX
        design[:, 2] = weight * (slope + ratio * (edge + x * slope) / REACH_PX)
        inverse = np.linalg.inv(design @ design.transpose(0, 2, 1) + TINY * np.eye(4))
        both = inverse @ (design @ np.stack([profiles, widened], axis=2))
        space, step, moved, shading = np.asarray(both[:, :, 0].T)
        per_step = 1.0 / np.where(step != 0.0, step, np.inf)
        move = np.clip(-moved * per_step, -1.0, 1.0)
        shift = np.clip(shift + move, -REACH_PX, REACH_PX)
        # The width by what neither levels nor shifts explain, a quarter of it at least.
        left = profiles - np.einsum("ijk,ij->ik", design, both[:, :, 0])
        near = used & (np.abs(shift) <= SHIFTS_PX[-1])
        free = (near * step)[:, None] * (widened - np.einsum("ijk,ij->ik", design, both[:, :, 1]))
        wider = width + float((free * left).sum() / max((free * free).sum(), TINY))
        width = min(max(wider, 0.25 * width, SHARPEST_PX), 2.0 * width, WIDTHS_PX[-1])
    by_level = np.einsum("ij,ijk->ik", inverse[:, 2], design) * -per_step[:, None]
    # A last step of half a pixel leads nowhere.
    settled = (step != 0.0) & (np.abs(move) < 0.5)
    return _Fit(shift, step, space, settled, by_level, width, float((left[used] ** 2).sum()))


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
    # 50 pixels of either side give a variance to a fifth.
    if min(np.count_nonzero(inside), np.count_nonzero(~inside)) < 50:
        return PixelNoise(noise_sigma(image) ** 2)
    square = (cv2.filter2D(image, cv2.CV_64F, IMMERKAER)[v, u] * MEDIAN_TO_SIGMA) ** 2 / (IMMERKAER**2).sum()
    of_ground, beyond = median(square[inside]), image[v, u][~inside]
    # Space with a tenth of its pixels at one lowest level is clipped.
    if float(np.mean(beyond == beyond.min())) > 0.1:
        return PixelNoise(of_ground)
    dark, floor = median(level[~inside]), median(square[~inside])
    step = median(level[inside]) - dark
    return PixelNoise(floor, (of_ground - floor) / step if step else 0.0, dark, min(floor, of_ground))
