"""The limb's position below the pixel, profile by profile: where the fitted edge has half of its step.

For every profile across the limb Gauss-Newton finds the least squares of ::

    I = b + a E(x - d) + c E(x - d) (x - d),     E(x) = Phi(x / s)

with the width ``s`` common to all profiles (:mod:`.evidence`) and separate levels. The edge is odd about its middle, so
that an error of the width does not move it; asymmetry by the air moves all of a limb equally, which is a change of
height.

Neglected: on bare ground, without air, the radiance an angle ``x`` inside the limb goes as ``sqrt(x)``, and a straight
line in its place moves the limb by 0.04 px, all of it equally.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
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
    read_profiles,
)
from horizonval.estimation.limb.pyramid import PyramidLevel, trace_limb
from horizonval.geometry.camera import CameraModel

STEPS = 4
"""Gauss-Newton steps from a pixel away; the next would change less than a hundredth of a pixel."""
SETTLED_PX = 0.5
"""A last step as long as that leads nowhere."""
FAINTEST = 3.0
"""Standard deviations of a profile's noise by which its step must stand out."""
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
    if width_px == WIDTHS_PX[0]:
        # Between pixels that an edge cuts hard, interpolation errs with the same sign along a stretch of limb.
        level = replace(level, grey=np.asarray(cv2.GaussianBlur(level.grey, (0, 0), WIDTHS_PX[1]), np.float32))
        width_px = float(np.hypot(*WIDTHS_PX[:2]))
    profiles, known = read_profiles(level, trace, offsets)
    enough = enough_known(known, offsets)
    trace, profiles = trace.take(enough), profiles[enough]
    shift, step, space, good = _fitted(profiles, offsets, width_px)
    noise = level.noise / np.sqrt(min(REACH_PX, len(offsets) - REACH_PX))
    good &= (np.abs(shift) <= SHIFTS_PX[-1]) & ((step > 0.0) == bright_inside) & (np.abs(step) > FAINTEST * noise)
    order = np.flatnonzero(good)
    order = order[np.argsort(trace.azimuth[order], kind="stable")]
    uv = trace.uv[order] + level.scale * shift[order, None] * trace.inwards[order]
    return uv, step[order], profiles[order, -INNERMOST:].mean(axis=1) - space[order]


def _fitted(
    profiles: FloatArray, offsets: FloatArray, width_px: float
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return shift, step and space of profiles (n, k), shape (n,) each, and which of them have an edge."""
    n = len(profiles)
    shift: FloatArray = np.zeros(n)
    step, space, shading = np.zeros((3, n))
    good = np.ones(n, dtype=bool)
    design = np.ones((n, 4, len(offsets)))
    for _ in range(STEPS):
        x = offsets - shift[:, None]
        z = x / width_px
        edge, slope = ndtr(z), np.exp(-0.5 * z * z) / (np.sqrt(2.0 * np.pi) * width_px)
        # The derivative by the shift, with the levels of the step before.
        ratio = np.clip(shading / np.where(step != 0.0, step, np.inf), -1.0, 1.0)[:, None]
        design[:, 1], design[:, 3] = edge, edge * x / REACH_PX
        design[:, 2] = slope + ratio * (edge + x * slope) / REACH_PX
        gram = design @ design.transpose(0, 2, 1) + TINY * np.eye(4)
        levels = np.linalg.solve(gram, design @ profiles[:, :, None])[:, :, 0]
        space, step, shading = np.asarray(levels[:, [0, 1, 3]].T)
        good &= step != 0.0
        move = np.clip(-levels[:, 2] / np.where(good, step, np.inf), -1.0, 1.0)
        shift = np.clip(shift + move, -REACH_PX, REACH_PX)
    return shift, step, space, good & (np.abs(move) < SETTLED_PX)
