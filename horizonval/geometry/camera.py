"""The camera as geometry: directions to pixels and back.

Camera axes: x right, y down, z along the boresight. Pixel ``(0, 0)`` is the *centre* of the upper left pixel, so the
image covers ``[-0.5, W - 0.5] x [-0.5, H - 0.5]``.

Pinhole with Brown-Conrady distortion (coefficients ``k1 k2 p1 p2 k3`` with OpenCV's meaning and order), with
``x = X/Z, y = Y/Z, r2 = x^2 + y^2``::

    x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)
    y' = y (1 + k1 r2 + k2 r2^2 + k3 r2^3) + p1 (r2 + 2 y^2) + 2 p2 x y
    u = fx x' + cx,   v = fy y' + cy

``equal_angle`` is the geostationary fixed grid: the column is proportional to the scan angle ``atan2(X, Z)`` and the
row to the elevation out of the scan plane ``asin(Y)``, with ``fx``, ``fy`` in pixels per radian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from horizonval.spec.camera import CameraGeometry

Projection = Literal["pinhole", "equal_angle"]


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera. Lengths in pixels; see the module text for the conventions."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    projection: Projection = "pinhole"


def camera_from_spec(spec: CameraGeometry) -> Camera:
    """Return the intrinsics of a camera file with every default filled in.

    ``fov_deg`` spans the outer edges of the first and last column; the principal point defaults to the image centre
    ``((W - 1) / 2, (H - 1) / 2)`` and ``fy`` to ``fx``.
    """
    if spec.fx is not None:
        fx = spec.fx
    else:
        assert spec.fov_deg is not None
        half = math.radians(spec.fov_deg) / 2
        fx = spec.width / 2 / (math.tan(half) if spec.projection == "pinhole" else half)
    k = [*spec.distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return Camera(
        width=spec.width,
        height=spec.height,
        fx=fx,
        fy=spec.fy if spec.fy is not None else fx,
        cx=spec.cx if spec.cx is not None else (spec.width - 1) / 2,
        cy=spec.cy if spec.cy is not None else (spec.height - 1) / 2,
        distortion=(k[0], k[1], k[2], k[3], k[4]),
        projection=spec.projection,
    )
