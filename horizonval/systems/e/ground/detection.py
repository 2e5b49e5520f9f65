"""A satellite's streak in an image of the sky: found by a matched filter, measured by a fit.

1. The background is a plane through medians of blocks; the noise is that of the residual (median absolute deviation).
2. The matched filter is the streak that the predicted orbit makes, at every pixel. Its response over its own noise is
   the significance; what stays below the threshold is not looked at.
3. Stars answer the filter too, but a filter for points more: places near a higher response of that one are left out.
4. The highest responses that remain are fitted in turn (:mod:`streak_fit`). The first fit that is bright enough, and
   whose run is known well enough to be the predicted one, is the satellite.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.systems.e.ground.streak import streak_image
from horizonval.systems.e.ground.streak_fit import Noise, StreakFit, fit_streak

THRESHOLD = 6.0
"""Standard deviations. Of the 1e4 independent places in 512 x 512 pixels noise passes one in 1e5 images."""
_CANDIDATES = 12
_BLOCK_PX = 32
_MARGIN_PX = 8
RUN_TOLERANCE = 0.2
"""Largest difference between fitted and predicted run, in units of the predicted length, beside three sigma."""
RUN_SIGMA = 0.25
"""Largest standard deviation of the fitted run, in that unit: two stars in a row have a run that is hardly known."""


class WhyNone(StrEnum):
    """Why there is no satellite in an image."""

    FAINT = "nothing above the noise"
    NO_STREAK = "nothing with the predicted run"
    AT_EDGE = "too near the edge"


@dataclass(frozen=True)
class NoDetection:
    """No satellite was found; ``significance`` of the highest response."""

    why: WhyNone
    significance: float


@dataclass(frozen=True)
class Detection:
    """The satellite's streak, its significance in the filter, and the patch it was measured in.

    ``moment_uv``: the first moment of what is above the background in that patch, the plainest centroid.
    """

    fit: StreakFit
    significance: float
    origin_uv: tuple[int, int]
    moment_uv: tuple[float, float]


def find_streak(
    electrons: FloatArray, run_uv: tuple[float, float], sigma_px: float, noise: Noise
) -> Detection | NoDetection:
    """Return the streak of predicted run in an image of electrons, shape (H, W).

    Parameters
    ----------
    electrons : ndarray, shape (H, W)
    run_uv : (float, float)
        Predicted end minus begin [px]; its sign does not matter.
    sigma_px : float
        Of the point spread, as calibrated.
    noise : Noise
    """
    flat = electrons - background_plane(electrons)
    spread = 1.4826 * float(np.median(np.abs(flat - np.median(flat))))
    length = float(np.hypot(*run_uv))
    reach = int(np.ceil(0.5 * length + 4.0 * sigma_px))
    half = np.array(run_uv) / 2.0
    kernel = streak_image([reach - half, reach + half], 1.0, sigma_px, (2 * reach + 1, 2 * reach + 1))
    significance = _filtered(flat, kernel) / spread
    point = streak_image([[reach, reach]] * 2, 1.0, sigma_px, (2 * reach + 1, 2 * reach + 1))
    as_point = cv2.dilate(_filtered(flat, point) / spread, np.ones((2 * reach + 1,) * 2))
    places = _peaks(np.where(significance > as_point, significance, 0.0), reach)
    best = float(significance.max())
    if not places:
        return NoDetection(WhyNone.FAINT, best)
    edge = False
    for k, (row, column) in enumerate(places):
        size = reach + _MARGIN_PX
        top, left = row - size, column - size
        if top < 0 or left < 0 or row + size >= electrons.shape[0] or column + size >= electrons.shape[1]:
            edge = edge or k == 0
            continue
        patch = electrons[top : row + size + 1, left : column + size + 1]
        fit = fit_streak(patch, (left, top), sigma_px, noise, (float(column), float(row)), run_uv)
        if fit is not None and _is_predicted(fit, run_uv):
            moment = _moment(patch - fit.background_e, kernel.shape[0] // 2 + 2, size)
            return Detection(fit, float(significance[row, column]), (left, top), (left + moment[0], top + moment[1]))
    return NoDetection(WhyNone.AT_EDGE if edge else WhyNone.NO_STREAK, best)


def background_plane(image: FloatArray) -> FloatArray:
    """Return the least-squares plane through the medians of blocks, shape of ``image``."""
    height, width = (size // _BLOCK_PX for size in image.shape)
    blocks = image[: height * _BLOCK_PX, : width * _BLOCK_PX].reshape(height, _BLOCK_PX, width, _BLOCK_PX)
    level = np.median(blocks, axis=(1, 3))
    v, u = (np.arange(size) * _BLOCK_PX + 0.5 * (_BLOCK_PX - 1) for size in (height, width))
    grid_v, grid_u = np.meshgrid(v, u, indexing="ij")
    design = np.stack([np.ones(level.size), grid_u.ravel(), grid_v.ravel()], axis=1)
    c = np.linalg.lstsq(design, level.ravel(), rcond=None)[0]
    return np.asarray(c[0] + c[1] * np.arange(image.shape[1]) + (c[2] * np.arange(image.shape[0]))[:, None])


def _filtered(image: FloatArray, kernel: FloatArray) -> FloatArray:
    """Return the matched filter's response in units of the noise of one pixel, shape of ``image``."""
    response = cv2.filter2D(image, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(response, float) / float(np.sqrt(np.sum(kernel**2)))


def _peaks(significance: FloatArray, reach: int) -> list[tuple[int, int]]:
    """Return the highest responses above the threshold that are none of a higher one's flank, highest first."""
    around = cv2.dilate(significance, np.ones((2 * (reach // 2) + 1,) * 2))
    rows, columns = np.nonzero((significance >= around) & (significance > THRESHOLD))
    order = np.argsort(-significance[rows, columns])[:_CANDIDATES]
    return [(int(rows[i]), int(columns[i])) for i in order]


def _is_predicted(fit: StreakFit, run_uv: tuple[float, float]) -> bool:
    fitted, predicted = np.array(fit.run_uv), np.array(run_uv)
    apart = min(float(np.hypot(*(fitted - predicted))), float(np.hypot(*(fitted + predicted))))
    sigma = float(np.sqrt(np.trace(fit.covariance[2:4, 2:4])))
    length = float(np.hypot(*predicted))
    bright = fit.light_e > THRESHOLD * float(np.sqrt(fit.covariance[4, 4]))
    return bright and sigma < RUN_SIGMA * length and apart < RUN_TOLERANCE * length + 3.0 * sigma


def _moment(light: FloatArray, reach: int, middle: int) -> tuple[float, float]:
    window = slice(middle - reach, middle + reach + 1)
    part = light[window, window]
    at = np.arange(middle - reach, middle + reach + 1, dtype=float)
    total = float(part.sum())
    return float(part.sum(axis=0) @ at) / total, float(part.sum(axis=1) @ at) / total
