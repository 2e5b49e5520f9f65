"""A satellite's streak in an image of the sky: found by a matched filter, measured by a fit.

1. The background is a plane through medians of blocks; the noise is that of the residual (median absolute deviation).
2. The matched filter is the streak that the predicted orbit makes, at every pixel. Its response over its own noise is
   the significance; what stays below the threshold is not looked at.
3. Stars answer the filter too, but a filter for points more: places near a higher response of that one are left out.
4. The highest responses that remain are fitted in turn. The first fit that is bright enough, and
   whose run is known well enough to be the predicted one, is the satellite.

*Image of a point that moves during the exposure.* With a Gaussian point spread of standard deviation s, a point of unit
light at (x, y) puts into pixel (i, j) ::

    P(i, j) = D(i - x) D(j - y),     D(t) = [erf((t + 1/2) / s sqrt 2) - erf((t - 1/2) / s sqrt 2)] / 2

which is exact over the pixel's area and adds up to 1. Along its path the point is integrated by Gauss's rule, finely
enough that the rule's error is below rounding; the sum over nodes of products is one product of two matrices.

*Fit* of middle, run, light and background, with their covariance: Gauss-Newton on ``electrons = light x streak(middle,
run) + background``, each pixel weighted with the variance that the model predicts for it (photons, read noise,
quantisation, unequal response); weights from the model instead of the data leave no bias towards dark pixels. Pixels
that stay five sigma away (stars) are then left out, and the fit is repeated. The covariance is the inverse of Fisher's
information, ``(J^T W J)^-1``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from horizonval.core.arrays import FloatArray


def points_image(
    uv: ArrayLike, light: ArrayLike, sigma_px: float, shape: tuple[int, int], origin_uv: tuple[float, float] = (0, 0)
) -> FloatArray:
    """Return the image of points, shape (H, W).

    ``uv``: shape (n, 2), column and row; ``light``: shape (n,), of each point in all; ``origin_uv``: of the first
    pixel.
    """
    place = np.asarray(uv, float).reshape(-1, 2)
    scale = sigma_px * np.sqrt(2.0)

    def share(centre: FloatArray, count: int, first: float) -> FloatArray:
        edges = first + np.arange(count + 1) - 0.5
        return np.asarray(0.5 * np.diff(erf((edges - centre[:, None]) / scale), axis=1))

    across = share(place[:, 0], shape[1], origin_uv[0]) * np.asarray(light, float)[:, None]
    return np.asarray(share(place[:, 1], shape[0], origin_uv[1]).T @ across)


def path_nodes(ends_uv: ArrayLike, sigma_px: float) -> tuple[FloatArray, FloatArray]:
    """Return times in [0, 1] and weights of the rule for a path from ``ends_uv[0]`` to ``ends_uv[-1]``, shape (n,)."""
    ends = np.asarray(ends_uv, float)
    length = float(np.hypot(*(ends[-1] - ends[0])))
    x, w = np.polynomial.legendre.leggauss(8 + int(2.0 * length / sigma_px))
    return 0.5 * (x + 1.0), 0.5 * w


def streak_image(
    path_uv: ArrayLike,
    light: float,
    sigma_px: float,
    shape: tuple[int, int],
    origin_uv: tuple[float, float] = (0, 0),
) -> FloatArray:
    """Return the image of a point moving along the parabola (or line) through its begin, middle and end, shape (H, W).

    ``light``: in the whole image plane, uniform over time.
    """
    path = np.asarray(path_uv, float)
    t, w = path_nodes(path, sigma_px)
    if len(path) == 2:
        uv = path[0] + t[:, None] * (path[1] - path[0])
    else:
        begin, middle, end = (2 * t - 1) * (t - 1), 4 * t * (1 - t), t * (2 * t - 1)
        uv = np.stack([begin, middle, end], axis=1) @ path
    return points_image(uv, light * w, sigma_px, shape, origin_uv)


MOST_STEPS = 30
REJECT_SIGMA = 5.0
_STEP_PX = 1e-3
_SMALL_PX = 1e-4


@dataclass(frozen=True)
class Noise:
    """Of a pixel: read noise and converter [e- rms], and how unequal the pixels respond (relative, rms)."""

    read_e: float
    prnu: float = 0.0

    def variance(self, electrons: FloatArray) -> FloatArray:
        """Return the variance [e-^2] of pixels with these expected electrons."""
        light = np.maximum(electrons, 0.0)
        return light + self.read_e**2 + (self.prnu * light) ** 2


@dataclass(frozen=True)
class StreakFit:
    """Middle and run (end minus begin) [px], light and background [e-]; ``covariance`` (6, 6); ``chi2`` per freedom."""

    middle_uv: tuple[float, float]
    run_uv: tuple[float, float]
    light_e: float
    background_e: float
    covariance: FloatArray
    chi2: float

    @property
    def length_px(self) -> float:
        """Length of the run."""
        return float(np.hypot(*self.run_uv))


def fit_streak(
    electrons: FloatArray,
    origin_uv: tuple[int, int],
    sigma_px: float,
    noise: Noise,
    start_uv: tuple[float, float],
    run_uv: tuple[float, float],
) -> StreakFit | None:
    """Return the best streak in a patch (h, w) at ``origin_uv``, starting near the truth; None if it diverges."""
    height, width = electrons.shape
    shape = (height, width)

    def unit(p: FloatArray) -> FloatArray:
        half = 0.5 * p[2:4]
        return streak_image([p[:2] - half, p[:2] + half], 1.0, sigma_px, shape, origin_uv)

    background = float(np.median(electrons))
    first = unit(np.array([*start_uv, *run_uv]))
    light = float(np.sum(first * (electrons - background)) / np.sum(first**2))
    p = np.array([*start_uv, *run_uv, max(light, 1.0), background])
    low = np.array(origin_uv) - 0.5
    high = low + np.array([width, height])
    used = np.ones(electrons.size)
    rejected = False
    for _ in range(MOST_STEPS):
        shape_now = unit(p)
        model = p[4] * shape_now + p[5]
        columns = []
        for k in range(4):
            step = np.zeros(6)
            step[k] = _STEP_PX
            columns.append(p[4] * (unit(p + step) - unit(p - step)) / (2 * _STEP_PX))
        jacobian = np.stack([*columns, shape_now, np.ones_like(shape_now)], axis=-1).reshape(-1, 6)
        weight = used / noise.variance(model).ravel()
        information = jacobian.T @ (weight[:, None] * jacobian)
        residual = (electrons - model).ravel()
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return None
        change = covariance @ (jacobian.T @ (weight * residual))
        # A start that is off by more than the point spread must not leap: two pixels at most.
        change[:4] *= min(1.0, 2.0 / max(float(np.abs(change[:4]).max()), 1e-12))
        p = p + change
        if not np.all(np.isfinite(p)) or np.any(p[:2] < low) or np.any(p[:2] > high):
            return None
        if np.abs(change[:4]).max() < _SMALL_PX:
            if not rejected:
                used, rejected = (residual**2 < REJECT_SIGMA**2 * noise.variance(model).ravel()).astype(float), True
                continue
            chi2 = float(np.sum(weight * residual**2) / (used.sum() - 6))
            return StreakFit((p[0], p[1]), (p[2], p[3]), float(p[4]), float(p[5]), covariance, chi2)
    return None


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
    """The satellite's streak, its significance, and its patch; ``moment_uv``: first moment there."""

    fit: StreakFit
    significance: float
    origin_uv: tuple[int, int]
    moment_uv: tuple[float, float]


def find_streak(
    electrons: FloatArray, run_uv: tuple[float, float], sigma_px: float, noise: Noise
) -> Detection | NoDetection:
    """Return the streak of predicted run in an image of electrons, shape (H, W).

    ``run_uv``: predicted end minus begin [px], of either sign; ``sigma_px``: of the calibrated point spread.
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
