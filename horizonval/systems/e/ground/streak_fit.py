"""The most likely straight streak in a small image: middle, run, light and background, with their covariance.

Gauss-Newton on ``electrons = light x streak(middle, run) + background``, each pixel weighted with the variance that the
model predicts for it (photons, read noise, quantisation, unequal response); weights from the model instead of the data
leave no bias towards dark pixels. Pixels that stay five sigma away (stars) are then left out, and
the fit is repeated. The covariance is the inverse of Fisher's information, ``(J^T W J)^-1``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.systems.e.ground.streak import streak_image

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
    """Middle and run (end minus begin) [px], light and background [e-]; ``covariance`` (6, 6) in that order.

    ``chi2`` is per degree of freedom.
    """

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
    """Return the best streak in a patch, shape (h, w), whose first pixel is ``origin_uv``; None if it runs away.

    ``start_uv`` and ``run_uv`` are where to begin, within the point spread's width of the truth or some pixels along.
    """
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
