"""Smaller copies of an image: what a detector with wider pixels would have seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel


def smaller(image: FloatArray, camera: CameraModel, scale: int) -> tuple[FloatArray, CameraModel]:
    """Return an image and its camera with pixels ``scale`` times as wide; columns and rows left over are cut."""
    width, height = camera.width // scale, camera.height // scale
    whole = np.asarray(image, dtype=np.float64)[: height * scale, : width * scale]
    small = replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx / scale,
        fy=camera.fy / scale,
        cx=(camera.cx + 0.5) / scale - 0.5,
        cy=(camera.cy + 0.5) / scale - 0.5,
    )
    return whole.reshape(height, scale, width, scale).mean(axis=(1, 3)), small


def in_whole(uv: FloatArray, scale: int) -> FloatArray:
    """Return places (n, 2) of a copy as those of the image that it was made of."""
    return np.asarray(scale * (uv + 0.5) - 0.5)
