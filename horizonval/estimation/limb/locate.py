"""The limb's position below the pixel: an edge fitted to whole pixels across it.

The row or column of pixels through a point of the limb crosses it at 45 deg or more. For each Gauss-Newton finds the
least squares of ::

    I = b + a E(x - d) + c x E(x - d),     E: mean over the pixel of Phi(x / s)

with ``x`` the distance [px] inside the cone. Space ``b``, step ``a``, shading ``c`` and shift ``d`` are separate, the
width ``s`` is common to all. No level is interpolated and the pixel's own extent is part of the model, so that a hard
edge is located as well as a soft one. The edge is odd about its middle: asymmetry by the air moves all of a limb
equally, which is a change of height.

Neglected: on bare ground, without air, the radiance an angle ``x`` inside the limb goes as ``sqrt(x)``, and a straight
line in its place moves the limb by 0.04 px, all of it equally.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.evidence import (
    INNERMOST,
    REACH_PX,
    SHIFTS_PX,
    WIDTHS_PX,
    enough_known,
    inner_reach,
)
from horizonval.estimation.limb.pyramid import PyramidLevel, trace_limb
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.rotation import off_axis_angle

STEPS = 6
"""Gauss-Newton steps from a pixel away; the next would change less than a hundredth of a pixel."""
SETTLED_PX = 0.5
"""A last step as long as that leads nowhere."""
FAINTEST = 3.0
"""Standard deviations of a profile's noise by which its step must stand out."""
SHARPEST_PX = 0.02
"""Smallest width: such an edge is hard to a hundredth of a pixel."""
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
    steep = np.eye(2)[np.argmax(np.abs(trace.inwards), axis=1)]
    step_px = steep * np.sign(trace.inwards)
    middle = np.rint(trace.uv / level.scale)
    profiles, known = level.at(middle[:, None, :] + offsets[:, None] * step_px[:, None, :])
    # Distance inside the cone of the ends of every pixel along its row or column.
    ends = np.append(offsets, offsets[-1] + 1.0) - 0.5
    los = unproject(camera, level.scale * (middle[:, None, :] + ends[:, None] * step_px[:, None, :]))
    x = (rho_rad - off_axis_angle(los, axis_cam)) / (level.scale * trace.px_rad)[:, None]
    enough = enough_known(known, offsets) & np.isfinite(x).all(axis=1)
    trace, profiles = trace.take(enough), profiles[enough]
    # Blur by a pixel's extent along the limb: standard deviation of a uniform distribution.
    beside = np.abs(trace.inwards).min(axis=1) / np.sqrt(12.0)
    shift, step, space, good = _fitted(profiles, x[enough], beside, width_px)
    noise = level.noise / np.sqrt(min(REACH_PX, len(offsets) - REACH_PX))
    good &= (np.abs(shift) <= SHIFTS_PX[-1]) & ((step > 0.0) == bright_inside) & (np.abs(step) > FAINTEST * noise)
    order = np.flatnonzero(good)
    order = order[np.argsort(trace.azimuth[order], kind="stable")]
    uv = trace.uv[order] + level.scale * shift[order, None] * trace.inwards[order]
    return uv, step[order], profiles[order, -INNERMOST:].mean(axis=1) - space[order]


def _fitted(
    profiles: FloatArray, ends: FloatArray, beside: FloatArray, width_px: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return shift, step and space of profiles (n, k), shape (n,) each, and which of them have an edge.

    ``ends``: shape (n, k + 1), distances inside the cone of the pixels' ends; ``beside``: shape (n,), blur by their
    extent along the limb; ``width_px``: first width.
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
        # The width by what neither levels nor shifts explain.
        left = profiles - np.einsum("ijk,ij->ik", design, levels)
        free = step[:, None] * (widened - np.einsum("ijk,ij->ik", design, both[:, :, 1]))
        width += float((free * left).sum() / max((free * free).sum(), TINY))
        width = min(max(width, SHARPEST_PX), WIDTHS_PX[-1])
    return shift, step, space, good & (np.abs(move) < SETTLED_PX)
