"""What the platform knows of a frame and its camera: the tables ``[prior]`` and ``[calibration]`` of the scene.

Values that a table states are used as they are. A sigma alone means that the value is the truth with an error drawn
from it. Every quantity has a separate random stream, seeded with the table's or the scene's ``draw`` or name, the
scene's seed and, for properties of a lens, the head. Another key, camera or head therefore changes no other error, an
error is proportional to its sigma, and all draws of the noise share one error. Samples of an orbit are drawn one by
one: no filter is simulated.

**Prior.** With unit normals ``n``:

- position: ``r + sigma n``; altitude: ``h + sigma n``, drawn again where it is not above 0;
- attitude: ``q_body_from_itrs = exp(sigma n) q``, a turn about the body's axes;
- Sun: ``s + sigma n`` across the true direction ``s``, in body axes, brought to length 1;
- height of the limb: about the mean height of half the plateau, of a thermal band.

**Calibration.** An error is the given value minus the true one: the stated error plus a drawn one.

- the camera: :mod:`horizonval.estimation.lens_error`;
- the mounting ``M``: ``q_cam_from_body`` is given as ``M exp([e x])``, so that roll and pitch of a level body come out
  larger by ``e_x`` and ``e_y``;
- the clock, ahead by ``e``: inertial axes stay right, since stars need no clock. With ``n = sqrt(GM / r^3)`` about the
  orbit's normal ``h`` and the Earth's rotation ``w`` the position is given as ``R_z(-w e) exp(n e [h x]) r``;
- the exposure, later than its stamp by ``e``: position and attitude are those of ``e`` before the frame's instant.

What is measured on the body (attitude, the Sun) is turned to camera axes by the given mounting. Sigmas of clock, offset
and mounting are added in squares to those of position and attitude, along all three axes.

**Neglected.** The orbit is a circle at the frame's height. A drawn altitude does not change along it (20 m/s at most
over the oblate Earth). The Sun does not move.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, nearest
from horizonval.earth.atmosphere import profiles
from horizonval.earth.weather import real_states
from horizonval.earth.weather.real_states import PREFIX
from horizonval.estimation.lens_error import miscalibrated
from horizonval.estimation.observation import Calibration
from horizonval.estimation.prior import BY_LATITUDE_MONTH, FILE_KEYS, MEAN_RADIUS_M, Prior
from horizonval.frame import FrameTruth
from horizonval.geometry import clock
from horizonval.geometry.camera import CameraModel, check_invertible
from horizonval.geometry.ellipsoid import WGS84, geodetic_height
from horizonval.geometry.frames import compose, inverse, rotate
from horizonval.sensor.motion import GM_M3_PER_S2, rate_cam_rad_s
from horizonval.sensor.streams import stream
from horizonval.spec.camera import CameraGeometry, CameraUncertainty
from horizonval.spec.prior import PAIRS, CalibrationSpec, PriorSpec, is_climate_file


def stated_prior(spec: PriorSpec, where: str = "prior") -> Prior:
    """Return the prior that a table states by itself, for a picture without truth.

    UserError: a sigma without its value, or a climate by place without a time.
    """
    for value, sigma in PAIRS.items():
        if value == "q_cam_from_itrs" and spec.nadir_cam is not None:
            continue
        if getattr(spec, sigma) is not None and getattr(spec, value) is None:
            raise UserError(
                f"{sigma} without {value}",
                where=where,
                expected="both: this picture carries no truth that a value could be drawn from",
            )
    if spec.sun_sigma_deg is not None:
        raise UserError("sun_sigma_deg", where=where, expected="no such key: no Sun sensor goes with this picture")
    if spec.climate == BY_LATITUDE_MONTH and spec.epoch_utc is None:
        raise UserError(f"climate = {spec.climate!r} without epoch_utc", where=where, expected="the month's date")
    return Prior(**_stated(spec))


def drawn_prior(spec: PriorSpec, truth: FrameTruth, band: str | None = None) -> Prior:
    """Return what is known of a frame: stated values, and drawn ones where a sigma stands alone.

    ``band`` is the one whose limb ``limb_height_sigma_km`` is about. UserError: a limb height is to be drawn for a band
    without one in the truth, or the climate is unknown.
    """
    refuse_unknown_climate(spec)
    known = _stated(spec)
    known.setdefault("shape", "sphere" if truth.ellipsoid.is_sphere else "wgs84")
    if spec.shape is None and truth.ellipsoid.is_sphere:
        known["radius_m"] = truth.ellipsoid.a_m
    r = np.array(truth.r_itrs)
    if spec.altitude_sigma_km is not None and spec.altitude_km is None:
        true = _altitude_m(known, r)
        random, altitude = _stream(truth, "altitude"), 0.0
        while altitude <= 0.0:
            altitude = true + known["altitude_sigma_m"] * random.standard_normal()
        known["altitude_m"] = altitude
    if spec.position_sigma_km is not None and spec.position_itrs_km is None:
        known["r_itrs"] = r + known["position_sigma_m"] * _stream(truth, "position").standard_normal(3)
    if spec.attitude_sigma_deg is not None and spec.q_cam_from_itrs is None and spec.nadir_cam is None:
        turn = Rotation.from_rotvec(known["attitude_sigma_rad"] * _stream(truth, "attitude").standard_normal(3))
        mount = np.array(truth.q_cam_from_body)
        known["q_cam_from_itrs"] = compose(mount, turn.as_quat(), inverse(mount), np.array(truth.q_cam_from_itrs))
    if spec.position_sigma_km is not None or spec.attitude_sigma_deg is not None:
        # A position on the turning Earth needs a time.
        known.setdefault("epoch_utc", datetime.fromisoformat(truth.epoch_utc))
    if spec.limb_height_sigma_km is not None and spec.limb_height_km is None:
        error = known["limb_height_sigma_m"] * _stream(truth, f"limb height {band}").standard_normal()
        known["limb_height_m"] = _limb_height_m(truth, band) + error
    return Prior(**known)


def sun_reading_cam(sigma_rad: float, truth: FrameTruth) -> FloatArray | None:
    """Return what a Sun sensor of this error reads, in camera axes; None where it does not see the Sun."""
    if truth.sun_visible_fraction <= 0.0:
        return None
    mount = np.array(truth.q_cam_from_body)
    # One sensor on the body: all heads have the same reading.
    sun = rotate(inverse(mount), np.array(truth.sun_cam))
    error = sigma_rad * _stream(truth, "sun").standard_normal(3)
    read = sun + error - sun * (sun @ error)
    return rotate(mount, read / np.linalg.norm(read))


def method_radius_m(spec: PriorSpec, truth: FrameTruth) -> float:
    """Return the radius that a spherical method is given."""
    if spec.shape is not None:
        return MEAN_RADIUS_M if spec.radius_km is None else 1e3 * spec.radius_km
    return truth.ellipsoid_a_m if truth.ellipsoid.is_sphere else MEAN_RADIUS_M


def refuse_unknown_climate(spec: PriorSpec) -> None:
    """Raise a ``UserError`` where a climate is neither a name nor a file."""
    if spec.climate is None:
        return
    names = (BY_LATITUDE_MONTH, *profiles.names(), "none", *(f"{PREFIX}{name}" for name in real_states.names()))
    if spec.climate in names or is_climate_file(spec.climate):
        return
    near = ", ".join(nearest(spec.climate, names)[:12])
    raise UserError(
        f"found {spec.climate!r}",
        where="prior.climate",
        expected=f"a profile file (.csv, .json), a table (.npz) or one of {near}",
    )


def _stated(spec: PriorSpec) -> dict[str, Any]:
    """Return all that is in a table in SI units; without what it leaves out."""
    known: dict[str, Any] = {}
    for key, name, factor in FILE_KEYS:
        value = getattr(spec, key)
        if value is not None:
            known[name] = value if factor is None else factor * np.asarray(value, dtype=np.float64)
    return {name: float(v) if isinstance(v, np.ndarray) and v.ndim == 0 else v for name, v in known.items()}


def _altitude_m(known: dict[str, Any], r_itrs: FloatArray) -> float:
    if known["shape"] == "sphere":
        return float(np.linalg.norm(r_itrs)) - float(known.get("radius_m", MEAN_RADIUS_M))
    return float(geodetic_height(r_itrs, WGS84))


def _limb_height_m(truth: FrameTruth, band: str | None) -> float:
    heights = truth.infrared_horizon.get(band, {}).get("half_plateau_height_m") if band is not None else None
    if not heights or not np.isfinite(heights).any():
        raise UserError(
            f"limb_height_sigma_km alone, but the truth has no limb height of the band {band!r}",
            where="prior",
            expected="limb_height_km beside it",
        )
    return float(np.nanmean(heights))


def _stream(truth: FrameTruth, what: str) -> np.random.Generator:
    scene = truth.scene.get("scene", {})
    identity = json.dumps(["prior", scene.get("draw") or scene.get("name"), scene.get("seed")])
    return stream(hashlib.sha256(identity.encode()).hexdigest(), "", "", f"prior {what}", 0)


EARTH_RATE_RAD_S = 7.292115e-5
"""Rate of the Earth's rotation (IERS)."""


@dataclass(frozen=True)
class CalibrationErrors:
    """Given minus true values of a camera and its time.

    ``focal_length`` is relative, ``distortion_px`` at the farthest corner, ``mounting_rad`` about the body's axes.
    """

    focal_length: float = 0.0
    principal_point_px: tuple[float, float] = (0.0, 0.0)
    distortion_px: float = 0.0
    mounting_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    exposure_offset_s: float = 0.0
    clock_s: float = 0.0

    def camera(self, camera: CameraModel) -> CameraModel:
        """Return a camera as it is given; UserError where it folds inside the image or has no distortion."""
        believed = miscalibrated(camera, self.focal_length, self.principal_point_px, self.distortion_px)
        try:
            check_invertible(believed, where="calibration: distortion_error_px, distortion_sigma_px")
        except UserError as e:
            raise e.at("calibration: the camera as it is told") from e
        return believed

    def mounting(self, q_cam_from_body: Any) -> FloatArray:
        """Return a mounting as it is given, shape (4,); the mounting itself where it is right."""
        q = np.array(q_cam_from_body, dtype=np.float64)
        return compose(q, Rotation.from_rotvec(self.mounting_rad).as_quat()) if any(self.mounting_rad) else q


def calibration_of(truth: FrameTruth) -> CalibrationSpec:
    """Return the table ``[calibration]`` of a frame's scene, its missing sigmas those of the camera's file."""
    spec = CalibrationSpec.model_validate(truth.scene.get("calibration") or {})
    camera = truth.camera_spec.camera
    if camera.uncertainty is None:
        return spec
    stated = _camera_sigmas(camera)
    return spec.model_copy(update={key: value for key, value in stated.items() if not getattr(spec, key)})


def calibration_of_camera(camera: CameraGeometry) -> Calibration | None:
    """Return how well a camera's calibration is known; by default values where its file states none."""
    return stated_sigmas(CalibrationSpec.model_validate(_camera_sigmas(camera)))


def _camera_sigmas(camera: CameraGeometry) -> dict[str, float]:
    """Return the sigmas of a camera's calibration by their keys in ``[calibration]``."""
    sigmas: dict[str, float] = (camera.uncertainty or CameraUncertainty()).model_dump()
    if camera.projection == "equal_angle":
        sigmas["distortion_sigma_px"] = 0.0
    return sigmas


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
    """Return the sigmas of the calibration's errors that estimators are given; None where none is stated."""
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
    """Return a prior that was drawn for a right camera and clock, changed by errors of clock, exposure and mounting.

    Values that ``stated``, the table it was drawn by, holds stay.
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
        changed["epoch_utc"] = clock.utc_after(prior.epoch_utc, late)
    return replace(prior, **changed) if changed else prior


def along_orbit(truth: FrameTruth, seconds: float) -> FloatArray:
    """Return the matrix (3, 3) from the place at the frame's instant to that of another, both Earth-fixed then."""
    orbital = math.sqrt(GM_M3_PER_S2 / float(np.linalg.norm(truth.r_itrs)) ** 3)
    on = Rotation.from_rotvec(orbital * seconds * _normal_itrs(truth)).as_matrix()
    return np.asarray(_earth_turned(seconds) @ on)


def _attitude(q_cam_from_itrs: FloatArray, truth: FrameTruth, errors: CalibrationErrors) -> FloatArray:
    """Return an attitude as it is given: by the wrong mounting, at the stamp, in axes of the wrong time."""
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
