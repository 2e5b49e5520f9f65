"""From stored images to what an estimator is given."""

from __future__ import annotations

import math

import numpy as np

from horizonval.estimators.observation import Estimator, Observation, OraclePose
from horizonval.frame import DetectorImage, Frame, FrameTruth
from horizonval.geometry.camera import camera_from_spec
from horizonval.spec.camera import CameraSpec

EARTH_RADIUS_M = Observation.earth_radius_m


def observation_of(source: DetectorImage | Frame, estimator: Estimator, *, band: str | None = None) -> Observation:
    """Return the observation of a detector image, or of one band of a frame (radiance, without a converter).

    The truth in the header gives the calibrated camera and its mounting, which a flight computer knows too; the pose
    itself is handed only to an estimator that is ideal by definition.
    """
    truth = source.truth
    spec = CameraSpec.model_validate(truth.camera)
    if isinstance(source, DetectorImage):
        grey, full_scale = source.dn.astype(np.float64), float(source.full_scale)
    else:
        grey, full_scale = source.radiance[band or next(iter(source.radiance))].astype(np.float64), None
    prior = spec.platform.altitude_km
    return Observation(
        image=grey,
        camera=camera_from_spec(spec.camera),
        q_cam_from_body=np.array(truth.q_cam_from_body),
        full_scale=full_scale,
        altitude_m=None if prior is None else prior * 1e3,
        earth_radius_m=method_radius_m(truth),
        oracle=oracle_pose(truth) if estimator.needs == "pose" else None,
    )


def method_radius_m(truth: FrameTruth) -> float:
    """Return the radius a spherical method assumes: the sphere's own, or the mean radius of the ellipsoid's Earth."""
    return truth.ellipsoid_a_m if truth.ellipsoid_a_m == truth.ellipsoid_b_m else EARTH_RADIUS_M


def oracle_pose(truth: FrameTruth) -> OraclePose:
    """Return the exact pose, with the radius of the sphere whose angular radius is the truth's."""
    r_itrs = np.array(truth.r_itrs)
    return OraclePose(
        r_itrs=r_itrs,
        q_cam_from_itrs=np.array(truth.q_cam_from_itrs),
        radius_m=float(np.linalg.norm(r_itrs)) * math.sin(truth.angular_radius_rad),
    )
