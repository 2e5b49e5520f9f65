"""What an estimate costs: against one pass of OpenCV's Sobel and Canny over the same image, in the same run.

Both are processor time on one thread; images are formulas with noise, in whole numbers as a detector gives them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from horizonval.estimation import registry
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import CameraModel, pixel_grid, unproject
from horizonval.geometry.directions import off_axis_angle

OFF_RAD, TURN_RAD = math.radians(62.0), 0.2
NADIR = np.array([math.sin(OFF_RAD) * math.sin(TURN_RAD), math.sin(OFF_RAD) * math.cos(TURN_RAD), math.cos(OFF_RAD)])
RHO_RAD = math.radians(60.0)
FULL_SCALE = 4095.0


def observation(width: int, height: int, band_kind: str) -> Observation:
    focal = 0.88 * width
    camera = CameraModel(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
    depth_px = (RHO_RAD - off_axis_angle(unproject(camera, pixel_grid(camera)), NADIR)) * focal
    noise = np.random.default_rng(3).normal(0.0, 20.0, depth_px.shape)
    image = np.rint(np.clip(150.0 + 2500.0 * ndtr(depth_px / 0.9) + noise, 0.0, FULL_SCALE))
    return Observation(image, camera, full_scale=FULL_SCALE, band_kind=band_kind)  # type: ignore[arg-type]


def passes(image: np.ndarray) -> None:
    grey = np.clip(image * (255.0 / FULL_SCALE), 0.0, 255.0).astype(np.uint8)
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)
    dx, dy = cv2.Sobel(smooth, cv2.CV_16S, 1, 0), cv2.Sobel(smooth, cv2.CV_16S, 0, 1)
    cv2.Canny(dx, dy, 40.0, 100.0, L2gradient=True)


def seconds(run: Callable[[], object], least_s: float = 0.05) -> float:
    """Return the processor time of one of several warm runs, the quickest."""
    run()
    taken = []
    for _ in range(7):
        count, start = 0, time.process_time()
        while (spent := time.process_time() - start) < least_s:
            run()
            count += 1
        taken.append(spent / count)
    return min(taken)


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("width", "height", "band_kind", "name", "most"),
    [
        (1024, 1024, "solar", "altitude-free-published", 13.0),
        (1024, 1024, "solar", "altitude-free", 28.0),
        (1024, 1024, "solar", "guarded-altitude-free", 52.0),
        (160, 120, "thermal", "altitude-free", 230.0),
        (160, 120, "thermal", "guarded-altitude-free", 370.0),
    ],
)
def test_an_estimate_costs_so_many_passes_over_its_image(
    width: int, height: int, band_kind: str, name: str, most: float
) -> None:
    seen = observation(width, height, band_kind)
    estimator = registry.get(name)
    assert isinstance(estimator.run(seen), Fit)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        one, estimate = seconds(lambda: passes(seen.image)), seconds(lambda: estimator.run(seen))
    finally:
        cv2.setNumThreads(threads)
    ratio = estimate / one
    assert ratio < most, f"{1e3 * estimate:.1f} ms, {ratio:.0f} passes of {1e3 * one:.2f} ms"
