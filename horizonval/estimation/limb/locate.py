"""The limb's position below the pixel, profile by profile: where the fitted edge has half of its step.

For every profile across the limb Gauss-Newton finds the least squares of ::

    I = b + a E(x - d) + c S(x - d),     E(x) = Phi(x / s)

with the width ``s`` common to all profiles (:mod:`.evidence`) and separate levels. The edge is odd about its middle, so
that an error of the width does not move it; asymmetry by the air moves all of a limb equally, which is a change of
height.

**Shading.** Where air softens the limb, ``S = E x``. On bare ground the radiance an angle ``x`` inside the limb goes as
``L + c sqrt(x)``, because the arc from the tangent point does; a straight line in its place is off by some hundredths
of a pixel. On an edge as sharp as the lens, ``S`` is therefore that root, blurred. Its ``c`` would raise the noise of a
single profile several times. On a Lambert sphere it is linear in the limb's direction about the nadir, and three
numbers suffice for all profiles.

**Edges sharper than the lens.** Between pixels that an edge cuts hard, interpolation errs by up to a tenth of a pixel,
with the same sign along a stretch of limb parallel to the rows. The position is then measured by the area under a row
or column of whole pixels (:mod:`horizonval.estimation.limb.edges`), with levels and shading of samples away from the
edge.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.edges import half_window
from horizonval.estimation.limb.evidence import (
    INNERMOST,
    REACH_PX,
    SHIFTS_PX,
    WIDTHS_PX,
    enough_known,
    inner_reach,
    read_profiles,
)
from horizonval.estimation.limb.picture import MEDIAN_TO_SIGMA, TRIM_SIGMAS, median
from horizonval.estimation.limb.proposals import FEWEST_POINTS
from horizonval.estimation.limb.pyramid import PyramidLevel, Trace, trace_limb
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.horizon import fit_cone
from horizonval.geometry.rotation import off_axis_angle

STEPS = 4
"""Gauss-Newton steps from a pixel away; the next would change less than a hundredth of a pixel."""
SETTLED_PX = 0.5
"""A last step as long as that leads nowhere."""
FAINTEST = 3.0
"""Standard deviations of a profile's noise by which its step must stand out."""
BARE_WIDTH_PX = 0.8
"""A lens of 0.7 px and the pixel's own width."""
EDGE_PX = 2.0
"""Half-width of a hard edge: a pixel's diagonal and interpolation spread it over 1.7 px to either side."""
ROOT_STEP_PX = 0.02
"""Step of the table of the blurred root: a hundredth of its narrowest blur's variance."""
SMALLEST_SPREAD = 0.1
"""Smallest rms spread of the limb's direction; arcs below some 100 deg show no bending shading."""
TINY = 1e-9
"""Regularisation of a flat profile's equations, for levels of unit size."""


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
    profiles, known = read_profiles(level, trace, offsets)
    enough = enough_known(known, offsets)
    trace, profiles = trace.take(enough), profiles[enough]
    shape = _Shape(width_px, level.scale == 1.0 and width_px <= BARE_WIDTH_PX)
    fit = _fitted(profiles, offsets, shape)
    noise = level.noise / np.sqrt(min(REACH_PX, len(offsets) - REACH_PX))
    good = fit.stands_out(bright_inside, noise)
    if shape.bare and np.count_nonzero(good) >= FEWEST_POINTS:
        fit = _fitted(profiles, offsets, shape, _pooled(trace.azimuth, fit.shading, good), fit.shift)
        # Where it is night, the shading of the day makes a step of nothing: what had none by itself has none.
        good &= fit.stands_out(bright_inside, noise)
    shift, step = fit.shift, fit.step
    uv = trace.uv + level.scale * shift[:, None] * trace.inwards
    if shape.bare and width_px == WIDTHS_PX[0] and np.count_nonzero(good) >= FEWEST_POINTS:
        read, whole_pixels = _by_area(level, uv, trace, profiles, offsets, fit, good)
        whole_pixels &= good
        # Textured ground is uneven over the pixels that an area takes: the places that lie better on a cone are taken.
        if _scatter(read[whole_pixels], camera) < _scatter(uv[good], camera):
            uv, good = read, whole_pixels
    order = np.flatnonzero(good)
    order = order[np.argsort(trace.azimuth[order], kind="stable")]
    return uv[order], step[order], fit.deep[order]


def _scatter(uv: FloatArray, camera: CameraModel) -> float:
    """Return the median distance [rad] of places from the cone through them; infinite for too few."""
    los = unproject(camera, uv)
    los = los[np.isfinite(los).all(axis=1)]
    if len(los) < FEWEST_POINTS:
        return float("inf")
    off = off_axis_angle(los, fit_cone(los).axis_cam)
    return median(np.abs(off - median(off)))


def _by_area(
    level: PyramidLevel,
    uv: FloatArray,
    trace: Trace,
    profiles: FloatArray,
    offsets: FloatArray,
    fit: _Fitted,
    used: NDArray[np.bool_],
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return places (n, 2) read off whole pixels, and which of the given ones have some that no other shares."""
    space, step, shading = _levels_beside(profiles, offsets[None, :] - fit.shift[:, None], trace.azimuth, used)
    half = half_window(level.grey.shape)
    rows = np.arange(len(uv))
    axis = np.argmax(np.abs(trace.inwards), axis=1)
    along, across = trace.inwards[rows, axis], trace.inwards[rows, 1 - axis]
    fixed = np.rint(uv[rows, 1 - axis])
    # Where the limb crosses the row or column of whole pixels, by its own slope.
    crossing = uv[rows, axis] + (uv[rows, 1 - axis] - fixed) * across / along
    centre = np.rint(crossing)
    pixel = centre[:, None] + np.arange(-half, half + 1)
    values, known = level.at(np.where(np.arange(2) == axis[:, None, None], pixel[..., None], fixed[:, None, None]))
    at, root, _ = _blurred_root(WIDTHS_PX[0])
    shade = np.interp((pixel - crossing[:, None]) * along[:, None], at, root)
    lit = (values - space[:, None] - shading[:, None] * shade).sum(axis=1)
    area = lit / np.where(step != 0.0, step, np.inf)
    crossing = centre + np.sign(along) * (half + 0.5 - area)
    good = known.all(axis=1) & (np.abs(crossing - centre) <= 1.0)
    _, first = np.unique(np.column_stack([axis, fixed, centre]), axis=0, return_index=True)
    good &= np.isin(rows, first)
    return np.where(np.arange(2) == axis[:, None], crossing[:, None], fixed[:, None]), good


def _levels_beside(
    profiles: FloatArray, x: FloatArray, azimuth: FloatArray, good: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return space, step and shading of profiles (n, k) by their samples away from the edge, x [px] inside of it."""
    outside, inside = x < -EDGE_PX, x > EDGE_PX
    space = np.where(outside, profiles, 0.0).sum(axis=1) / np.maximum(outside.sum(axis=1), 1)
    root, above = np.sqrt(np.maximum(x, 0.0)), profiles - space[:, None]
    count = np.maximum(inside.sum(axis=1), 1)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.where(inside, values, 0.0).sum(axis=1) / count)

    middle = mean(root)
    spread = mean(root**2) - middle**2
    shading = _pooled(azimuth, (mean(root * above) - middle * mean(above)) / np.maximum(spread, TINY), good)
    return space, mean(above) - shading * middle, shading


@dataclass(frozen=True)
class _Fitted:
    """Of n profiles: shift, step, step deep inside, shading, and whether there is an edge at all."""

    shift: FloatArray
    step: FloatArray
    deep: FloatArray
    shading: FloatArray
    good: NDArray[np.bool_]

    def stands_out(self, bright_inside: bool, noise: float) -> NDArray[np.bool_]:
        """Return which profiles show an edge of the limb's sign near the cone, beyond their noise."""
        near = self.good & (np.abs(self.shift) <= SHIFTS_PX[-1])
        return np.asarray(near & ((self.step > 0.0) == bright_inside) & (np.abs(self.step) > FAINTEST * noise))


@dataclass(frozen=True)
class _Shape:
    """Terms of a profile at places x [px] besides its level: the edge, its shading, and their slopes."""

    width: float
    bare: bool

    def edge(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        z = x / self.width
        return ndtr(z), np.exp(-0.5 * z * z) / (np.sqrt(2.0 * np.pi) * self.width)

    def shading(self, x: FloatArray, edge: FloatArray, slope: FloatArray) -> tuple[FloatArray, FloatArray]:
        if not self.bare:
            return edge * x / REACH_PX, (edge + x * slope) / REACH_PX
        at, root, change = _blurred_root(self.width)
        # The table is even: no search for the place in it is needed.
        place = np.clip((x - at[0]) / ROOT_STEP_PX, 0.0, len(at) - 1.000001)
        before = place.astype(np.intp)
        share = place - before
        return tuple(one[before] + share * (one[before + 1] - one[before]) for one in (root, change))


@cache
def _blurred_root(width: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return places, the root of the distance inside the limb blurred by a Gaussian, and its slope."""
    at = np.arange(-2.0 * REACH_PX, 2.0 * REACH_PX, ROOT_STEP_PX)
    sharp = 2.0 / 3.0 * np.maximum(at, 0.0) ** 1.5
    # Of the root's integral, whose derivative is even where the root's own is not finite.
    slope = gaussian_filter1d(sharp, width / ROOT_STEP_PX, order=1, mode="nearest") / ROOT_STEP_PX
    return at, slope, np.gradient(slope, ROOT_STEP_PX)


def _fitted(
    profiles: FloatArray,
    offsets: FloatArray,
    shape: _Shape,
    shading: FloatArray | None = None,
    shift: FloatArray | None = None,
) -> _Fitted:
    """Return what profiles (n, k) show, each with its own shading or the given one (n,), from a first shift (n,)."""
    n = len(profiles)
    steps = STEPS if shift is None else STEPS // 2
    shift, step, space = np.zeros(n) if shift is None else shift, np.zeros(n), np.zeros(n)
    own = np.zeros(n) if shading is None else shading
    good = np.ones(n, dtype=bool)
    for _ in range(steps):
        x = offsets[None, :] - shift[:, None]
        edge, slope = shape.edge(x)
        shade, change = shape.shading(x, edge, slope)
        # The derivative by the shift, with the levels of the step before.
        ratio = own / np.where(step != 0.0, step, np.inf)
        moved = slope + np.clip(ratio, -1.0, 1.0)[:, None] * change
        if shading is None:
            design, values = np.stack([np.ones_like(x), edge, moved, shade], axis=1), profiles
        else:
            design, values = np.stack([np.ones_like(x), edge, moved], axis=1), profiles - shading[:, None] * shade
        gram = design @ design.transpose(0, 2, 1) + TINY * np.eye(design.shape[1])
        right = np.einsum("ijk,ik->ij", design, values)
        levels = np.linalg.solve(gram, right[:, :, None])[:, :, 0]
        space, step = levels[:, 0], levels[:, 1]
        if shading is None:
            own = levels[:, 3]
        good &= step != 0.0
        move = -levels[:, 2] / np.where(good, step, np.inf)
        shift = np.clip(shift + np.clip(move, -1.0, 1.0), -REACH_PX, REACH_PX)
    deep = profiles[:, -INNERMOST:].mean(axis=1) - space
    return _Fitted(shift, step, deep, own, good & (np.abs(move) < SETTLED_PX))


def _pooled(azimuth: FloatArray, shading: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
    """Return the shading of all profiles as a linear function of the limb's direction, shape (n,)."""
    t = np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    middle = t[good].mean(axis=0)
    _, size, directions = np.linalg.svd(t[good] - middle, full_matrices=False)
    # Along a short arc a shading that may bend with it would take the limb's own curvature for its own.
    spread = directions[size >= SMALLEST_SPREAD * np.sqrt(np.count_nonzero(good))]
    design = np.column_stack([np.ones(len(t)), (t - middle) @ spread.T])
    used = good.copy()
    coefficients = np.zeros(design.shape[1])
    for _ in range(3):
        coefficients = np.linalg.lstsq(design[used], shading[used], rcond=1e-9)[0]
        off = np.abs(shading - design @ coefficients)
        used = good & (off <= TRIM_SIGMAS * MEDIAN_TO_SIGMA * median(off[good]) + TINY)
    return np.asarray(design @ coefficients)
