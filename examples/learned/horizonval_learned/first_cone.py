"""A start without a prior: the steepest pixels of an image, and the cone of sight lines on which most of them lie.

A sphere's limb is a cone, ``u . m = 1`` with ``m = nadir / cos rho``, whatever the camera makes of it in the image.
Three pixels make a cone; of some hundred such the one counts most on which the most others lie to a pixel, brighter
inside, and it is fitted once more to those. No camera, altitude or attitude is assumed.
"""

from __future__ import annotations

import numpy as np

import horizonval as hv
from horizonval.geometry.camera import unproject

TRIALS, SEED = 400, 1
FEWEST, MOST = 12, 1500
"""Of steep pixels on the cone, and of those that are tried."""
STEEP = 0.1
"""Of the contrast of the image, in two pixels."""
RHO_RAD = np.radians([3.0, 88.0])


def first_cone(observation: hv.Observation) -> tuple[np.ndarray, float] | hv.Refusal:
    """Return nadir, shape (3,), and half-angle [rad] of the cone, or why there is none."""
    points, uphill = steep_pixels(observation.image)
    if len(points) < FEWEST:
        return hv.Refusal(hv.Outcome.NO_LIMB, f"{len(points)} steep pixels, fewer than {FEWEST}")
    camera = observation.camera
    rays = unproject(camera, points)
    towards_bright = unproject(camera, points + 0.5 * uphill) - rays
    known = np.isfinite(rays + towards_bright).all(axis=1)
    points, rays, towards_bright = points[known], rays[known], towards_bright[known]
    if len(rays) < FEWEST:
        return hv.Refusal(hv.Outcome.NO_LIMB, "the steep pixels are no directions", points)
    pixel_rad = 2.0 * np.linalg.norm(towards_bright, axis=1)
    threes = rays[np.random.default_rng(SEED).integers(len(rays), size=(TRIALS, 3))]
    axes = np.cross(threes[:, 1] - threes[:, 0], threes[:, 2] - threes[:, 0])
    axes /= np.maximum(np.linalg.norm(axes, axis=1, keepdims=True), 1e-300)
    axes *= np.where((axes * threes[:, 0]).sum(axis=1) < 0.0, -1.0, 1.0)[:, None]
    count, chosen = 0, np.zeros(len(rays), bool)
    for axis, ray in zip(axes, threes[:, 0], strict=True):
        on_it = _on(axis, float(axis @ ray), rays, towards_bright, pixel_rad)
        if on_it.sum() > count:
            count, chosen = int(on_it.sum()), on_it
    if count < FEWEST:
        return hv.Refusal(hv.Outcome.NO_LIMB, f"{count} steep pixels on one cone, fewer than {FEWEST}", points)
    for _ in range(2):
        m = np.linalg.lstsq(rays[chosen], np.ones(chosen.sum()), rcond=None)[0]
        length = float(np.linalg.norm(m))
        if not length > 1.0:
            return hv.Refusal(hv.Outcome.NO_LIMB, "the steep pixels lie on no cone", points)
        wider = _on(m / length, 1.0 / length, rays, towards_bright, pixel_rad)
        if wider.sum() >= FEWEST:
            chosen = wider
    return m / length, float(np.arccos(1.0 / length))


def steep_pixels(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return pixels where the image is steepest along its own slope, (column, row), and the unit vector uphill."""
    low, high = np.percentile(image, [1.0, 99.0])
    if min(image.shape) < 3 or not high > low:
        return np.empty((0, 2)), np.empty((0, 2))
    down, across = np.gradient(np.clip(image, low, high))
    slope = np.hypot(across, down)
    row, column = np.nonzero(slope > 0.5 * STEEP * (high - low))
    inside = (row > 0) & (column > 0) & (row < image.shape[0] - 1) & (column < image.shape[1] - 1)
    row, column = row[inside], column[inside]
    here = slope[row, column]
    uphill = np.stack([across[row, column], down[row, column]], axis=-1) / here[:, None]
    step = np.rint(uphill).astype(int)
    ahead, behind = (slope[row + sign * step[:, 1], column + sign * step[:, 0]] for sign in (1, -1))
    top = np.flatnonzero((here >= ahead) & (here > behind))
    top = top[:: max(1, -(-len(top) // MOST))]
    # The vertex of the parabola through three slopes.
    bend = ahead[top] - 2.0 * here[top] + behind[top]
    vertex = np.clip(0.5 * (behind[top] - ahead[top]) / np.minimum(bend, -1e-12), -0.5, 0.5)
    points = np.stack([column[top], row[top]], axis=-1) + vertex[:, None] * step[top]
    return points, uphill[top]


def _on(
    axis: np.ndarray, cos_rho: float, rays: np.ndarray, towards_bright: np.ndarray, pixel_rad: np.ndarray
) -> np.ndarray:
    """Return which rays lie within a pixel of a cone and are brighter inside."""
    if not np.cos(RHO_RAD[1]) < cos_rho < np.cos(RHO_RAD[0]):
        return np.zeros(len(rays), bool)
    off = np.abs(rays @ axis - cos_rho) / np.sqrt(1.0 - cos_rho**2)
    return (off < pixel_rad) & (towards_bright @ axis > 0.0)
