"""From stored images to the observations that estimators receive."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.spectral.bands import limits_um, width_um
from horizonval.estimation.observation import Estimator, Observation, OraclePose
from horizonval.estimation.prior import Prior
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.geometry.frames import inverse, rotate
from horizonval.sensor import knowledge
from horizonval.sensor.expected_image import radiance_per_dn, stated_lens
from horizonval.sensor.knowledge import believed_prior, calibration_of, errors_of, stated_sigmas
from horizonval.spec.camera import CameraSpec
from horizonval.spec.prior import PriorSpec


def observation_of(
    source: DetectorImage | RadianceFrame,
    estimator: Estimator,
    *,
    band: str | None = None,
    known: PriorSpec | Prior | None = None,
) -> Observation:
    """Return the observation of a detector image, or of one band of a frame (radiance, without a converter).

    The truth gives the calibrated camera and its mounting, with the errors of the scene's ``[calibration]``
    (:mod:`horizonval.sensor.knowledge`). The pose goes only to ideal estimators. The scene's ``[prior]``, or ``known``
    in its place, decides which other values are given; they are the same at every call.
    """
    truth = source.truth
    spec = truth.camera_spec
    name = band_of(source, band)
    seen = next((one for one in spec.band if one.name == name), None)
    errors, sigmas = errors_of(truth), stated_sigmas(calibration_of(truth))
    prior = known_of(truth, name, known)
    sun = coarse_sun_cam(truth)
    if prior.sun_sigma_rad is not None:
        sun = knowledge.sun_reading_cam(prior.sun_sigma_rad, truth)
    mounting = errors.mounting(truth.q_cam_from_body)
    if isinstance(source, DetectorImage):
        grey, full_scale = source.dn.astype(np.float64), float(source.full_scale)
    else:
        grey, full_scale = source.radiance[name].astype(np.float64), None
    return Observation(
        image=grey,
        camera=errors.camera(truth.camera_model),
        q_cam_from_body=mounting,
        full_scale=full_scale,
        prior=with_altitude_of(spec, prior),
        band_kind=None if seen is None else seen.kind,
        band_um=None if seen is None else limits_um(seen),
        band_width_um=None if seen is None else width_um(seen),
        lens=stated_lens(spec, seen) if isinstance(source, DetectorImage) else None,
        radiance_per_dn=radiance_per_dn(source) if isinstance(source, DetectorImage) else None,
        # A Sun sensor is mounted on the body; the assumed mounting converts its reading to camera axes.
        sun_cam=sun if sun is None or not any(errors.mounting_rad) else _by_mounting(sun, truth, mounting),
        calibration=sigmas,
        oracle=oracle_pose(truth) if estimator.needs == "pose" else None,
    )


def band_of(source: DetectorImage | RadianceFrame, band: str | None = None) -> str:
    """Return the band of an image, or the given or first band of a frame."""
    return source.band if isinstance(source, DetectorImage) else band or next(iter(source.radiance))


def observation_of_heads(
    sources: Mapping[str, DetectorImage | RadianceFrame], estimator: Estimator, known: PriorSpec | Prior | None = None
) -> Observation:
    """Return the observation of all heads of one housing at one instant.

    ``sources``: by head, in the camera file's order; at least one. ``known``: replaces the scene's prior. The result is
    the first head's observation, with every head's in ``heads``. Raises ``UserError``: one attitude for several heads.
    """
    if known is not None and len(sources) > 1 and known.q_cam_from_itrs is not None:
        raise UserError(
            f"one attitude for {len(sources)} heads",
            where="prior: q_cam_from_itrs",
            expected="attitude_sigma_deg alone",
        )
    heads = {name: observation_of(source, estimator, known=known) for name, source in sources.items()}
    return replace(next(iter(heads.values())), heads=heads)


def coarse_sun_cam(truth: FrameTruth) -> FloatArray | None:
    """Return the Sun's two angles in whole degrees, as a coarse Sun sensor reads them; None without the Sun."""
    if truth.sun_visible_fraction <= 0.0:
        return None
    x, y, z = truth.sun_cam
    off_axis, around = round(math.degrees(math.atan2(math.hypot(x, y), z))), round(math.degrees(math.atan2(y, x)))
    sine, turn = math.sin(math.radians(off_axis)), math.radians(around)
    return np.array([sine * math.cos(turn), sine * math.sin(turn), math.cos(math.radians(off_axis))])


def method_radius_m(truth: FrameTruth) -> float:
    """Return the default radius of a spherical method for a frame."""
    return knowledge.method_radius_m(scene_prior(truth), truth)


def scene_prior(truth: FrameTruth) -> PriorSpec:
    """Return the table ``[prior]`` of a frame's scene, the same for every camera."""
    return PriorSpec.model_validate(truth.scene.get("prior") or {})


def known_of(truth: FrameTruth, band: str, known: PriorSpec | Prior | None = None) -> Prior:
    """Return the prior of a frame: ``known``, or else the scene's."""
    if isinstance(known, Prior):
        return known
    spec = scene_prior(truth) if known is None else known
    drawn = knowledge.drawn_prior(spec, truth, band)
    calibration = calibration_of(truth)
    return believed_prior(drawn, spec, truth, errors_of(truth), stated_sigmas(calibration))


def _by_mounting(direction_cam: FloatArray, truth: FrameTruth, mounting: FloatArray) -> FloatArray:
    """Return a body direction in camera axes by the assumed mounting."""
    return rotate(mounting, rotate(inverse(truth.q_cam_from_body), direction_cam))


def with_altitude_of(camera: CameraSpec, prior: Prior) -> Prior:
    """Return a prior with the altitude of the camera file where it has none."""
    known = camera.platform
    if known.altitude_km is None or known.altitude_sigma_km is None or prior.altitude_m is not None:
        return prior
    return replace(prior, altitude_m=1e3 * known.altitude_km, altitude_sigma_m=1e3 * known.altitude_sigma_km)


def oracle_pose(truth: FrameTruth) -> OraclePose:
    """Return the exact pose, with the radius of the sphere that has the truth's angular radius."""
    r_itrs = np.array(truth.r_itrs)
    return OraclePose(
        r_itrs=r_itrs,
        q_cam_from_itrs=np.array(truth.q_cam_from_itrs),
        radius_m=float(np.linalg.norm(r_itrs)) * math.sin(truth.angular_radius_rad),
    )
