"""The limb in all heads of a housing at once: one pose, by maximum likelihood of the pixels across it.

Cameras or linear arrays, any number of them: each shows a piece of one limb, and their pixels are fitted together
(:mod:`horizonval.estimation.fit.limb`). Levels, noise and blur are each head's own; pose, height and softness of the
limb, and its relief, are common.

With a position and a coarse attitude in the prior the planet is the ellipsoid, as in ``limb-ellipsoid``; without, a
sphere whose flattening is a relief with a pole anywhere, as in ``limb-sphere``.

**Start.** Points of the limb: of an image those of the search for it, of a single row its crossing. In body axes all of
them lie on one cone.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.claim import fit_of
from horizonval.estimation.fit.edge_pixels import EdgeImage
from horizonval.estimation.fit.known import (
    LimbKnowledge,
    knowledge_in_air,
    limb_height_prior,
    placed_knowledge,
    position_from_limb,
    sphere_start,
    turned_to,
)
from horizonval.estimation.fit.limb import fit_limbs
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.limb.crossing import sub_pixel_crossing
from horizonval.estimation.limb.finder import find_limb_and_picture
from horizonval.estimation.limb.picture import wrong_size
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.camera import unproject


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from the images of all heads."""
    if len(observation.heads) < 2:
        return Refusal(Outcome.BAD_INPUT, f"two heads or more are needed, the observation has {len(observation.heads)}")
    heads, sights = [], []
    for name, one in observation.heads.items():
        seen = _seen(one)
        if isinstance(seen, Refusal):
            return seen.of_head(name)
        image, uv = seen
        cam_from_body = Rotation.from_quat(one.q_cam_from_body).as_matrix()
        heads.append(EdgeImage(image, one.camera, cam_from_body))
        # 60 points at most, so that heads count equally in the start.
        some = uv[np.linspace(0, len(uv) - 1, min(len(uv), 60)).round().astype(int)]
        sights.append(unproject(one.camera, some) @ cam_from_body)
    try:
        start, knowledge = _start(observation, np.concatenate(sights))
        found = fit_limbs(heads, start, knowledge)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, f"the likelihood of the limb in {len(heads)} heads: {e}")
    return fit_of(found, observation, knowledge.ellipsoid)


def _seen(head: Observation) -> tuple[FloatArray, FloatArray] | Refusal:
    """Return a head's grey levels and points of its limb, shape (n, 2)."""
    image = np.asarray(head.image, dtype=np.float64)
    if image.ndim == 2 and image.shape[0] == 1:
        if image.shape != (head.camera.height, head.camera.width):
            return wrong_size(image, head.camera)
        crossing = sub_pixel_crossing(image[0])
        if isinstance(crossing, Refusal):
            return crossing
        return image, np.array([[crossing.column, 0.0]])
    searched = find_limb_and_picture(head, coarse=True)
    if isinstance(searched, Refusal):
        return searched
    found, picture = searched
    return picture.unclipped, found.uv


def _start(observation: Observation, los_body: FloatArray) -> tuple[LimbPose, LimbKnowledge]:
    """Return where the search begins and what it leans on, both of the body."""
    prior = observation.prior
    given = prior.r_itrs, prior.position_sigma_m, prior.q_cam_from_itrs, prior.attitude_sigma_rad
    if any(one is None for one in given):
        return sphere_start(observation, los_body, in_body_axes=True)
    planet, mean, information = placed_knowledge(observation, *limb_height_prior(observation), in_body_axes=True)
    seen = position_from_limb(los_body, mean.cam_from_itrs, planet.raised(mean.height_m))
    return turned_to(mean, seen), knowledge_in_air(observation, planet, mean, information, in_body_axes=True)


ESTIMATOR = Estimator(
    name="limb-heads",
    title="Limb in several heads at once, maximum likelihood of the pixels",
    run=with_lens_error(run),
    estimates="geocentric",
    needs="heads",
    claim="likelihood",
)
