"""The whole profile of the limb in all heads of a housing at once: one pose, one air.

``limb-profile`` for several cameras, fitted together: a tilt and the height of the limb, which one camera cannot
distinguish, differ in another one at right angles. The coefficient of a mode of the air is one random function on the
planet, so that the nodes of all heads together have one covariance; heads of other wavelengths have separate modes, and
the gain of the optics is separate for each head.

Each head is brought near its limb alone first. Heads without a limb are left out, and so are those whose limb is not as
the common fit predicts it; one head suffices.
Requirements and refusals are those of ``limb-profile``. With a linear array among the heads the method is
``limb-heads``.

**Neglected.** Correlation of the air between two bands: heads of other wavelengths together claim too small an error of
their common air. The heads of a camera file have the same bands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.bundle import ShotPrior
from horizonval.estimation.fit.claim import fit_of
from horizonval.estimation.fit.guard import agreeing, heads_refused
from horizonval.estimation.fit.known_profile import known_profile
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.profile import ProfileImage
from horizonval.estimation.fit.profile_fit import NEAR, ProfileFit, fit_profiles
from horizonval.estimation.fit.profile_pixels import NoLimbError
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.methods import limb_heads
from horizonval.estimation.methods.limb_profile import LEAST_EXPLAINED, doubt_of
from horizonval.estimation.observation import Estimator, Fit, Observation

NAME = "limb-profile-heads"


@dataclass(frozen=True)
class _Head:
    """A head whose limb was found: its image, the prior of the body's pose, and its own fit in body axes."""

    image: ProfileImage
    prior: ShotPrior
    alone: ProfileFit


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from images of all heads, a position, a coarse attitude, and a time."""
    if any(min(np.asarray(head.image).shape[:2]) == 1 for head in observation.heads.values()):
        return limb_heads.run(observation)
    if len(observation.heads) < 2:
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
    found = _together(heads, observation)
    if isinstance(found, Refusal):
        return found
    fitted, heads = found
    first = next(iter(heads.values()))
    agreed = agreeing(fitted, first.prior, plain=fitted.plain_covariance)
    if isinstance(agreed, Refusal):
        return agreed
    fitted = agreed.in_axes(Rotation.from_quat(observation.q_cam_from_body).as_matrix())
    if next(iter(observation.heads)) not in heads:
        # Points are drawn into the image of the first head, which has none.
        fitted = replace(fitted, uv=np.empty((0, 2)), residuals_rad=np.empty(0))
    doubt = doubt_of(fitted)
    return fit_of(fitted, observation, first.image.knowledge.ellipsoid) if doubt is None else doubt


def _together(heads: dict[str, _Head], observation: Observation) -> tuple[ProfileFit, dict[str, _Head]] | Refusal:
    """Return the fit of all heads whose limb is as the fit predicts it, and these heads."""
    for _ in range(2):
        first = next(iter(heads.values()))
        best = min((head.alone for head in heads.values()), key=lambda fit: float(np.trace(fit.covariance[:3, :3])))
        images = [head.image for head in heads.values()]
        try:
            fitted = fit_profiles(images, first.prior, best.pose)
        except np.linalg.LinAlgError as e:
            return Refusal(Outcome.NOT_CONVERGED, f"the profile of the limb in {len(heads)} heads: {e}")
        seen = {name: head.image.image for name, head in heads.items()}
        refused = heads_refused(seen, observation, fitted, first.image.knowledge.ellipsoid, in_air=True)
        if not refused:
            return fitted, heads
        heads = {name: head for name, head in heads.items() if name not in refused}
        if not heads:
            break
    return next(iter(refused.values()))


def _alone(head: Observation) -> _Head | Refusal:
    """Return a head that is near its limb, or why it shows none."""
    known = known_profile(head, NAME)
    if isinstance(known, Refusal):
        return known
    turn, stated = Rotation.from_quat(head.q_cam_from_body).as_matrix(), known.knowledge.mean
    information = known.knowledge.information.copy()
    information[:3, :3] = turn.T @ information[:3, :3] @ turn
    prior = ShotPrior(stated.of_camera(turn.T), information)
    table = (head.band_kind, head.band_um, head.prior.climate)
    image = ProfileImage(known.picture.unclipped, head.camera, known.knowledge, turn, table)
    try:
        start: LimbPose = known.start(head.camera, known.tilt_sigma_rad).of_camera(turn.T)
        alone = fit_profiles([image], prior, start, NEAR)
    except NoLimbError as e:
        return Refusal(Outcome.NO_LIMB, f"the profile of the limb: {e}")
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the profile of the limb: {e}")
    if not alone.explained > LEAST_EXPLAINED:
        share = max(alone.explained, 0.0)
        return Refusal(Outcome.NO_LIMB, f"the predicted limb explains {share:.0%} of the pixels where it should be")
    return _Head(image, prior, alone)


ESTIMATOR = Estimator(
    name=NAME,
    title="Whole profiles of the limb in several heads at once, with one air",
    run=with_lens_error(run),
    estimates="geocentric",
    needs="heads",
    claim="likelihood",
)
