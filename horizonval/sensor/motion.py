"""A camera that turns while it looks: blur of the exposure, slant of a rolling shutter.

The scene stands still in the local vertical frame; the camera turns in it at the angular velocity omega (camera axes).
What a pixel sees at the time t after the frame's instant is what the still frame has in the direction turned back::

    image(t)(u) = image(0)(project(exp(t [omega]x) unproject(u)))

The pixel's path over the exposure is taken as a parabola through its exact places at both ends; the image is averaged
along it at Gauss's points, bilinear between pixels. Row r of a rolling shutter is exposed
``(r - (H - 1) / 2) row_time`` after the middle row, whose instant is the frame's.

Neglected: the satellite's own motion along its orbit, which moves the ground (0.9 deg/s below a satellite at 500 km)
but hardly the limb (its azimuth about the nadir turns by a part of the 0.06 deg/s of the orbit); light beyond the
image's border, taken as that of the border; the Sun's motion against the local vertical frame, 0.06 deg/s.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from horizonval.frame import FrameTruth
from horizonval.geometry.camera import Camera, pixel_grid, project, unproject
from horizonval.geometry.frames import rotate

FloatArray = NDArray[np.float64]

GM_M3_PER_S2 = 3.986004418e14
STILL_PX = 0.01
"""Motion below leaves an image as it is: a hundredth of a pixel changes no edge by more than that."""
FARTHEST_RAD = 0.05
"""Turn at which the parabola is fitted at most; beyond it goes on as it is."""
POINTS_PER_PX = 2
MOST_POINTS = 64


def rate_cam_rad_s(truth: FrameTruth) -> FloatArray:
    """Return the camera's angular velocity against the local vertical frame, in camera axes, shape (3,) [rad/s].

    The scene's ``attitude.rate_deg_s``; with ``attitude.hold = "inertial"`` also the orbital rate that the local
    vertical frame turns by, ``sqrt(GM / r^3)`` about its -y axis.
    """
    attitude = truth.scene.get("attitude", {})
    rate = np.radians(np.asarray(attitude.get("rate_deg_s", (0.0, 0.0, 0.0)), dtype=np.float64))
    if attitude.get("hold") == "inertial":
        orbital = np.sqrt(GM_M3_PER_S2 / np.linalg.norm(truth.r_itrs) ** 3)
        rate = rate + rotate(truth.q_body_from_lvlh, [0.0, orbital, 0.0])
    return rotate(truth.q_cam_from_body, rate)


def moved(
    image: FloatArray, camera: Camera, rate_cam_rad_s: FloatArray, exposure_s: float, row_time_s: float = 0.0
) -> FloatArray:
    """Return the mean image over an exposure, shape (H, W).

    Parameters
    ----------
    image : ndarray, shape (H, W)
        As seen by a camera at rest.
    camera : Camera
    rate_cam_rad_s : ndarray, shape (3,)
        The camera's angular velocity in its own axes.
    exposure_s, row_time_s : float
        ``row_time_s`` is 0 for a global shutter.
    """
    path_px = float(np.linalg.norm(rate_cam_rad_s)) * exposure_s * max(camera.fx, camera.fy)
    count = min(max(2, math.ceil(POINTS_PER_PX * path_px)), MOST_POINTS)
    x, weight = np.polynomial.legendre.leggauss(count)
    return averaged(image, camera, rate_cam_rad_s, 0.5 * exposure_s * x, 0.5 * weight, row_time_s)


def averaged(
    image: FloatArray,
    camera: Camera,
    rate_cam_rad_s: FloatArray,
    time_s: FloatArray,
    weight: FloatArray,
    row_time_s: float = 0.0,
) -> FloatArray:
    """Return the weighted mean of what is seen at instants, shape (H, W).

    ``time_s``, ``weight``: shape (k,), against the instant of the frame, for the middle row of a rolling shutter.
    """
    rows = (np.arange(camera.height) - 0.5 * (camera.height - 1)) * row_time_s
    longest = float(np.abs(time_s).max() + np.abs(rows).max())
    if longest == 0.0 or not np.any(rate_cam_rad_s):
        return image
    place = pixel_grid(camera)
    end = min(longest, FARTHEST_RAD / float(np.linalg.norm(rate_cam_rad_s)))
    ahead, behind = (_seen_at(camera, place, rate_cam_rad_s * t) for t in (end, -end))
    slope, bend = (ahead - behind) / (2 * end), (ahead + behind - 2 * place) / (2 * end**2)
    if float(np.hypot(slope[..., 0], slope[..., 1]).max()) * longest < STILL_PX:
        return image
    total = np.zeros_like(image)
    for instant, share in zip(time_s, weight, strict=True):
        t = (rows + instant)[:, None, None]
        at = place + t * (slope + t * bend)
        total += share * map_coordinates(image, [at[..., 1], at[..., 0]], order=1, mode="nearest")
    return total


def _seen_at(camera: Camera, place: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Return where in the still frame the pixels look after a turn, shape (H, W, 2); where they cannot, their place."""
    direction = (
        Rotation.from_rotvec(turn_rad).apply(unproject(camera, place).reshape(-1, 3)).reshape(*place.shape[:2], 3)
    )
    uv, in_front = project(camera, direction)
    usable = in_front & np.isfinite(uv).all(axis=-1)
    return np.where(usable[..., None], uv, place)
