"""Standard OpenEXR attributes of a frame, for people who open our files in other programs.

Display only: they are float32 and some drop what the format cannot say (lens distortion). What scoring reads is the
truth in ``horizonval:truth``. Meanings and units: https://openexr.com/en/latest/StandardAttributes.html.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import erfa
import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.frame import FrameTruth
from horizonval.geometry.camera import Camera, camera_from_spec
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos


def standard_attributes(truth: FrameTruth, spec: CameraSpec, exposure_s: float | None = None) -> dict[str, Any]:
    """Return the standard attributes that can be filled in truthfully.

    ``worldToCamera`` maps ITRS metres, as a row vector with a trailing 1, to the format's camera axes (x right, y up,
    z forward): ``p_camera = p_itrs @ M``. As float32 it holds directions to 0.01 arcsec and the position to 0.5 m.
    ``exposure_s``: of an image whose camera chose it, in place of the camera file's.
    """
    camera = camera_from_spec(spec.camera)
    attributes: dict[str, Any] = {
        "worldToCamera": _world_to_camera(truth),
        "capDate": datetime.fromisoformat(truth.epoch_utc).astimezone(UTC).strftime("%Y:%m:%d %H:%M:%S"),
        "utcOffset": 0.0,
        "altitude": truth.altitude_m,
        "aperture": spec.optics.f_number,
        "colorInteropID": "data",
    }
    if spec.camera.name:
        attributes["cameraLabel"] = spec.camera.name
    flattening = 1 - truth.ellipsoid_b_m / truth.ellipsoid_a_m
    longitude, latitude, _ = erfa.gc2gde(truth.ellipsoid_a_m, flattening, np.array(truth.r_itrs))
    attributes |= {"longitude": float(np.degrees(longitude)), "latitude": float(np.degrees(latitude))}
    if camera.projection == "pinhole":
        attributes |= _screen_window(camera)
    if spec.detector is not None:
        pitch_um = spec.detector.pixel_pitch_um
        size_mm = np.array([camera.width, camera.height]) * pitch_um * 1e-3
        attributes |= {"sensorPhotositePitch": pitch_um, "sensorOverallDimensions": size_mm.astype(np.float32)}
        if camera.projection == "pinhole":
            attributes["pinholeFocalLength"] = camera.fx * pitch_um * 1e-3
    if isinstance(spec.detector, Cmos):
        attributes["expTime"] = spec.detector.exposure_s if exposure_s is None else exposure_s
    return attributes


def _world_to_camera(truth: FrameTruth) -> np.ndarray:
    to_y_up = np.diag([1.0, -1.0, 1.0])
    rotation = to_y_up @ Rotation.from_quat(truth.q_cam_from_itrs).as_matrix()
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T
    matrix[3, :3] = -rotation @ np.array(truth.r_itrs)
    return np.ascontiguousarray(matrix, dtype=np.float32)


def _screen_window(camera: Camera) -> dict[str, Any]:
    """Return the image's outline in the plane at unit distance, its centre measured right and up."""
    right = ((camera.width - 1) / 2 - camera.cx) / camera.fx
    up = -((camera.height - 1) / 2 - camera.cy) / camera.fy
    return {
        "screenWindowWidth": camera.width / camera.fx,
        "screenWindowCenter": np.array([right, up], dtype=np.float32),
        "pixelAspectRatio": camera.fy / camera.fx,
    }
