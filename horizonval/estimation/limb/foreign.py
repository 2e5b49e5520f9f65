"""Light outside the limb that no air explains: the Moon, lamps, booms and their reflections.

What lies farther out than the air is space, of one level but for noise. Where some pixels together differ from it, the
limb below them cannot be distinguished from what stands before it, and that azimuth is left out of the image. Single
pixels are left to the fit, which knows outliers.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.ndimage import maximum_filter1d

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import MEDIAN_TO_SIGMA, median, pixel_directions
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

MARGIN_PX, SKY_PX = 4.0, 40.0
"""From the top of the air to where space begins, for a start that is right to two pixels and a blurred limb; and how
far from there light may still reach the limb."""
NOISE_SIGMAS, LEAST_SHARE = 8.0, 0.1
"""Least difference from space, in its noise and as a share of the limb's step: glare below does not move a limb."""
FEWEST_PX = 4
"""Two by two pixels: hot ones are fewer."""
DILATED_PX = 4
"""Limb to either side of foreign light that is left out too, and at least half as much as the light's own width."""
MOST_HIDDEN = 0.5
"""Share of the limb in view that may be left out."""


def without_foreign_light(
    image: FloatArray, camera: CameraModel, nadir_cam: FloatArray, rho_rad: float, top_rad: float
) -> FloatArray:
    """Return an image (H, W) with NaN at azimuths with foreign light; as it is if that were most of the limb.

    ``nadir_cam``, ``rho_rad``: cone of the limb, right to two pixels; ``top_rad``: angle from it to the top of the air.
    """
    los, px_per_rad = pixel_directions(camera), max(camera.fx, camera.fy)
    outside = (off_axis_angle(los, nadir_cam) - rho_rad) * px_per_rad
    top = top_rad * px_per_rad + MARGIN_PX
    with np.errstate(invalid="ignore"):
        known = np.isfinite(image)
        space = known & (outside > top) & (outside < top + SKY_PX)
        inside = known & (outside < -1.0) & (outside > -MARGIN_PX)
        limb = np.abs(outside) < 1.0
    if np.count_nonzero(space) < FEWEST_PX or not inside.any() or not limb.any():
        return image
    level = median(image[space])
    off = np.abs(image - level)
    step = abs(float(np.percentile(image[inside], 75.0)) - level)
    noise = MEDIAN_TO_SIGMA * median(off[space])
    lit = space & (off > max(NOISE_SIGMAS * noise, LEAST_SHARE * step))
    _, labels, stats, _ = cv2.connectedComponentsWithStats(lit.astype(np.uint8), connectivity=8)
    large = np.flatnonzero(stats[:, cv2.CC_STAT_AREA] >= FEWEST_PX)
    large = large[large > 0]
    if not len(large):
        return image
    across = los @ tangent_basis(nadir_cam)
    bins = max(int(2.0 * np.pi * np.sin(rho_rad) * px_per_rad), 8)
    azimuth = np.nan_to_num(np.arctan2(across[..., 1], across[..., 0]))
    place = np.floor((azimuth / (2.0 * np.pi) + 0.5) * bins).astype(np.intp) % bins
    hidden = np.zeros(bins, dtype=bool)
    for label in large:
        there = np.bincount(place[labels == label], minlength=bins) > 0
        wide = max(DILATED_PX, int(np.count_nonzero(there)) // 2)
        hidden |= maximum_filter1d(there, min(2 * wide + 1, bins), mode="wrap")
    # Light all round is a veil or a glow, of which the fit has a model, or no limb, which the fit finds out.
    return image if float(np.mean(hidden[place[limb]])) > MOST_HIDDEN else np.where(hidden[place], np.nan, image)
