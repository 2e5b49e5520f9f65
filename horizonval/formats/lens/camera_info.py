"""A camera as ROS tells it: the YAML of ``camera_calibration``, or a ``sensor_msgs/CameraInfo`` message as text.

``K`` is the lens; ``P``, that of a rectified image, and ``R`` are not read. Pixel 0 is the centre of the first.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.formats.lens.intrinsics import FISHEYE, FileReader, Intrinsics

EXPECTED = "a camera_info file of ROS: image_width, image_height, camera_matrix, distortion_model"
BROWN_MODELS = ("plumb_bob", "rational_polynomial", "")
FISHEYE_MODELS = ("equidistant", "fisheye")


def is_camera_info(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a camera_info."""
    return "distortion_model" in data and ("camera_matrix" in data or "K" in data or "k" in data)


def of_camera_info(data: Mapping[str, Any], path: Path) -> Intrinsics:
    """Return the camera of a camera_info; what is wrong is a :class:`UserError` with file and key."""
    read = FileReader(data, str(path))
    model = str(data.get("distortion_model") or "").lower()
    if model not in BROWN_MODELS + FISHEYE_MODELS:
        raise UserError(
            f"found {model!r}",
            where=f"{path}: distortion_model",
            expected="plumb_bob, rational_polynomial, equidistant or fisheye",
        )
    width, height = (read.size(read.first(f"image_{side}", side) or f"image_{side}") for side in ("width", "height"))
    fx, fy, cx, cy = read.matrix(read.first("camera_matrix", "K", "k") or "camera_matrix")
    key = read.first("distortion_coefficients", "D", "d")
    name = str(data.get("camera_name") or "")
    if model in FISHEYE_MODELS:
        k = read.numbers(key or "distortion_coefficients", 4)
        return Intrinsics(width, height, fx, fy, cx, cy, tuple(k), FISHEYE, name)
    k = [] if key is None else read.numbers(key, (0, 4, 5, 8, 12, 14))
    return Intrinsics(width, height, fx, fy, cx, cy, read.brown(key or "D", k), name=name)
