"""A camera as MATLAB tells it: ``jsonencode(toStruct(cameraParams))``, of ``cameraParameters`` or ``cameraIntrinsics``.

MATLAB counts pixels from 1, so that its principal point is ours and one more; ``IntrinsicMatrix`` is the transpose of
``K``; ``ImageSize`` is rows and columns. Radial coefficients are ``k1 k2`` or ``k1 k2 k3``, tangential ones ``p1 p2``,
of the same formulas as OpenCV's.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.formats.lens.intrinsics import FileReader, Intrinsics

EXPECTED = "the struct of MATLAB's cameraParameters as JSON: ImageSize, K or FocalLength with PrincipalPoint"
FIRST_PIXEL = 1.0


def is_matlab(data: Mapping[str, Any]) -> bool:
    """Whether the keys are those of a struct of MATLAB's."""
    return "ImageSize" in data or "IntrinsicMatrix" in data or "PrincipalPoint" in data


def of_matlab(data: Mapping[str, Any], path: Path) -> Intrinsics:
    """Return the camera of a struct; what is wrong is a :class:`UserError` with file and key."""
    read = FileReader(data, str(path))
    if "MappingCoefficients" in data:
        raise UserError(
            "a fisheye of MATLAB's own",
            where=f"{path}: MappingCoefficients",
            expected="cameraParameters or cameraIntrinsics",
            fix="calibrate with OpenCV's fisheye",
        )
    rows, columns = read.numbers("ImageSize", 2)
    if "FocalLength" in data:
        fx, fy = read.numbers("FocalLength", 2)
        cx, cy = read.numbers("PrincipalPoint", 2)
        if "Skew" in data:
            read.square("Skew", read.numbers("Skew", 1)[0], fx)
    elif "K" in data:
        fx, fy, cx, cy = read.matrix("K")
    else:
        fx, fy, cx, cy = read.matrix("IntrinsicMatrix", transposed=True)
    radial = read.numbers("RadialDistortion", (2, 3)) if "RadialDistortion" in data else [0.0, 0.0]
    tangential = read.numbers("TangentialDistortion", 2) if "TangentialDistortion" in data else [0.0, 0.0]
    k1, k2, k3 = [*radial, 0.0][:3]
    distortion = (k1, k2, *tangential, k3)
    return Intrinsics(int(columns), int(rows), fx, fy, cx - FIRST_PIXEL, cy - FIRST_PIXEL, distortion)
