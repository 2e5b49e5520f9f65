"""From stored images to what an estimator is given."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.observation import Estimator, Observation, OraclePose
from horizonval.estimation.prior import Prior
from horizonval.frame import DetectorImage, FrameTruth, RadianceFrame
from horizonval.spec.sensor.camera import CameraSpec


def observation_of(
    source: DetectorImage | RadianceFrame, estimator: Estimator, *, band: str | None = None
) -> Observation:
    """Return the observation of a detector image, or of one band of a frame (radiance, without a converter).

    The truth in the header gives the calibrated camera and its mounting, which a flight computer knows too; the pose
    itself is handed only to an estimator that is ideal by definition.
    """
    truth = source.truth
    spec = truth.camera_spec
    name = source.band if isinstance(source, DetectorImage) else band or next(iter(source.radiance))
    if isinstance(source, DetectorImage):
        grey, full_scale = source.dn.astype(np.float64), float(source.full_scale)
    else:
        grey, full_scale = source.radiance[name].astype(np.float64), None
    return Observation(
        image=grey,
        camera=truth.camera_model,
        q_cam_from_body=np.array(truth.q_cam_from_body),
        full_scale=full_scale,
        prior=prior_of(truth),
        band_kind=next((one.kind for one in spec.band if one.name == name), None),
        sun_cam=coarse_sun_cam(truth),
        oracle=oracle_pose(truth) if estimator.needs == "pose" else None,
    )


def observation_of_heads(sources: Mapping[str, DetectorImage | RadianceFrame], estimator: Estimator) -> Observation:
    """Return the observation of all heads of one housing at one instant.

    Parameters
    ----------
    sources : mapping of str to DetectorImage or RadianceFrame
        By the heads' names, in the camera file's order; at least one.
    estimator : Estimator

    Returns
    -------
    Observation
        That of the first head, with every head's own in ``heads``.
    """
    heads = {name: observation_of(source, estimator) for name, source in sources.items()}
    return replace(next(iter(heads.values())), heads=heads)


def coarse_sun_cam(truth: FrameTruth) -> FloatArray | None:
    """Return what a coarse Sun sensor reads: the Sun's two angles in whole degrees; None where the Sun is not seen."""
    if truth.sun_visible_fraction <= 0.0:
        return None
    x, y, z = truth.sun_cam
    off_axis, around = round(math.degrees(math.atan2(math.hypot(x, y), z))), round(math.degrees(math.atan2(y, x)))
    sine, turn = math.sin(math.radians(off_axis)), math.radians(around)
    return np.array([sine * math.cos(turn), sine * math.sin(turn), math.cos(math.radians(off_axis))])


def method_radius_m(truth: FrameTruth) -> float:
    """Return the radius that a spherical method is given."""
    return prior_of(truth).sphere_radius_m


def prior_of(truth: FrameTruth) -> Prior:
    """Return what is known of a frame beside the image: the planet's shape, and what the camera file says."""
    return with_altitude_of(truth.camera_spec, prior_of_scene(truth))


def prior_of_scene(truth: FrameTruth) -> Prior:
    """Return what is known whatever camera looks."""
    planet = truth.ellipsoid
    return Prior(shape="sphere", radius_m=planet.a_m) if planet.is_sphere else Prior(shape="wgs84")


def with_altitude_of(camera: CameraSpec, prior: Prior) -> Prior:
    """Return a prior with the altitude of the camera file, if it has none of its own and the file has one."""
    known = camera.platform
    if known.altitude_km is None or known.altitude_sigma_km is None or prior.altitude_m is not None:
        return prior
    return replace(prior, altitude_m=1e3 * known.altitude_km, altitude_sigma_m=1e3 * known.altitude_sigma_km)


def oracle_pose(truth: FrameTruth) -> OraclePose:
    """Return the exact pose, with the radius of the sphere whose angular radius is the truth's."""
    r_itrs = np.array(truth.r_itrs)
    return OraclePose(
        r_itrs=r_itrs,
        q_cam_from_itrs=np.array(truth.q_cam_from_itrs),
        radius_m=float(np.linalg.norm(r_itrs)) * math.sin(truth.angular_radius_rad),
    )
