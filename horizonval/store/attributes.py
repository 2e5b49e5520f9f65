"""Attributes and masks for other programs: OpenEXR's standard attributes and typed ones of ours.

They come from the truth, its maps and the camera file, and are never read back: scoring reads ``horizonval:truth``. The
standard attributes are float32 and cannot state everything (lens distortion); meanings and units are those of
https://openexr.com/en/latest/StandardAttributes.html. Ours are doubles where the format allows. A mask is 1 or 0.
"""

from __future__ import annotations

import json
import math
import uuid
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.estimation.methods.ideal import ReadingStatus, horizon_sensor
from horizonval.frame import FrameTruth, Hit
from horizonval.geometry.camera import CameraModel, camera_from_spec
from horizonval.geometry.clock import julian_tai
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.detector import Cmos

UNITS = {
    "altitude": "m",
    "aperture": "f-number",
    "capDate": "UTC",
    "effectiveFocalLength": "mm",
    "expTime": "s",
    "focus": "m",
    "latitude": "deg",
    "longitude": "deg",
    "nominalFocalLength": "mm",
    "pinholeFocalLength": "mm",
    "screenWindowCenter": "at unit distance",
    "screenWindowWidth": "at unit distance",
    "sensorAcquisitionRectangle": "px",
    "sensorCenterOffset": "um",
    "sensorOverallDimensions": "mm",
    "sensorPhotositePitch": "um",
    "tStop": "f-number",
    "utcOffset": "s",
    "worldToCamera": "m",
    "horizonval:band_hi_um": "um",
    "horizonval:band_lo_um": "um",
    "horizonval:camera_position_m": "m",
    "horizonval:epoch_tai_mjd": "d",
    "horizonval:exposure_s": "s",
    "horizonval:focal_length_px": "px",
    "horizonval:horizon_pitch_elevation_deg": "deg",
    "horizonval:horizon_pitch_error_deg": "deg",
    "horizonval:horizon_roll_elevation_deg": "deg",
    "horizonval:horizon_roll_error_deg": "deg",
    "horizonval:image_circle_deg": "deg",
    "horizonval:itrs_to_camera": "m",
    "horizonval:principal_point_px": "px",
}
"""Units of the attributes that have one."""

_NAMESPACE = uuid.UUID("0b4d6f0e-2c1a-5f57-9a53-6c1f5d3f8a10")
"""Namespace of the identifiers of camera files."""


def standard_attributes(truth: FrameTruth, spec: CameraSpec, exposure_s: float | None = None) -> dict[str, Any]:
    """Return the standard attributes whose values are known.

    ``worldToCamera`` maps ITRS metres, as a row vector with a trailing 1, to the format's camera axes (x right, y up,
    z forward): ``p_camera = p_itrs @ M``. As float32 it holds directions to 0.01 arcsec and the position to 0.5 m.
    ``worldToNDC`` goes on to the image of an ideal lens: x and y divided by the last component run from 0 to 1 from
    the outer edge of the first column and row to that of the last.

    ``spec`` is the camera that took the image, or for which the frame was rendered; ``exposure_s`` replaces its
    exposure.
    """
    camera = camera_from_spec(spec.camera)
    world_to_camera = _world_to_camera(truth)
    attributes: dict[str, Any] = {
        "worldToCamera": world_to_camera.astype(np.float32),
        "capDate": _epoch(truth).strftime("%Y:%m:%d %H:%M:%S"),
        "utcOffset": 0.0,
        "altitude": truth.altitude_m,
        "aperture": spec.optics.f_number,
        "tStop": spec.optics.f_number / math.sqrt(spec.optics.transmission),
        "focus": math.inf,
        "colorInteropID": "data",
        "cameraMake": "horizonval (simulated)",
        "cameraUuid": str(uuid.uuid5(_NAMESPACE, json.dumps(spec.model_dump(mode="json"), sort_keys=True))),
        "comments": _summary(truth, spec),
    }
    if spec.camera.name:
        attributes |= {"cameraLabel": spec.camera.name, "cameraModel": spec.camera.name}
    longitude, latitude, _ = erfa.gc2gde(truth.ellipsoid_a_m, truth.ellipsoid.flattening, np.array(truth.r_itrs))
    attributes |= {"longitude": float(np.degrees(longitude)), "latitude": float(np.degrees(latitude))}
    if camera.projection == "pinhole":
        attributes |= _screen_window(camera)
        attributes["worldToNDC"] = _times(world_to_camera, _camera_to_ndc(camera)).astype(np.float32)
    if spec.camera.focal_length_mm is not None:
        attributes["nominalFocalLength"] = spec.camera.focal_length_mm
    if spec.detector is not None:
        attributes |= _sensor(camera, spec.detector.pixel_pitch_um)
    if isinstance(spec.detector, Cmos):
        attributes["expTime"] = spec.detector.exposure_s if exposure_s is None else exposure_s
    return attributes


def own_attributes(truth: FrameTruth, spec: CameraSpec, exposure_s: float | None = None) -> dict[str, Any]:
    """Return typed attributes in full precision, without their prefix; parameters as :func:`standard_attributes`.

    ``itrs_to_camera`` maps ITRS metres, as a row vector with a trailing 1, to our camera axes (x right, y down, z along
    the boresight). A direction ``X, Y, Z`` in them lies at column ``fx X'/Z' + cx`` and row ``fy Y'/Z' + cy``, where
    the primes say that a pinhole's ``distortion`` (k1 k2 p1 p2 k3) is applied and (0, 0) is the centre of the upper
    left pixel; ``skew`` times Y' is added to X' where it is stated. ``unified_shape`` (xi, alpha, beta) belongs to a
    unified lens, whose focal length is that on the axis; see :mod:`horizonval.geometry.camera` for other projections.
    """
    camera = camera_from_spec(spec.camera)
    quaternion = {f"q_cam_from_itrs_{axis}": _double(q) for axis, q in zip("xyzw", truth.q_cam_from_itrs, strict=True)}
    attributes: dict[str, Any] = {
        "camera_position_m": np.array(truth.r_itrs),
        "itrs_to_camera": _world_to_camera(truth, y_up=False),
        **quaternion,
        "sun_direction_itrs": np.array(truth.sun_itrs),
        "nadir_direction_camera": np.array(truth.nadir_geocentric_cam),
        **_horizon_reading(truth),
        "epoch_tai_mjd": _double(_tai_mjd(truth)),
        "focal_length_px": np.array([camera.fx, camera.fy]),
        "principal_point_px": np.array([camera.cx, camera.cy]),
        "distortion": [float(k) for k in camera.distortion],
    }
    if camera.skew:
        attributes["skew"] = _double(camera.skew)
    if camera.projection == "unified":
        attributes["unified_shape"] = [float(v) for v in camera.shape]
    if camera.image_circle_rad is not None:
        attributes["image_circle_deg"] = _double(2 * math.degrees(camera.image_circle_rad))
    if spec.band:
        ends = [_ends_um(band) for band in spec.band]
        attributes |= {
            "band_names": [band.name for band in spec.band],
            "band_lo_um": [lo for lo, _ in ends],
            "band_hi_um": [hi for _, hi in ends],
        }
    if isinstance(spec.detector, Cmos):
        attributes["exposure_s"] = _double(spec.detector.exposure_s if exposure_s is None else exposure_s)
    return attributes


def _horizon_reading(truth: FrameTruth) -> dict[str, Any]:
    """Return what the ideal sensor reads, by both readings of its documentation; nothing where it reads nothing."""
    radius_m = float(np.linalg.norm(truth.r_itrs)) * math.sin(truth.angular_radius_rad)
    found = horizon_sensor(np.array(truth.r_itrs), np.array(truth.q_cam_from_itrs), radius_m)
    if found.status is not ReadingStatus.DEFINED:
        return {}
    angles = {
        "horizon_roll_error_deg": found.roll_error_rad,
        "horizon_pitch_error_deg": found.pitch_error_rad,
        "horizon_roll_elevation_deg": found.roll_elevation_rad,
        "horizon_pitch_elevation_deg": found.pitch_elevation_rad,
    }
    return {name: _double(math.degrees(angle)) for name, angle in angles.items()}


def camera_of(truth: FrameTruth, observation: Mapping[str, Any] | None = None) -> CameraSpec:
    """Return the camera that took an image: the one the observation names, else the frame's own."""
    named = (observation or {}).get("camera")
    return CameraSpec.model_validate(named) if named else truth.camera_spec


def _double(value: float) -> FloatArray:
    """Return what the library writes as a double; it turns a Python float into a float32."""
    return np.array([value], dtype=np.float64)


def _epoch(truth: FrameTruth) -> datetime:
    return datetime.fromisoformat(truth.epoch_utc).astimezone(UTC)


def _tai_mjd(truth: FrameTruth) -> float:
    day, fraction = julian_tai(_epoch(truth))
    return float(day - 2400000.5) + float(fraction)


def _summary(truth: FrameTruth, spec: CameraSpec) -> str:
    bands = ", ".join(band.name for band in spec.band)
    return f"scene {truth.scene_name}, {truth.epoch_utc}, bands {bands}; world axes are ITRS in metres"


def _ends_um(band: Band) -> tuple[float, float]:
    if band.lo_um is not None and band.hi_um is not None:
        return band.lo_um, band.hi_um
    return band.wavelength_um[0], band.wavelength_um[-1]


def _world_to_camera(truth: FrameTruth, *, y_up: bool = True) -> FloatArray:
    rotation = Rotation.from_quat(truth.q_cam_from_itrs).as_matrix()
    rotation[1] *= -1.0 if y_up else 1.0
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T
    matrix[3] = -_times(np.array([*truth.r_itrs, 0.0])[None], matrix)[0]
    matrix[3, 3] = 1.0
    return matrix + 0.0  # No -0.0, which is not equal in bytes.


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the matrix product, its sums in one order on every processor: the bytes of a file depend on it."""
    product: FloatArray = (a[:, :, None] * b[None, :, :]).sum(axis=1)
    return product


def _camera_to_ndc(camera: CameraModel) -> FloatArray:
    """Return the homogeneous matrix from the format's camera axes to the image; the depth (third component) is 1."""
    matrix = np.zeros((4, 4))
    matrix[0, 0] = camera.fx / camera.width
    matrix[1, 1] = -camera.fy / camera.height
    if camera.skew:
        matrix[1, 0] = -camera.skew * camera.fx / camera.width
    matrix[2] = [(camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height, 1.0, 1.0]
    return matrix


def _screen_window(camera: CameraModel) -> dict[str, Any]:
    """Return the image's outline in the plane at unit distance, its centre measured right and up."""
    right = ((camera.width - 1) / 2 - camera.cx) / camera.fx
    up = -((camera.height - 1) / 2 - camera.cy) / camera.fy
    return {
        "screenWindowWidth": camera.width / camera.fx,
        "screenWindowCenter": np.array([right + 0.0, up + 0.0], dtype=np.float32),
        "pixelAspectRatio": camera.fy / camera.fx,
    }


def _sensor(camera: CameraModel, pitch_um: float) -> dict[str, Any]:
    """Return the sensor's size and the focal length on the axis [mm]; equal-angle grids are scanned and have none."""
    size = np.array([camera.width, camera.height])
    off_centre = (size - 1) / 2 - np.array([camera.cx, camera.cy])
    attributes: dict[str, Any] = {
        "sensorPhotositePitch": pitch_um,
        "sensorOverallDimensions": (size * pitch_um * 1e-3).astype(np.float32),
        "sensorCenterOffset": (off_centre * pitch_um).astype(np.float32),
        "sensorAcquisitionRectangle": (np.zeros(2, dtype=np.int32), (size - 1).astype(np.int32)),
    }
    if camera.projection != "equal_angle":
        attributes["effectiveFocalLength"] = camera.fx * pitch_um * 1e-3
    if camera.projection == "pinhole":
        attributes["pinholeFocalLength"] = camera.fx * pitch_um * 1e-3
    return attributes


Mask = NDArray[np.float16]


def earth_mask(maps: Mapping[str, NDArray[Any]]) -> Mask:
    """Return where the ray through the pixel's centre meets the ground or a cloud, shape (H, W)."""
    return _mask(np.isin(maps["hit"], (Hit.SURFACE, Hit.CLOUD)))


def sunlit_mask(maps: Mapping[str, NDArray[Any]], truth: FrameTruth) -> Mask:
    """Return where the Sun's centre is above the horizon of what the pixel sees, shape (H, W).

    That is the place of ground or cloud, or the lowest point of a ray through air, from whose height ``h`` the horizon
    dips by ``acos(R / (R + h))`` with the mean radius ``R``. Refraction is left out, as in the truth.
    """
    hit = maps["hit"]
    radius = (2 * truth.ellipsoid_a_m + truth.ellipsoid_b_m) / 3
    in_air = hit == Hit.ATMOSPHERE
    height = np.where(in_air, np.maximum(maps["tangent_height"], 0.0), 0.0).astype(np.float64)
    dip_deg = np.degrees(np.arccos(radius / (radius + height)))
    return _mask((in_air | (earth_mask(maps) > 0)) & (maps["solar_zenith"] < 90.0 + dip_deg))


def saturated_mask(dn: NDArray[Any], full_scale: int) -> Mask:
    """Return where the converter is at its end, shape (H, W)."""
    return _mask(np.asarray(dn) >= full_scale)


def _mask(where: NDArray[np.bool_]) -> Mask:
    return np.ascontiguousarray(where, dtype=np.float16)
