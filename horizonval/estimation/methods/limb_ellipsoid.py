"""The limb of the Earth's ellipsoid by maximum likelihood of the pixels across it, position and coarse attitude known.

Where the satellite stands over the ellipsoid, and which way the camera is turned about the nadir to a degree or two,
says how the limb departs from a circle: by up to 400 arcsec in low orbit, which methods of a cone take for tilt. What a
prior knows is rows of the fit: position (3), attitude (3), height of the limb. It claims the geocentric nadir, as the
methods of a cone do, so that they can be compared; roll and pitch are against it.

It needs a position and an attitude, and refuses without: a sphere of the local radius would be another method, with
other errors (``limb-sphere``).

**Start.** Points of the search for the limb give a position by Christian and Robinson's closed form in the axes of the
attitude's prior; the camera is turned by the shortest way that brings its direction to the prior's. What remains, yaw
and distance, is the prior's.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.likelihood.air import knowledge_in_air, limb_height_prior
from horizonval.estimation.likelihood.claim import claim
from horizonval.estimation.likelihood.closed_form import position_from_limb
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.ellipsoid import WGS84, sphere


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image, a position and a coarse attitude."""
    prior = observation.prior
    if prior.r_itrs is None or prior.position_sigma_m is None:
        return Refusal(Outcome.BAD_INPUT, "limb-ellipsoid needs a prior of the position (position_itrs_km)")
    if prior.q_cam_from_itrs is None or prior.attitude_sigma_rad is None:
        return Refusal(Outcome.BAD_INPUT, "limb-ellipsoid needs a prior of the attitude (q_cam_from_itrs)")
    searched = find_limb_and_picture(observation.image, observation.camera, observation.full_scale)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    ellipsoid = sphere(prior.sphere_radius_m) if prior.shape == "sphere" else WGS84
    height, height_sigma = limb_height_prior(observation)
    coarse = Rotation.from_quat(prior.q_cam_from_itrs).as_matrix()
    try:
        seen = position_from_limb(found.los_cam, coarse, ellipsoid.raised(height))
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e), found.uv)
    start = LimbPose(_shortest_turn(coarse @ prior.r_itrs, coarse @ seen) @ coarse, prior.r_itrs, height)
    cam_from_body = Rotation.from_quat(observation.q_cam_from_body).as_matrix()
    information = np.zeros((7, 7))
    information[:3, :3] = cam_from_body @ np.diag(prior.attitude_sigma_rad**-2.0) @ cam_from_body.T
    information[3:6, 3:6] = np.eye(3) / prior.position_sigma_m**2
    information[6, 6] = height_sigma**-2
    mean = LimbPose(coarse, prior.r_itrs, height)
    knowledge = knowledge_in_air(observation, ellipsoid, mean, information, of_height=True, placed=True)
    return claim(picture, observation, start, knowledge)


def _shortest_turn(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of the shortest turn of one direction into another."""
    axis = np.cross(before, after)
    size = float(np.linalg.norm(axis))
    if size == 0.0:
        return np.eye(3)
    angle = np.arctan2(size, float(before @ after))
    return np.asarray(Rotation.from_rotvec(axis / size * angle).as_matrix())


ESTIMATOR = Estimator(
    name="limb-ellipsoid",
    title="Limb of the Earth's ellipsoid, maximum likelihood of the pixels, position known",
    run=run,
    estimates="geocentric",
)
