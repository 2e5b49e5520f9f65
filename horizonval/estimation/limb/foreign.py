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
from horizonval.geometry.rotation import tangent_basis

MARGIN_PX = 4
"""Distance from the top of the air to space, for a start that is right to two pixels and a blurred limb. Foreign light
has as many pixels at least (hot ones are fewer), and takes as much limb to either side with it."""
NOISE_SIGMAS, LEAST_SHARE = 8.0, 0.1
"""Least difference from space, in its noise and as a share of the limb's step: glare below does not move a limb."""


def without_foreign_light(
    image: FloatArray, camera: CameraModel, nadir_cam: FloatArray, rho_rad: float, top_rad: float
) -> FloatArray:
    """Return an image (H, W) with NaN at azimuths with foreign light; as it is if that were most of the limb.

    ``nadir_cam``, ``rho_rad``: cone of the limb, right to two pixels; ``top_rad``: angle from it to the top of the air.
    """
    los, px_per_rad = pixel_directions(camera), max(camera.fx, camera.fy)
    cosine = (los @ nadir_cam).ravel()

    def at(outside_px: float) -> float:
        """Return the cosine of the angle from the nadir at a distance outside the limb."""
        return float(np.cos(np.clip(rho_rad + outside_px / px_per_rad, 0.0, np.pi)))

    top = top_rad * px_per_rad + MARGIN_PX
    # Light farther out than ten margins does not reach the limb.
    near = np.flatnonzero((cosine < at(-MARGIN_PX)) & (cosine > at(top + 10 * MARGIN_PX)))
    cosine, values = cosine[near], image.ravel()[near]
    known = np.isfinite(values)
    space, inside = known & (cosine < at(top)), known & (cosine > at(-1.0))
    limb = near[(cosine < at(-1.0)) & (cosine > at(1.0))]
    if np.count_nonzero(space) < MARGIN_PX or not inside.any() or not len(limb):
        return image
    level = median(values[space])
    off = np.abs(values[space] - level)
    step = abs(float(np.percentile(values[inside], 75.0)) - level)
    noise = MEDIAN_TO_SIGMA * median(off)
    mask = np.zeros(image.shape, dtype=np.uint8)
    mask.ravel()[near[space][off > max(NOISE_SIGMAS * noise, LEAST_SHARE * step)]] = 1
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    large = 1 + np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= MARGIN_PX)
    if not len(large):
        return image
    across = los @ tangent_basis(nadir_cam)
    bins = max(int(2.0 * np.pi * np.sin(rho_rad) * px_per_rad), 8)
    azimuth = np.nan_to_num(np.arctan2(across[..., 1], across[..., 0]))
    place = np.floor((azimuth / (2.0 * np.pi) + 0.5) * bins).astype(np.intp) % bins
    hidden = np.zeros(bins, dtype=bool)
    for label in large:
        there = np.bincount(place[labels == label], minlength=bins) > 0
        wide = max(MARGIN_PX, int(np.count_nonzero(there)) // 2)
        hidden |= maximum_filter1d(there, min(2 * wide + 1, bins), mode="wrap")
    # Light along most of the limb is a veil or a glow, of which the fit has a model, or no limb, which the fit finds.
    return image if float(np.mean(hidden[place.ravel()[limb]])) > 0.5 else np.where(hidden[place], np.nan, image)
