"""The fit of a limb's edge to the pixels of one image or of several heads.

One shot of images (:mod:`.bundle`) with edge models (:mod:`.edge`), solved by the solver of all fits. Levels, noise
and blur are each image's own; pose, height and softness of the limb, and its relief, are common.

Uneven ground, clouds and coasts move the limb of some sectors more than noise and relief do. The scatter of the
sectors' positions gives chi-squared per degree of freedom; where chance does not explain it the covariance is
multiplied by it (Birge's ratio, Phys. Rev. 40, 207, 1932).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.bundle import SHARED, Bundle, Shot, ShotPrior
from horizonval.estimation.fit.edge import LOWEST, EdgeLook, EdgeModel, sector_places
from horizonval.estimation.fit.edge_pixels import EdgeChooser, EdgeImage
from horizonval.estimation.fit.image import LENS, POSE
from horizonval.estimation.fit.known import LimbKnowledge
from horizonval.estimation.fit.light import PIXEL_VARIANCE, LightNoise
from horizonval.estimation.fit.pose import LimbPose, nadir_derivative
from horizonval.estimation.fit.solver import SolverOptions, Stage, solve
from horizonval.geometry.camera import CameraModel

FITTED = 3
"""Degrees of freedom constrained by the sector residuals: two tilts and a size."""
OPTIONS = SolverOptions(
    stages=(Stage(tighter=900.0, tolerance=1.0, reselect_px=3.0), Stage(tolerance=0.1, reselect_px=1.0)),
    most_steps=60,
    frozen=0.1,
)
"""First blur and scale height are held to a thirtieth of their priors' standard deviations: a limb out of its place
looks soft. The last stage chooses the pixels about a limb that is right to a standard deviation, so that the answer
depends little on the start. Equations of the edge cost little more than a look at it: derivatives are frozen at the end
only. Blur and scale height, where they are hard to tell apart, take many steps."""


@dataclass(frozen=True)
class LimbFit:
    """The most probable pose, in the axes of the first image's camera.

    ``covariance`` (7, 7): of turn in camera axes [rad], position [m], limb height [m], from noise, priors, relief and
    excess scatter of the sectors and errors of the lens; ``relief_covariance``: its part of relief, scatter and lens.
    ``blur_px``, ``scale_height_m``: of the lens and the limb in the first image. ``noise_sigma``: pixel noise in space
    and on the Earth, in grey levels. ``uv`` (m, 2): a point on each sector's limb in the first image [px];
    ``residuals_rad`` (m,): how far inside the fitted limb each sector shows it, including relief; ``levels`` (m,): the
    Earth's brightness there above space; ``scatter``: :func:`scatter` of the sectors; ``uneven_px``: by how much an
    unlit sliver may have the limb depart from a circle. ``steps``: shape (k, 7).
    """

    pose: LimbPose
    blur_px: float
    scale_height_m: float
    covariance: FloatArray
    relief_covariance: FloatArray
    noise_sigma: tuple[float, float]
    uv: FloatArray
    residuals_rad: FloatArray
    levels: FloatArray
    scatter: float
    uneven_px: float
    steps: FloatArray

    @property
    def by_nadir(self) -> FloatArray:
        """How a step moves the nadir in camera axes, shape (3, 7)."""
        return nadir_derivative(self.pose)


def fit_limb(image: FloatArray, camera: CameraModel, start: LimbPose, knowledge: LimbKnowledge) -> LimbFit:
    """Fit the limb in one image, shape (H, W), linear in radiance, near a pose that is right to some pixels.

    Raises ``LinAlgError``: too little limb in view, or no convergence.
    """
    return fit_limbs([EdgeImage(image, camera, np.eye(3))], start, knowledge)


def fit_limbs(images: Sequence[EdgeImage], start: LimbPose, knowledge: LimbKnowledge) -> LimbFit:
    """Fit the limb in the images of one shot near a pose of the body that is right to some pixels.

    ``start``, ``knowledge``: of the body, whose axes take the camera's place. Raises ``LinAlgError``: too little limb
    in an image, or no convergence.
    """
    chooser = EdgeChooser(images, knowledge)
    prior = ShotPrior(knowledge.mean, knowledge.information)
    shot = Shot(chooser, prior, chooser.start(start), [one.cam_from_body for one in images], common=1, lowest=LOWEST)
    sigmas = np.zeros(SHARED)
    if len(images) == 1:
        sigmas[:LENS] = knowledge.lens_sigmas
    solution = solve(Bundle([shot], sigmas), OPTIONS)
    found, state = solution.shots[0], shot.state
    assert shot.chosen is not None
    assert shot.seen is not None
    models = [one for one in shot.chosen.models if isinstance(one, EdgeModel)]
    looks = [one for one in shot.seen.looks if isinstance(one, EdgeLook)]
    noises = [one for one in shot.noises if isinstance(one, LightNoise)]
    places = [
        sector_places(model, look, noise.weights(look.residuals), state.air)
        for model, look, noise in zip(models, looks, noises, strict=True)
    ]
    first, turn = images[0], np.eye(POSE)
    turn[:3, :3] = first.cam_from_body
    covariance = turn @ found.covariance[:POSE, :POSE] @ turn.T
    # What the sectors scatter by beyond all that is in the model is no noise of the detector, and not to be averaged.
    ratio = scatter(np.concatenate([one.squares for one in places]), state.air)
    beyond = (ratio - 1.0) * covariance
    # An error of the lens is the same in every picture of the camera.
    by_lens = turn @ found.by_shared[:POSE, :LENS]
    beyond += by_lens @ solution.covariance[:LENS, :LENS] @ by_lens.T
    space, earth, _ = noises[0].parts
    return LimbFit(
        pose=state.pose.of_camera(first.cam_from_body),
        blur_px=float(np.sqrt(max(np.exp(2.0 * state.own[0][0]) - PIXEL_VARIANCE, 0.0))),
        scale_height_m=float(state.own[0][1]),
        covariance=covariance + beyond,
        relief_covariance=covariance - turn @ found.known[:POSE, :POSE] @ turn.T + beyond,
        noise_sigma=(float(np.sqrt(space)), float(np.sqrt(earth))),
        uv=places[0].uv,
        residuals_rad=places[0].off_rad,
        levels=places[0].levels,
        scatter=ratio,
        uneven_px=0.0,
        steps=solution.steps[0],
    )


def scatter(squares: FloatArray, air: FloatArray) -> float:
    """Return chi-squared per degree of freedom of the sectors' positions, of all images.

    ``squares``: of what noise makes of them; ``air``: the relief's unknowns, which have a unit normal prior. The result
    is 1 if chance makes as much in more than a fiftieth of limbs; beyond, it is increased by the uncertainty of so few
    sectors: that of Student's distribution.
    """
    free = int(np.isfinite(squares).sum()) - FITTED
    if free < 1:
        return 1.0
    square = float(np.nansum(squares)) + float(air @ air)
    return square / max(free - 2, 1) if square > chdtri(free, 0.02) else 1.0
