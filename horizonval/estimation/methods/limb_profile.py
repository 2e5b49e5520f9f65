"""The whole profile of the limb by maximum likelihood, against rendered profiles of the air of the place and month.

``limb-ellipsoid`` fits an edge of one shape at an unknown height. Here the brightness over height is that of tables
made with the renderer: the mean of air, haze, cloud and ground at a latitude and in a month (or under a Sun), and its
modes. Their coefficients are unknowns that vary along the limb, each with a prior, so that brightness and softness
determine the height, and the claim includes the uncertainty of the air.

The method refuses without a position, an attitude to some degrees, a time and the wavelengths of the camera. Stated
blur over the field and diffraction of the lens are in the prediction. Tables are the shipped ones, or the file of
`horizonval templates` that the prior's ``climate`` names. The start is the tilt near the prior's attitude whose
prediction fits the image best.

Azimuths with light outside the limb that is no air's are left out (:mod:`..limb.foreign`).

It also refuses an image that no tilt predicts, or of which the fit explains less than :data:`LEAST_EXPLAINED`; an air
more than :data:`MOST_IMPROBABLE` from its tables; and what the guard of all fits refuses
(:mod:`horizonval.estimation.fit.guard`).
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.bundle import ShotPrior
from horizonval.estimation.fit.claim import fit_of
from horizonval.estimation.fit.guard import accepted, agreeing, guarded_fit
from horizonval.estimation.fit.known_profile import known_profile
from horizonval.estimation.fit.profile import ProfileImage
from horizonval.estimation.fit.profile_fit import ProfileFit, fit_profiles
from horizonval.estimation.fit.profile_pixels import NoLimbError
from horizonval.estimation.lens_error import lens_sigmas
from horizonval.estimation.limb.foreign import without_foreign_light
from horizonval.estimation.observation import Estimator, Fit, Observation

LEAST_EXPLAINED = 0.95
"""Smallest explained share of the pixels' variance: broken clouds leave 1 to 3 %, noise explains nothing."""
MOST_IMPROBABLE = 6.0
"""Largest mode coefficient in standard deviations; air is not normal (sudden warmings), and clear frames reach 3."""


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image, a position, a coarse attitude, and a time."""
    known = known_profile(observation, "limb-profile")
    if isinstance(known, Refusal):
        return known
    knowledge = known.knowledge
    try:
        start = known.start(observation.camera, known.tilt_sigma_rad)
        image = without_foreign_light(known.picture.unclipped, observation.camera, *known.limb(start))
        sigmas = lens_sigmas(observation.calibration)

        def fit(image: FloatArray) -> ProfileFit:
            seen = ProfileImage(image, observation.camera, knowledge)
            return fit_profiles([seen], ShotPrior(knowledge.mean, knowledge.information), start, lens_sigmas=sigmas)

        found = guarded_fit(fit, image, observation, knowledge.ellipsoid, in_air=True)
    except NoLimbError as e:
        return Refusal(Outcome.NO_LIMB, f"the profile of the limb: {e}")
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the profile of the limb: {e}")
    if isinstance(found, Refusal):
        return found
    doubt = doubt_of(found)
    if doubt is not None:
        return doubt
    found = agreeing(found, knowledge, plain=found.plain_covariance)
    if isinstance(found, Refusal):
        return found
    return accepted(fit_of(found, observation, knowledge.ellipsoid), observation.prior.accept_rad)


def doubt_of(found: ProfileFit) -> Refusal | None:
    """Return why a fit in the axes of the prior's camera is not believed, if it is not."""
    if not found.explained > LEAST_EXPLAINED:
        reason = f"the predicted limb explains {max(found.explained, 0.0):.0%} of the pixels where it should be"
        return Refusal(Outcome.NO_LIMB, reason, found.uv)
    if found.improbable > MOST_IMPROBABLE:
        reason = f"the air would have to be {found.improbable:.1f} standard deviations from what its tables know"
        return Refusal(Outcome.AMBIGUOUS, reason, found.uv)
    return None


ESTIMATOR = Estimator(
    name="limb-profile",
    title="Whole profile of the limb, maximum likelihood with rendered profiles of the air",
    run=run,
    estimates="geocentric",
    claim="likelihood",
)
