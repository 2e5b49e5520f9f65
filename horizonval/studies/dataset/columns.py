"""What stands beside every image: its truth, and what a sensor knows of its camera, as numbers of fixed shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.frame import FrameTruth

COLUMNS: dict[str, str] = {
    "nadir_cam": "unit vector to the Earth's centre, camera axes",
    "nadir_geodetic_cam": "unit vector along the geodetic vertical, camera axes",
    "q_cam_from_itrs": "quaternion, scalar last",
    "q_cam_from_body": "quaternion of the mounting, scalar last",
    "q_body_from_lvlh": "quaternion of the attitude, scalar last",
    "r_itrs": "position, m",
    "altitude_m": "geodetic height, m",
    "angular_radius_rad": "of the Earth, mean over the horizon",
    "sun_cam": "unit vector to the Sun, camera axes",
    "sun_visible_fraction": "share of the Sun's disc seen past the Earth",
    "epoch_unix_s": "instant, s since 1970 UTC",
    "camera": "fx, fy, cx, cy [px], then five numbers of distortion",
    "full_scale": "largest digital number",
    "scene": "number of the scene",
    "frame": "number of the frame in the data set",
}
"""By name what they are; ``image`` stands beside them: digital numbers, shape (bands, height, width)."""


@dataclass(frozen=True)
class ShardContent:
    """Frames in their order.

    Attributes
    ----------
    images : ndarray, shape (n, bands, height, width), uint16
    columns : dict of ndarray
        By the names of :data:`COLUMNS`, first axis n; float64, whole numbers int64.
    """

    images: NDArray[np.uint16]
    columns: Mapping[str, NDArray[Any]]


def row_of(truth: FrameTruth, full_scale: int, scene: int, frame: int) -> dict[str, Any]:
    """Return the columns of one frame."""
    camera = truth.camera_model
    distortion = [float(k) for k in camera.distortion][:5]
    return {
        "nadir_cam": truth.nadir_geocentric_cam,
        "nadir_geodetic_cam": truth.nadir_geodetic_cam,
        "q_cam_from_itrs": truth.q_cam_from_itrs,
        "q_cam_from_body": truth.q_cam_from_body,
        "q_body_from_lvlh": truth.q_body_from_lvlh,
        "r_itrs": truth.r_itrs,
        "altitude_m": truth.altitude_m,
        "angular_radius_rad": truth.angular_radius_rad,
        "sun_cam": truth.sun_cam,
        "sun_visible_fraction": truth.sun_visible_fraction,
        "epoch_unix_s": datetime.fromisoformat(truth.epoch_utc.replace("Z", "+00:00")).timestamp(),
        "camera": [camera.fx, camera.fy, camera.cx, camera.cy, *distortion, *[0.0] * (5 - len(distortion))],
        "full_scale": full_scale,
        "scene": scene,
        "frame": frame,
    }


def content_of(images: Sequence[NDArray[np.uint16]], rows: Sequence[Mapping[str, Any]]) -> ShardContent:
    """Return frames as arrays."""
    return ShardContent(np.stack(images), {name: np.array([row[name] for row in rows]) for name in COLUMNS})
