"""Where a fit of the ellipsoid's limb starts and what it leans on, from a search, a position and a coarse attitude.

Points of the search for the limb give a position by Christian and Robinson's closed form in the axes of the attitude's
prior; the camera is turned by the shortest way that brings its direction to the prior's. What remains, yaw and
distance, is the prior's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.likelihood.air import knowledge_in_air, limb_height_prior
from horizonval.estimation.likelihood.closed_form import position_from_limb
from horizonval.estimation.likelihood.knowledge import LimbKnowledge, LimbPose, placed_knowledge, turned_to
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.picture import Picture
from horizonval.estimation.observation import Observation


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
    ellipsoid, mean, information = placed_knowledge(observation, *limb_height_prior(observation))
    try:
        seen = position_from_limb(found.los_cam, mean.cam_from_itrs, ellipsoid.raised(mean.height_m))
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e), found.uv)
    knowledge = knowledge_in_air(observation, ellipsoid, mean, information, of_height=True, placed=True)
    return EllipsoidStart(picture, turned_to(mean, seen), knowledge)
