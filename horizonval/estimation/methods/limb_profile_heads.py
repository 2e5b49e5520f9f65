"""The whole profile of the limb in all heads of a housing at once: one pose, one air.

``limb-profile`` for several cameras, fitted together (:mod:`horizonval.estimation.likelihood.profile.heads`): a tilt
and the height of the limb, which one camera cannot distinguish, differ in another one at right angles. Each head is
fitted alone first; heads without a limb are left out, and one with a limb suffices. Requirements and refusals are those
of ``limb-profile``. With a linear array among the heads the method is ``limb-heads``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.claim import fit_of
from horizonval.estimation.fit.guard import pulled
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.likelihood.profile.fit import ProfileSearch, explained, uneven_lens
from horizonval.estimation.likelihood.profile.heads import ProfileHead, fit_profiles
from horizonval.estimation.likelihood.profile.knowledge import NoLimbError
from horizonval.estimation.likelihood.profile.known_profile import known_profile
from horizonval.estimation.methods import limb_heads
from horizonval.estimation.methods.limb_profile import LEAST_EXPLAINED, doubt_of
from horizonval.estimation.observation import Estimator, Fit, Observation

NAME = "limb-profile-heads"


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from images of all heads, a position, a coarse attitude, and a time."""
    if any(min(np.asarray(head.image).shape[:2]) == 1 for head in observation.heads.values()):
        return limb_heads.run(observation)
    if len(observation.heads) < limb_heads.FEWEST_HEADS:
        return Refusal(Outcome.BAD_INPUT, f"two heads or more are needed, the observation has {len(observation.heads)}")
    heads, dark = {}, []
    for name, one in observation.heads.items():
        head = _alone(one)
        if not isinstance(head, Refusal):
            heads[name] = head
        elif head.status is Outcome.BAD_INPUT:
            return head.of_head(name)
        else:
            dark.append(head.of_head(name))
    if not heads:
        return dark[0]
    first = next(iter(heads.values()))
    stated, turn = first.knowledge.mean, first.cam_from_body
    mean = LimbPose(turn.T @ stated.cam_from_itrs, stated.r_itrs, stated.height_m)
    information = first.knowledge.information.copy()
    information[:3, :3] = turn.T @ information[:3, :3] @ turn
    cam_from_body = Rotation.from_quat(observation.q_cam_from_body).as_matrix()
    try:
        fitted = fit_profiles(list(heads.values()), mean, information, cam_from_body)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the profile of the limb in {len(heads)} heads: {e}")
    if next(iter(observation.heads)) not in heads:
        # Points are drawn into the image of the first head, which has none.
        fitted = replace(fitted, uv=np.empty((0, 2)), residuals_rad=np.empty(0))
    doubt = doubt_of(fitted)
    if doubt is not None:
        return doubt
    to_camera = np.eye(7)
    to_camera[:3, :3] = cam_from_body
    known = to_camera @ information @ to_camera.T
    wrong = pulled(fitted.pose, fitted.covariance, mean.of_camera(cam_from_body), known, fitted.uv)
    if isinstance(wrong, Refusal):
        return wrong
    fitted = replace(fitted, covariance=fitted.covariance + wrong, relief_covariance=fitted.relief_covariance + wrong)
    return fit_of(fitted, observation, first.knowledge.ellipsoid)


def _alone(head: Observation) -> ProfileHead | Refusal:
    """Return a head whose profile was fitted by itself, or why it shows none."""
    known = known_profile(head, NAME)
    if isinstance(known, Refusal):
        return known
    image = known.picture.unclipped
    try:
        start = known.start(head.camera, known.tilt_sigma_rad)
        alone = ProfileSearch(image, head.camera, start, known.knowledge).run()
    except NoLimbError as e:
        return Refusal(Outcome.NO_LIMB, f"the profile of the limb: {e}")
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the profile of the limb: {e}")
    share = explained(alone.model, alone.look, alone.noise)
    if not share > LEAST_EXPLAINED:
        return Refusal(
            Outcome.NO_LIMB, f"the predicted limb explains {max(share, 0.0):.0%} of the pixels where it should be"
        )
    lens = uneven_lens(*alone.growth())
    if lens is not None:
        return Refusal(Outcome.AMBIGUOUS, lens)
    cam_from_body = Rotation.from_quat(head.q_cam_from_body).as_matrix()
    table = (head.band_kind, head.band_um, head.prior.climate)
    return ProfileHead(head.camera, cam_from_body, known.knowledge, table, image, alone)


ESTIMATOR = Estimator(
    name=NAME,
    title="Whole profiles of the limb in several heads at once, with one air",
    run=with_lens_error(run),
    estimates="geocentric",
    needs="heads",
    claim="likelihood",
)
