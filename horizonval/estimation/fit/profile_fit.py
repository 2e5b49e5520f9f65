"""The fit of the whole profile of the limb in one image, or in several of one instant: stages, result and claim.

**Stages.** The likelihood has local maxima with a softer lens and more noise in place of air, because radiance above a
limb that is predicted too low looks like a soft lens. The lens is therefore held in the first stage.

**Claim.** The covariance of the solver's equations (:mod:`.bundle`) has a part of the noise, which is left if the air
were known, and one of the air. If the air is inconsistent with its prior, the sum of squares of its unknowns exceeds
the degrees of freedom that the pixels determine, ``tr(1 - C_z)``. Where the excess is more than two standard deviations
the air's part is multiplied by the ratio of the two (Birge's).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.bundle import SHARED, Bundle, Shot, ShotPrior
from horizonval.estimation.fit.image import LENS, POSE, ShotState
from horizonval.estimation.fit.noise import PixelNoise
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.profile import (
    ProfileChooser,
    ProfileImage,
    ProfileLook,
    ProfileModel,
    as_profile,
)
from horizonval.estimation.fit.solver import Solution, SolverOptions, Stage, solve

OPTIONS = SolverOptions(
    stages=(Stage(pixels=2400, tighter=10.0, tolerance=2.0, reselect_px=3.0), Stage(tolerance=0.1)),
    steady=0.5,
    frozen=5.0,
    good=0.2,
)
"""First the lens with ten times the information of its prior, so that it moves by a third of its range (less lets thin
clouds soften it, more increases the dependence on the start), until the pose is near. Derivatives are computed again
after a predicted gain of five, because the effects of air and height nearly cancel; nearer, the changes of the gradient
correct them."""
NEAR = replace(OPTIONS, stages=OPTIONS.stages[:1])
"""Settings of a start: the first stage alone, to about a standard deviation."""
SCATTERED = 2.0
"""Standard deviations of chi-squared beyond which its excess is no chance."""


@dataclass(frozen=True)
class ProfileFit:
    """The most probable pose.

    ``covariance`` (7, 7): of a step from the pose, from noise, priors and air; ``relief_covariance``: the air's part.
    ``plain_covariance``: the same as ``covariance`` without the excess of the air's squares, by which a wrong prior of
    the pose shows.
    ``squares``, ``determined``: sum of squares of the air's unit unknowns, and the number of them that the pixels
    determine. ``improbable``: largest mode coefficient along the limb, in standard deviations. ``explained``: smallest
    share of an image's variance that the prediction explains.
    ``uv`` (m, 2), ``residuals_rad`` (m,): positions on the first image's limb, and by how much their pixels would have
    it farther in. ``steps`` (k, 7). ``models``, ``looks``, ``noises``, ``own``: of every image, for tests of residuals.
    """

    pose: LimbPose
    covariance: FloatArray
    relief_covariance: FloatArray
    plain_covariance: FloatArray
    squares: float
    determined: float
    improbable: float
    explained: float
    uv: FloatArray
    residuals_rad: FloatArray
    steps: FloatArray
    models: Sequence[ProfileModel] = ()
    looks: Sequence[ProfileLook] = ()
    noises: Sequence[PixelNoise] = ()
    own: Sequence[FloatArray] = ()

    @property
    def uneven_px(self) -> float:
        """Departure of the fitted limb from a planet's limb: none, since a profile follows the planet's."""
        return 0.0

    def in_axes(self, turn: FloatArray) -> ProfileFit:
        """Return the fit in other axes of the pose; ``turn``: shape (3, 3), from the present ones."""
        turned = np.eye(POSE)
        turned[:3, :3] = turn
        return replace(
            self,
            pose=self.pose.of_camera(turn),
            covariance=turned @ self.covariance @ turned.T,
            relief_covariance=turned @ self.relief_covariance @ turned.T,
            steps=self.steps @ turned.T,
        )


def profile_shot(images: Sequence[ProfileImage], prior: ShotPrior, start: LimbPose) -> Shot:
    """Return the shot of images, in axes of the body; ``start``: right to some kilometres of height at the limb."""
    own = tuple(image.knowledge.own for image in images)
    return Shot(ProfileChooser(images), prior, ShotState(start, own, np.zeros(0)), [image.turn for image in images])


def fit_profiles(
    images: Sequence[ProfileImage],
    prior: ShotPrior,
    start: LimbPose,
    options: SolverOptions = OPTIONS,
    lens_sigmas: FloatArray | None = None,
) -> ProfileFit:
    """Fit one pose and one air to images of one instant.

    ``images``: linear in radiance, NaN where missing; ``prior``, ``start``: of the body's pose; ``lens_sigmas``: shape
    (4,), of errors of the lens that all images share. Raises ``LinAlgError``: too little limb in view, no radiance
    there, or no convergence.
    """
    shot, sigmas = profile_shot(images, prior, start), np.zeros(SHARED)
    if lens_sigmas is not None:
        sigmas[:LENS] = lens_sigmas
    return fit_of_shot(shot, solve(Bundle([shot], sigmas), options))


def fit_of_shot(shot: Shot, solution: Solution) -> ProfileFit:
    """Return the fit and the claim of a solved shot."""
    chosen, seen, state, found = shot.chosen, shot.seen, shot.state, solution.shots[0]
    assert chosen is not None
    assert seen is not None
    models, noises = [as_profile(model) for model in chosen.models], shot.noises
    looks = [look for look in seen.looks if isinstance(look, ProfileLook)]
    known, covariance = found.known[:POSE, :POSE], found.covariance[:POSE, :POSE]
    squares, determined = float(state.air @ state.air), len(state.air) - found.air_open
    by_lens = found.by_shared[:POSE, :LENS]
    of_lens = by_lens @ solution.covariance[:LENS, :LENS] @ by_lens.T
    of_air = (covariance - known) * strained(squares, determined) + of_lens
    weights = [noise.weights(look.residuals) for noise, look in zip(noises, looks, strict=True)]
    uv, off = by_sector(models[0], looks[0], weights[0])
    airs = [(model.air, state.air[at]) for model, at in zip(models, chosen.columns, strict=True)]
    return ProfileFit(
        pose=state.pose,
        covariance=known + of_air,
        relief_covariance=of_air,
        plain_covariance=covariance + of_lens,
        squares=squares,
        determined=determined,
        improbable=max(improbable(air.coefficients(z)[:, 1:], air.waves) for air, z in airs),
        explained=min(explained(*one) for one in zip(models, looks, noises, strict=True)),
        uv=uv,
        residuals_rad=off,
        steps=solution.steps[0],
        models=models,
        looks=looks,
        noises=noises,
        own=state.own,
    )


def strained(squares: float, determined: float) -> float:
    """Return the excess scatter of unit unknowns, 1 if chance explains it.

    ``squares``: their sum of squares; ``determined``: their number, the mean of ``squares`` and half its variance.
    """
    ratio = squares / max(determined, 1e-300)
    return ratio if determined > 0.0 and ratio > 1.0 + SCATTERED * np.sqrt(2.0 / determined) else 1.0


def explained(model: ProfileModel, look: ProfileLook, noise: PixelNoise) -> float:
    """Return the share of the pixels' variance that the prediction explains, by their weights in the fit's tails."""
    weights = noise.weights(look.residuals) * noise.variance * noise.together
    values = model.near.values
    whole = float(weights @ (values - np.average(values, weights=weights)) ** 2)
    return 1.0 - float(weights @ look.residuals**2) / whole if whole > 0.0 else 0.0


def improbable(coefficients: FloatArray, waves: Sequence[FloatArray]) -> float:
    """Return the largest coefficient of any function of the air in its own standard deviations."""
    sizes = [float(np.sqrt((wave**2).sum(axis=1).max())) for wave in waves]
    return float(np.max(np.abs(coefficients).max(axis=0) / np.array(sizes)))


def by_sector(model: ProfileModel, look: ProfileLook, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a place on the limb for every sector, and by how much its pixels would have the limb farther in [rad]."""
    near = model.near
    # The lift lowers all distances across the limb by as much.
    per_rad = -model.derivatives(look)[POSE - 1] * near.distance_m
    uv, off = [], []
    for first, last in pairwise(near.starts):
        if first == last:
            continue
        here = slice(first, last)
        information = float(weights[here] @ per_rad[here] ** 2)
        pull = float((weights[here] * per_rad[here]) @ look.residuals[here])
        off.append(-pull / information if information > 0.0 else 0.0)
        nearest = first + int(np.argmin(np.abs(near.across_m[here])))
        uv.append([near.columns[nearest], near.rows[nearest]])
    return np.array(uv, dtype=float), np.array(off)
