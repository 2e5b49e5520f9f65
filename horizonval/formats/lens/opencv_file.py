"""A camera as OpenCV's calibration program writes it, YAML, XML or JSON of ``cv::FileStorage``, read by OpenCV.

Of ``fisheye_model = 1`` the coefficients are those of the fisheye. Pixel 0 is the centre of the first.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2

from horizonval.core import files
from horizonval.core.errors import UserError
from horizonval.formats.lens.intrinsics import FISHEYE, FileReader, Intrinsics
from horizonval.formats.lens.yaml_file import MAX_FILE_BYTES

EXPECTED = "a file of OpenCV's FileStorage: image_width, image_height, camera_matrix, distortion_coefficients"
MATRICES = ("camera_matrix", "Camera_Matrix", "cameraMatrix", "K", "M1")
COEFFICIENTS = ("distortion_coefficients", "Distortion_Coefficients", "distCoeffs", "dist_coeffs", "D", "D1")
WIDTHS, HEIGHTS = ("image_width", "image_Width"), ("image_height", "image_Height")


def is_opencv(text: str) -> bool:
    """Whether a text is one of FileStorage: no other program writes its type of a matrix."""
    return "opencv-matrix" in text or "<opencv_storage>" in text


def of_opencv(path: Path) -> Intrinsics:
    """Return the camera in a file; what is wrong is a :class:`UserError` with file and key."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=EXPECTED)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    except cv2.error as error:
        raise UserError("OpenCV cannot read it", where=str(path), expected=EXPECTED) from error
    try:
        data = {key: _value(storage.getNode(key)) for key in storage.root().keys()}  # noqa: SIM118  (no mapping)
    finally:
        storage.release()
    read = FileReader(data, str(path))
    width, height = read.size(read.first(*WIDTHS) or WIDTHS[0]), read.size(read.first(*HEIGHTS) or HEIGHTS[0])
    fx, fy, cx, cy = read.matrix(read.first(*MATRICES) or MATRICES[0])
    key = read.first(*COEFFICIENTS) or COEFFICIENTS[0]
    if data.get("fisheye_model"):
        return Intrinsics(width, height, fx, fy, cx, cy, tuple(read.numbers(key, 4)), FISHEYE)
    k = read.numbers(key, (0, 4, 5, 8, 12, 14)) if key in data else []
    return Intrinsics(width, height, fx, fy, cx, cy, read.brown(key, k))


def _value(node: Any) -> Any:
    """Return what a node holds: a matrix as its numbers by rows, a number, a text; None of anything else."""
    if node.isMap():
        try:
            return node.mat().ravel().tolist()
        except (cv2.error, AttributeError):
            return None
    if node.isInt() or node.isReal():
        return node.real()
    if node.isSeq():
        return [node.at(i).real() for i in range(node.size())]
    return node.string() if node.isString() else None
