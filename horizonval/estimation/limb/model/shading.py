"""Sub-pixel position of a hard limb whose ground is shaded: what foreshortening does to the area under the profile.

At the limb the line of sight grazes the ground. An angle ``d`` inside the limb it meets the ground at an arc ``s`` from
the tangent point with ``d ~ s^2``: ground that changes smoothly, ``L0 + L1 s``, is seen as ::

    I(d) = L0 + k sqrt(d)

which rises infinitely steeply at the limb, in every image of every smooth body, whatever its size in pixels. The level
taken a few pixels inside (:mod:`horizonval.estimation.limb.subpixel`) is then not the level at the edge, and the
position from the area is off by ``k / L0`` times a few square roots of pixels: 0.1 px at 6000 km under an overhead Sun
and 1024 px over 60 deg, always to the same side.

Here the area under the profile is that of the square root. ``k`` comes from the inner pixels of all columns together:
on a Lambert sphere ``L1`` is linear in the limb's direction ``t`` about the nadir, hence ``k = a + b . t``, three
numbers for the whole limb. A column by itself would pay for its own ``k`` with several times the noise. What is left
to a column is its own level ``L0`` and the position ``D`` (distances in angle about the nadir, so that slant and
projection are in them)::

    sum_k (I_k - dark) = L0 D + 2/3 k D^(3/2)

It holds where the limb is an edge; through air that shows as a ramp there is no square root, and no such step.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.directions import off_axis_angle, tangent_basis

HALF_PX = 7
"""Half length of the window, an eighth of a tiny image's side at most. The inner pixels used end 2.5 px from the edge,
clear of the core of a lens that leaves the limb an edge."""
SMALLEST_HALF_PX = 5
ROUNDS = 4
CLIP_SIGMAS = 3.5
SHARP = 0.7
"""Sharpness (see :func:`horizonval.estimation.limb.subpixel.refine`) of a limb that is an edge.

A Gaussian lens of 0.9 px leaves that much."""
FEWEST_POINTS = 12
SMALLEST_SHARE = 0.8
SMALLEST_SPREAD = 0.1
"""On a short arc ``t`` hardly turns, and a ``k`` that may bend with it would take the limb's own curvature for shading.
Directions in which ``t`` spreads less (rms) are left out: along arcs below some 100 deg ``k`` has no curvature."""


def unshade(
    image: FloatArray, camera: CameraModel, axis_cam: FloatArray, uv: FloatArray, gradient: FloatArray
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return refined points of a hard limb with the shading of its inner side taken into account.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : CameraModel
    axis_cam : ndarray, shape (3,)
        Of the cone fitted so far.
    uv : ndarray, shape (n, 2)
        Refined points; one coordinate of each is whole (the column or row that it was refined along).
    gradient : ndarray, shape (n, 2)
        Unit gradient of the grey level: says which coordinate was refined. Its sense does not matter; the ground may be
        darker than space.

    Returns
    -------
    uv : ndarray, shape (m, 2)
        Without the points whose window reaches over the rim: left as they were they would lie off the others' curve.
        The points given where the image, or what would be left, is too small.
    kept : ndarray of int, shape (m,)
        Their rows in the input.
    """
    half = min(HALF_PX, min(image.shape) // 8)
    vertical = np.abs(gradient[:, 1]) >= np.abs(gradient[:, 0])
    step = np.where(vertical[:, None], (0.0, 1.0), (1.0, 0.0))
    inwards = np.sign(_angle_per_pixel(camera, axis_cam, uv, step))[:, None] * step
    centre = np.rint(uv)
    ends = np.stack([centre + half * inwards, centre - half * inwards])
    room = ((ends >= 0) & (ends <= (camera.width - 1, camera.height - 1))).all(axis=(0, 2))
    kept = np.flatnonzero(room)
    if half < SMALLEST_HALF_PX or len(kept) < max(FEWEST_POINTS, SMALLEST_SHARE * len(uv)):
        return uv, np.arange(len(uv))
    uv, centre, inwards = uv[kept], centre[kept], inwards[kept]
    at = (centre[:, None, :] + np.arange(half, -half - 1, -1)[None, :, None] * inwards[:, None, :]).astype(int)
    profile = image[at[:, :, 1], at[:, :, 0]]
    profile = profile - profile[:, 2 - half :].mean(axis=1)[:, None]
    rate = _angle_per_pixel(camera, axis_cam, uv, inwards) * camera.fx
    start = half + 0.5 - ((uv - centre) * inwards).sum(axis=1)
    design = _patterns(unproject(camera, uv) @ tangent_basis(axis_cam))
    inside = _ground_length(profile, start, rate, design, half - 2)
    return centre + (half + 0.5 - inside)[:, None] * inwards, kept


def _ground_length(
    profile: FloatArray, start: FloatArray, rate: FloatArray, design: FloatArray, used: int
) -> FloatArray:
    """Return the lengths [px] of the ground's parts of profiles (n, k), ground first, level of space 0."""
    total = profile.sum(axis=1)
    inner = profile[:, :used]
    level = inner.mean(axis=1)
    length: FloatArray = start.copy()
    root = np.sqrt(rate)
    for _ in range(ROUNDS):
        distance = length[:, None] - (np.arange(used) + 0.5)
        # mean of the square root over a pixel
        basis = root[:, None] * 2.0 / 3.0 * ((distance + 0.5) ** 1.5 - (distance - 0.5) ** 1.5)
        mean = basis.mean(axis=1)
        centred = basis - mean[:, None]
        power = (centred**2).sum(axis=1)
        k = design @ _robust_fit(design, (centred * inner).sum(axis=1) / power, power)
        edge = level - k * mean
        area = edge * length + k * root * 2.0 / 3.0 * length**1.5
        slope = edge + k * root * np.sqrt(length)
        change = (total - area) / np.where(slope != 0.0, slope, np.inf)
        length = np.asarray(np.clip(length + change, start - 1.0, start + 1.0))
    return length


def _patterns(across: FloatArray) -> FloatArray:
    """Return what ``k`` is made of: 1, and the components of ``t`` (``across``, to be scaled) that spread enough."""
    t = across / np.linalg.norm(across, axis=1)[:, None]
    t = t - t.mean(axis=0)
    _, size, directions = np.linalg.svd(t, full_matrices=False)
    spread = directions[size >= SMALLEST_SPREAD * np.sqrt(len(t))]
    return np.column_stack([np.ones(len(t)), t @ spread.T])


def _robust_fit(design: FloatArray, values: FloatArray, weight: FloatArray) -> FloatArray:
    """Return weighted least-squares coefficients, outliers (clouds, coasts) clipped."""
    used = np.ones(len(values), dtype=bool)
    coefficients: FloatArray = np.zeros(design.shape[1])
    for _ in range(3):
        w = np.sqrt(weight[used])
        coefficients = np.asarray(np.linalg.lstsq(design[used] * w[:, None], values[used] * w, rcond=1e-9)[0])
        off = np.abs(values - design @ coefficients)
        used = off <= CLIP_SIGMAS * 1.4826 * float(np.median(off)) + 1e-12
    return np.asarray(coefficients)


def _angle_per_pixel(camera: CameraModel, axis_cam: FloatArray, uv: FloatArray, step: FloatArray) -> FloatArray:
    """Return how fast the angle to the axis falls along steps of one pixel [rad/px]."""
    before, behind = (off_axis_angle(unproject(camera, uv + sign * step), axis_cam) for sign in (-1.0, 1.0))
    return (before - behind) / 2.0
