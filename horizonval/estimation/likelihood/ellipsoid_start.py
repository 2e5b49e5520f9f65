"""Where a fit of the ellipsoid's limb starts and what it leans on, from a search, a position and a coarse attitude.

Points of the search for the limb give a position by Christian and Robinson's closed form in the axes of the attitude's
prior; the camera is turned by the shortest way that brings its direction to the prior's. What remains, yaw and
distance, is the prior's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.estimation.likelihood.air import knowledge_in_air, limb_height_prior
from horizonval.estimation.likelihood.closed_form import position_from_limb
from horizonval.estimation.likelihood.knowledge import LimbKnowledge, LimbPose
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.observation import Observation
from horizonval.geometry.ellipsoid import WGS84, sphere


@dataclass(frozen=True)
class EllipsoidStart:
    """A picture with its limb found, a start within some pixels of it, and what is known."""

    picture: Picture
    pose: LimbPose
    knowledge: LimbKnowledge


def ellipsoid_start(observation: Observation, method: str) -> EllipsoidStart | Refusal:
    """Return the start of a fit, or why there is none; ``method`` is named in refusals.

    Parameters
    ----------
    observation : Observation
        With a position and an attitude in its prior.
    method : str
    """
    prior = observation.prior
    if prior.r_itrs is None or prior.position_sigma_m is None:
        return Refusal(Outcome.BAD_INPUT, f"{method} needs a prior of the position (position_itrs_km)")
    if prior.q_cam_from_itrs is None or prior.attitude_sigma_rad is None:
        return Refusal(Outcome.BAD_INPUT, f"{method} needs a prior of the attitude (q_cam_from_itrs)")
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
    return EllipsoidStart(picture, start, knowledge)


def _shortest_turn(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the matrix (3, 3) of the shortest turn of one direction into another."""
    axis = np.cross(before, after)
    size = float(np.linalg.norm(axis))
    if size == 0.0:
        return np.eye(3)
    angle = np.arctan2(size, float(before @ after))
    return np.asarray(Rotation.from_rotvec(axis / size * angle).as_matrix())
