"""The limb of a sphere by maximum likelihood of the pixels across it.

A cone through the points of the search gives the start; then the pixels are fitted
(:mod:`horizonval.estimation.fit.limb`): two tilts, altitude, height of the limb, blur and softness, and levels by
sector (:func:`horizonval.estimation.fit.known.sphere_start`). The effect of the Earth's flattening, with poles
anywhere, is a relief of the fit and part of the claim.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.claim import claim
from horizonval.estimation.fit.guard import accepted
from horizonval.estimation.fit.known import sphere_start
from horizonval.estimation.limb.finder import altitude_in_air_m, find_limb_and_picture
from horizonval.estimation.observation import Estimator, Fit, Observation


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
