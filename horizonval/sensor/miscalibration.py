r"""What a platform believes of its camera and its time: the truth with the errors of the table ``[calibration]``.

An error is what is told less what is true: the key's own, and one drawn from its sigma. As with ``[prior]`` every
quantity has a random stream of its own, seeded with ``calibration.draw``, or without it the scene's ``draw`` or name,
with the scene's seed, and, of what is a lens's own, with the head.

- the camera: :mod:`horizonval.estimation.miscalibrated`;
- the mounting ``M``: ``q_cam_from_body`` is told as ``M exp([e x])``, so that an answer's roll and pitch of a level
  body are larger by ``e_x`` and ``e_y``;
- the clock, ahead by ``e``: inertial axes are right, since stars need no clock, and with ``n = sqrt(GM / r^3)`` about
  the orbit's normal ``h`` and the Earth's rotation ``w`` the position is told as ``R_z(-w e) exp(n e [h x]) r``;
- the exposure, later than its stamp by ``e``: position and attitude are those of ``e`` before the frame's instant.

What is measured on the body (attitude, the Sun) comes to camera axes by the mounting that is believed. Values that
``[prior]`` states stand as they are: clock and offset move drawn ones. Sigmas of clock, offset and mounting are added
in squares to those of position and attitude, the first along all three axes although they act along the orbit.

**Neglected.** The orbit is a circle at the frame's height. A drawn altitude does not change along it: by 20 m/s at most
over the oblate Earth. The Sun does not move.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.estimation.calibration import Calibration
from horizonval.estimation.miscalibrated import miscalibrated
from horizonval.estimation.prior import Prior
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, check_invertible
from horizonval.geometry.frames import compose
from horizonval.sensor.motion import GM_M3_PER_S2, rate_cam_rad_s
from horizonval.sensor.streams import stream
from horizonval.spec.prior import CalibrationSpec, PriorSpec

EARTH_RATE_RAD_S = 7.292115e-5
"""Of the Earth's rotation (IERS)."""


@dataclass(frozen=True)
class CalibrationErrors:
    """What is told of a camera and its time less what is true.

    Attributes
    ----------
    focal_length : float
        As a share of it.
    principal_point_px : tuple of 2 floats
    distortion_px : float
        Of the farthest corner.
    mounting_rad : tuple of 3 floats
        About the body's axes.
    exposure_offset_s, clock_s : float
    """

    focal_length: float = 0.0
    principal_point_px: tuple[float, float] = (0.0, 0.0)
    distortion_px: float = 0.0
    mounting_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exposure_offset_s: float = 0.0
    clock_s: float = 0.0

    def camera(self, camera: CameraModel) -> CameraModel:
        """Return a camera as it is told.

        Raises
        ------
        UserError
            One that folds inside the image, or has no distortion to be wrong.
        """
        believed = miscalibrated(camera, self.focal_length, self.principal_point_px, self.distortion_px)
        try:
            check_invertible(believed, where="calibration: distortion_error_px, distortion_sigma_px")
        except UserError as e:
            raise e.at("calibration: the camera as it is told") from e
        return believed

    def mounting(self, q_cam_from_body: Any) -> FloatArray:
        """Return a mounting as it is told, shape (4,); the mounting itself where it is right."""
        q = np.array(q_cam_from_body, dtype=np.float64)
        return compose(q, Rotation.from_rotvec(self.mounting_rad).as_quat()) if any(self.mounting_rad) else q


def calibration_of(truth: FrameTruth) -> CalibrationSpec:
    """Return the table ``[calibration]`` of a frame's scene."""
    return CalibrationSpec.model_validate(truth.scene.get("calibration") or {})


def errors_of(truth: FrameTruth) -> CalibrationErrors:
    """Return the errors of a frame, the same whenever they are asked for."""
    return drawn_errors(calibration_of(truth), truth.scene, truth.head)


def drawn_errors(spec: CalibrationSpec, scene: dict[str, Any], head: str | None) -> CalibrationErrors:
    """Return the errors that a table states and draws for a scene (plain data) and a head of its camera."""

    def normal(what: str, count: int, of_lens: bool) -> FloatArray:
        about = scene.get("scene", {})
        name = spec.draw or about.get("draw") or about.get("name")
        identity = json.dumps(["calibration", name, about.get("seed"), head if of_lens else None])
        return stream(hashlib.sha256(identity.encode()).hexdigest(), "", "", f"calibration {what}", 0).standard_normal(
            count
        )

    u, v = np.array(spec.principal_point_error_px) + spec.principal_point_sigma_px * normal("principal point", 2, True)
    mounting = np.radians(np.array(spec.mounting_error_deg) + spec.mounting_sigma_deg * normal("mounting", 3, True))
    return CalibrationErrors(
        focal_length=(
            spec.focal_length_error_percent
            + spec.focal_length_sigma_percent * float(normal("focal length", 1, True)[0])
        )
        / 100.0,
        principal_point_px=(float(u), float(v)),
        distortion_px=spec.distortion_error_px + spec.distortion_sigma_px * float(normal("distortion", 1, True)[0]),
        mounting_rad=(float(mounting[0]), float(mounting[1]), float(mounting[2])),
        exposure_offset_s=spec.exposure_offset_s
        + spec.exposure_offset_sigma_s * float(normal("exposure", 1, False)[0]),
        clock_s=spec.clock_error_s + spec.clock_sigma_s * float(normal("clock", 1, False)[0]),
    )


def stated_sigmas(spec: CalibrationSpec) -> Calibration | None:
    """Return what estimators are told of the calibration's errors; None where nothing is said of them."""
    x, y, z = (math.radians(sigma) for sigma in spec.mounting_sigma_deg)
    stated = Calibration(
        focal_length_sigma=spec.focal_length_sigma_percent / 100.0,
        principal_point_sigma_px=spec.principal_point_sigma_px,
        distortion_sigma_px=spec.distortion_sigma_px,
        mounting_sigma_rad=(x, y, z),
        exposure_offset_sigma_s=spec.exposure_offset_sigma_s,
        clock_sigma_s=spec.clock_sigma_s,
    )
    return None if stated == Calibration() else stated


def believed_prior(
    prior: Prior, stated: PriorSpec, truth: FrameTruth, errors: CalibrationErrors, sigmas: Calibration | None
) -> Prior:
    """Return a prior as a platform states it whose clock, exposure and mounting are off.

    Parameters
    ----------
    prior : Prior
        Of a platform whose camera and time are right.
    stated : PriorSpec
        What it was drawn by: values that stand in it stay.
    truth : FrameTruth
    errors : CalibrationErrors
    sigmas : Calibration, optional
    """
    changed: dict[str, Any] = {}
    sigmas = sigmas or Calibration()
    distance = float(np.linalg.norm(truth.r_itrs))
    orbital = math.sqrt(GM_M3_PER_S2 / distance**3)
    clocks = math.hypot(sigmas.clock_sigma_s, sigmas.exposure_offset_sigma_s)
    late = errors.clock_s - errors.exposure_offset_s
    if prior.r_itrs is not None and prior.position_sigma_m is not None:
        if stated.position_itrs_km is None and late != 0.0:
            changed["r_itrs"] = along_orbit(truth, late) @ prior.r_itrs
        changed["position_sigma_m"] = math.hypot(prior.position_sigma_m, orbital * distance * clocks)
    if prior.q_cam_from_itrs is not None and prior.attitude_sigma_rad is not None:
        if stated.q_cam_from_itrs is None:
            changed["q_cam_from_itrs"] = _attitude(prior.q_cam_from_itrs, truth, errors)
        turning = float(np.linalg.norm(_inertial_rate_cam(truth))) * sigmas.exposure_offset_sigma_s
        changed["attitude_sigma_rad"] = np.sqrt(
            prior.attitude_sigma_rad**2 + np.square(sigmas.mounting_sigma_rad) + turning**2
        )
    if prior.epoch_utc is not None and stated.epoch_utc is None and late != 0.0:
        changed["epoch_utc"] = prior.epoch_utc + timedelta(seconds=late)
    return replace(prior, **changed) if changed else prior


def along_orbit(truth: FrameTruth, seconds: float) -> FloatArray:
    """Return the matrix (3, 3) from the place at the frame's instant to that of another, both Earth-fixed then."""
    orbital = math.sqrt(GM_M3_PER_S2 / float(np.linalg.norm(truth.r_itrs)) ** 3)
    on = Rotation.from_rotvec(orbital * seconds * _normal_itrs(truth)).as_matrix()
    return np.asarray(_earth_turned(seconds) @ on)


def _attitude(q_cam_from_itrs: FloatArray, truth: FrameTruth, errors: CalibrationErrors) -> FloatArray:
    """Return an attitude as it is told: by the wrong mounting, at the stamp, in axes of the wrong time."""
    believed = Rotation.from_quat(q_cam_from_itrs)
    if errors.exposure_offset_s != 0.0:
        # A camera that turns by w dt afterwards stood turned by it the other way before.
        believed = Rotation.from_rotvec(errors.exposure_offset_s * _inertial_rate_cam(truth)) * believed
    late = errors.clock_s - errors.exposure_offset_s
    if late != 0.0:
        believed = believed * Rotation.from_matrix(_earth_turned(late)).inv()
    if any(errors.mounting_rad):
        right = Rotation.from_quat(truth.q_cam_from_body)
        believed = Rotation.from_quat(errors.mounting(truth.q_cam_from_body)) * right.inv() * believed
    return believed.as_quat(canonical=True)


def _earth_turned(seconds: float) -> FloatArray:
    """Return the matrix (3, 3) from Earth-fixed axes to those of seconds later."""
    return np.asarray(Rotation.from_rotvec([0.0, 0.0, -EARTH_RATE_RAD_S * seconds]).as_matrix())


def _lvlh_from_itrs(truth: FrameTruth) -> Rotation:
    cam_from_lvlh = Rotation.from_quat(truth.q_cam_from_body) * Rotation.from_quat(truth.q_body_from_lvlh)
    return cam_from_lvlh.inv() * Rotation.from_quat(truth.q_cam_from_itrs)


def _normal_itrs(truth: FrameTruth) -> FloatArray:
    """Return the orbit's normal, which is against y of lvlh, shape (3,)."""
    return np.asarray(_lvlh_from_itrs(truth).inv().apply([0.0, -1.0, 0.0]))


def _inertial_rate_cam(truth: FrameTruth) -> FloatArray:
    """Return the camera's angular velocity among the stars in its own axes, shape (3,) [rad/s]."""
    orbital = math.sqrt(GM_M3_PER_S2 / float(np.linalg.norm(truth.r_itrs)) ** 3)
    normal = Rotation.from_quat(truth.q_cam_from_itrs).apply(_normal_itrs(truth))
    return np.asarray(rate_cam_rad_s(truth) + orbital * normal)
