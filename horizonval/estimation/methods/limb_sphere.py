"""The limb of a sphere by maximum likelihood of the pixels across it.

A cone through the points of the search gives the start; then the pixels are fitted
(:mod:`horizonval.estimation.fit.limb`): two tilts, altitude, height of the limb, blur and softness, and levels by
sector. Altitude and height change a sphere's limb equally, and only priors distinguish them: without a prior of the
altitude the limb is taken for the sphere, as in the methods of a cone. The effect of the Earth's flattening, with poles
anywhere, is a relief of the fit and part of the claim. A rough direction of the nadir is a prior of the tilts.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.claim import claim
from horizonval.estimation.fit.guard import accepted
from horizonval.estimation.fit.known import (
    LOCAL_RADIUS_SHARE,
    LimbKnowledge,
    knowledge_in_air,
    limb_height_prior,
    position_from_limb,
    sphere_knowledge,
    tilted_to,
)
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.limb.finder import altitude_in_air_m, find_limb_and_picture
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.ellipsoid import sphere


def sphere_start(
    observation: Observation, los: FloatArray, *, in_body_axes: bool = False
) -> tuple[LimbPose, LimbKnowledge]:
    """Return where the fit of a sphere starts, and what is known, in the axes of the lines of sight ``los`` (n, 3).

    Raises ``LinAlgError``: they are of no planet's limb.
    """
    prior = observation.prior
    radius, flattened = prior.sphere_radius_m, prior.flattening * prior.sphere_radius_m
    known = prior.altitude_m is not None and prior.altitude_sigma_m is not None
    height, height_sigma = limb_height_prior(observation) if known else (0.0, 0.0)
    r = position_from_limb(los, np.eye(3), sphere(radius + height))
    altitude, sigma = float(np.linalg.norm(r)) - radius, np.inf
    if prior.altitude_m is not None and prior.altitude_sigma_m is not None:
        altitude, sigma = prior.altitude_m, float(np.hypot(prior.altitude_sigma_m, LOCAL_RADIUS_SHARE * flattened))
    planet, mean, information = sphere_knowledge(-r / np.linalg.norm(r), radius, altitude, sigma, height, height_sigma)
    if prior.nadir_cam is not None and prior.rough_nadir is not None and not in_body_axes:
        mean, information = tilted_to(mean, information, *prior.rough_nadir)
    of_height = known and not in_body_axes
    knowledge = knowledge_in_air(
        observation, planet, mean, information, flattened, of_height=of_height, in_body_axes=in_body_axes
    )
    return LimbPose(np.eye(3), r, height), knowledge


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image."""
    searched = find_limb_and_picture(observation, coarse=True)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    try:
        start, knowledge = sphere_start(observation, found.los_cam)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e), found.uv)
    prior = observation.prior
    fit = claim(picture, observation, start, knowledge)
    # To a camera within the air the limb may be at any height below its own: a degree is accepted by default.
    share = 1.0 if altitude_in_air_m(prior) is None else 5.0
    return accepted(fit, share * prior.accept_rad)


ESTIMATOR = Estimator(
    name="limb-sphere",
    title="Limb of a sphere, maximum likelihood of the pixels",
    run=run,
    estimates="geocentric",
    claim="likelihood",
)
