"""What makes the pixels of one unit differ: response, dark signal, hot pixels.

Each unit of a camera has its pattern for life: the streams depend on the camera's name, head and serial number, not on
the rest of the scene. Response is ``1 + prnu x``, dark signal ``dsnu_e x`` with x standard normal, as EMVA 1288
(release 4, chapter 8) measures both. Hot pixels have a dark current that is higher by an exponentially distributed
amount, the shape that displacement damage leaves (G. R. Hopkinson, IEEE Trans. Nucl. Sci. 43, 614 (1996)).

A response below zero is cut at zero: with the largest prnu allowed (0.3) one pixel in 2300.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.frame import FrameTruth
from horizonval.sensor.streams import stream


def unit(camera: str, truth: FrameTruth) -> str:
    """Return the name under which one array has its pattern: the camera's, and the head's where it has several."""
    return camera if truth.head is None else f"{camera}/{truth.head}"


def response(camera: str, serial: int, shape: tuple[int, int], prnu: float) -> FloatArray:
    """Return every pixel's response relative to the mean, shape (H, W)."""
    if prnu == 0.0:
        return np.ones(shape)
    return np.maximum(1.0 + prnu * _generator(camera, serial, "prnu").standard_normal(shape), 0.0)


def dark_offset_e(camera: str, serial: int, shape: tuple[int, int], dsnu_e: float) -> FloatArray:
    """Return every pixel's dark signal minus the mean [e-], shape (H, W)."""
    if dsnu_e == 0.0:
        return np.zeros(shape)
    return dsnu_e * _generator(camera, serial, "dsnu").standard_normal(shape)


def hot_dark_current(
    camera: str, serial: int, shape: tuple[int, int], fraction: float, mean_e_per_s: float
) -> FloatArray:
    """Return the hot pixels' additional dark current [e-/s] at the reference temperature, shape (H, W)."""
    current = np.zeros(shape)
    if fraction > 0.0 and mean_e_per_s > 0.0:
        generator = _generator(camera, serial, "hot")
        hot = generator.random(shape) < fraction
        current[hot] = generator.exponential(mean_e_per_s, int(hot.sum()))
    return current


def _generator(camera: str, serial: int, stage: str) -> np.random.Generator:
    return stream("", camera, "", f"pattern {stage}", serial)
