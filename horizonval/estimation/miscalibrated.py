r"""A camera with errors: of its focal length, its principal point and its radial distortion.

The distortion's error is counted where it is largest, at the image's farthest corner. With ``r`` the corner's place
without distortion in normalised coordinates (of a fisheye the angle from the boresight) the leading coefficient moves
it by ``f r^3 dk1``, so that::

    dk1 = error_px / (f r^3)
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from horizonval.core.errors import UserError
from horizonval.geometry.camera import CameraModel, unproject


def miscalibrated(
    camera: CameraModel,
    focal_length: float = 0.0,
    principal_point_px: tuple[float, float] = (0.0, 0.0),
    distortion_px: float = 0.0,
) -> CameraModel:
    """Return a camera as it is believed to be.

    Parameters
    ----------
    camera : CameraModel
        As it is.
    focal_length : float
        Error as a share of it.
    principal_point_px : tuple of 2 floats
        Error of column and row.
    distortion_px : float
        Error of the radial distortion at the farthest corner.

    Raises
    ------
    UserError
        An error of the distortion of a camera that has none, or whose corner has no direction.
    """
    k1 = camera.distortion[0]
    if distortion_px != 0.0:
        k1 += distortion_px * k1_per_px(camera)
    return replace(
        camera,
        fx=camera.fx * (1.0 + focal_length),
        fy=camera.fy * (1.0 + focal_length),
        cx=camera.cx + principal_point_px[0],
        cy=camera.cy + principal_point_px[1],
        distortion=(k1, *camera.distortion[1:]),
    )


def k1_per_px(camera: CameraModel) -> float:
    """Return by how much ``k1`` changes where the farthest corner moves outwards by a pixel.

    Raises
    ------
    UserError
        The camera has no distortion, or its corner no direction.
    """
    if camera.projection == "equal_angle":
        raise UserError(
            "the projection equal_angle has no distortion",
            where="calibration: distortion_error_px, distortion_sigma_px",
            expected="a pinhole or a fisheye",
        )
    u = max((-0.5, camera.width - 0.5), key=lambda place: abs(place - camera.cx))
    v = max((-0.5, camera.height - 0.5), key=lambda place: abs(place - camera.cy))
    if camera.projection == "fisheye" and camera.image_circle_rad is not None:
        radius = camera.image_circle_rad
    else:
        x, y, z = unproject(replace(camera, image_circle_rad=None), np.array([u, v]))
        radius = math.atan2(math.hypot(x, y), z) if camera.projection == "fisheye" else math.hypot(x, y) / z
    if not (math.isfinite(radius) and radius > 0.0):
        raise UserError(
            "the image's farthest corner has no direction",
            where="calibration: distortion_error_px, distortion_sigma_px",
            expected="a camera whose distortion is one to one over the image",
        )
    return 1.0 / (math.sqrt(camera.fx * camera.fy) * radius**3)
