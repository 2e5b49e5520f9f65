"""One pose and one air fitted to the whole profiles of the limb in all heads.

**Air.** The coefficient of a mode is one random function on the planet, so that the nodes of all heads together have
one covariance, as those of one image have (:mod:`..profile.air`); its waves reach from limb to limb, and their unit
unknowns are common to all heads. Images of other wavelengths have separate modes; the gain of the optics is separate
for each head.

**Pose.** The equations of one image (:mod:`..profile.fit`) are summed. With the unknowns ``g`` of the body (a turn in
body axes, position, lift of all air), those of head ``k`` are ``T_k g``: a turn of the body turns its cameras by
``theta_k = R_k theta``, and the rest is selected. Blur, sharpness, gain and background are separate for each head; the
air is eliminated from the sum.

Every head is fitted alone first, to find its limb, radiance and noise; heads without a limb are left out. The claim is
inflated where the air is inconsistent with its prior, as for one image.

**Neglected.** Correlation of the air between two bands: heads of other wavelengths together claim too small an error of
their common air. The heads of a camera file have the same bands.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.heights import correlations
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.likelihood.profile.air import GAIN_SIGMA, POLE_ITRS, NodeAir, waves_of
from horizonval.estimation.likelihood.profile.fit import (
    CONVERGED,
    LARGEST_LOG_STEP,
    LARGEST_MOTION_PX,
    MOST_STEPS,
    MOST_TRIALS,
    NEARLY_SETTLED,
    ROUNDING,
    WORTH,
    ProfileSearch,
    ProfileStep,
    by_sector,
    explained,
    improbable,
    least_variance,
    noise_at,
    step_without_air,
    strained,
    taken_over,
    wider,
)
from horizonval.estimation.likelihood.profile.knowledge import ProfileFit, ProfileKnowledge
from horizonval.estimation.likelihood.profile.model import (
    BLUR,
    GAIN,
    POSE,
    SHARED,
    SHARPNESS,
    Guess,
    ProfileModel,
    Seen,
    priors_beside_pose,
)
from horizonval.geometry.camera import CameraModel

Name = tuple[Hashable, tuple[str, int]]


@dataclass(frozen=True)
class CommonAir:
    """The air of all heads.

    ``heads``: air of each head, with the common waves at its nodes; ``columns``: indices of each head's unknowns among
    the common ones; ``waves``: by function, shape (nodes, unknowns) over the nodes of all heads that have it;
    ``owners``: those heads, by function; ``count``: number of unknowns.
    """

    heads: list[NodeAir]
    columns: list[NDArray[np.intp]]
    waves: dict[Name, FloatArray]
    owners: dict[Name, list[int]]
    count: int

    def taken_over(self, before: CommonAir, unknowns: FloatArray) -> FloatArray:
        """Return the unknowns that say what those of other nodes, little elsewhere, said."""
        parts = [air.coefficients(unknowns[at]) for air, at in zip(before.heads, before.columns, strict=True)]
        return self.saying(
            [dict(zip(a.names, c[:, 1:].T, strict=True)) for a, c in zip(before.heads, parts, strict=True)]
        )

    def saying(self, known: Sequence[dict[tuple[str, int], FloatArray]]) -> FloatArray:
        """Return the unknowns whose coefficients along the limbs are nearest to known ones, by head and function."""
        found = []
        for name, wave in self.waves.items():
            said = []
            for head in self.owners[name]:
                nodes = len(self.heads[head].up_itrs)
                values = known[head].get(name[1], np.zeros(2))
                said.append(np.interp(np.linspace(0.0, 1.0, nodes), np.linspace(0.0, 1.0, len(values)), values))
            found.append(wave.T @ np.concatenate(said) / np.maximum((wave**2).sum(axis=0), 1e-300))
        return np.concatenate(found)


def common_air(airs: Sequence[NodeAir], tables: Sequence[Hashable]) -> CommonAir:
    """Combine the air of all heads; those with equal ``tables`` share their functions."""
    owners: dict[Name, list[int]] = {}
    for head, (air, table) in enumerate(zip(airs, tables, strict=True)):
        for name in air.names:
            key = (head, name) if name[0] == "gain" else (table, name)
            owners.setdefault(key, []).append(head)
    waves: dict[Name, FloatArray] = {}
    by_head: list[dict[tuple[str, int], tuple[FloatArray, int]]] = [{} for _ in airs]
    roots: dict[tuple[tuple[int, ...], bytes], FloatArray] = {}
    count = 0
    for key, heads in owners.items():
        numbers = [airs[head].names.index(key[1]) for head in heads]
        lengths = np.concatenate([airs[h].lengths_rad[:, i] for h, i in zip(heads, numbers, strict=True)])
        same = (tuple(heads), lengths.tobytes())
        if same not in roots:
            up = np.concatenate([airs[head].up_itrs for head in heads])
            roots[same] = waves_of(correlations(lengths[:, None], up, POLE_ITRS))[0]
        wave = GAIN_SIGMA * roots[same] if key[1][0] == "gain" else roots[same]
        waves[key] = wave
        first = 0
        for head in heads:
            last = first + len(airs[head].up_itrs)
            by_head[head][key[1]] = (wave[first:last], count)
            first = last
        count += wave.shape[1]
    own, columns = [], []
    for air, parts in zip(airs, by_head, strict=True):
        own.append(replace(air, waves=tuple(parts[name][0] for name in air.names)))
        columns.append(np.concatenate([parts[name][1] + np.arange(parts[name][0].shape[1]) for name in air.names]))
    return CommonAir(own, columns, waves, owners, count)


OWN = SHARED - POSE
"""Unknowns that each head has of its own: blur, sharpness, gain, background."""
SETTLING_STEPS = 4
"""Number of steps after which pixels and noise are fixed; heads start from their separate fits."""
ALIGNING_STEPS = 4
"""Largest number of steps towards a common pose with each head's own noise; more steps creep along a bent valley."""


@dataclass(frozen=True)
class ProfileHead:
    """A head whose limb was found.

    ``cam_from_body``: shape (3, 3); ``table``: hashable source of its air; ``image``: shape (H, W); ``alone``: its own
    fit.
    """

    camera: CameraModel
    cam_from_body: FloatArray
    knowledge: ProfileKnowledge
    table: Hashable
    image: FloatArray
    alone: ProfileSearch


@dataclass(frozen=True)
class _Unknowns:
    """The unknowns: the way of the body from the pose that pixels were chosen for, what heads have, and the air."""

    away: FloatArray
    heads: tuple[Guess, ...]
    air: FloatArray


def fit_profiles(
    heads: Sequence[ProfileHead], mean: LimbPose, information: FloatArray, axes_from_body: FloatArray
) -> ProfileFit:
    """Fit the limb's profile in the images of all heads.

    ``mean``: prior pose of the body, ``cam_from_itrs`` being ``body_from_itrs``; ``information``: shape (7, 7), about
    it, of turns in body axes; ``axes_from_body``: shape (3, 3), of the result's camera axes. The result has points and
    levels of the first head. Raises ``LinAlgError``: too little limb in a head, or no convergence.
    """
    return _SearchOfHeads(list(heads), mean, information).run(axes_from_body)


class _SearchOfHeads:
    """Search from one head's pose to the most probable unknowns of all heads.

    Until the others reach that pose (``aligning``) noise and lenses are those of the separate fits. Noise from the
    residuals of a displaced limb would hide it, and a lens that compensates for the displacement would stay wrong.
    """

    def __init__(self, heads: list[ProfileHead], mean: LimbPose, information: FloatArray) -> None:
        self.heads, self.mean, self.information = heads, mean, information
        self.steps: list[FloatArray] = []
        self.body = _best_alone(heads)
        guesses = tuple(replace(head.alone.now, away=np.zeros(POSE)) for head in heads)
        self.models = self._models(guesses)
        self.air = self._common()
        alone = [(head.alone.model.air, head.alone.now.air) for head in heads]
        said = [dict(zip(air.names, air.coefficients(z)[:, 1:].T, strict=True)) for air, z in alone]
        self.now = _Unknowns(np.zeros(POSE), guesses, self.air.saying(said))
        self.weights = [
            taken_over(head.image.shape, head.alone.model, head.alone.inverse_variance, model)
            for head, model in zip(heads, self.models, strict=True)
        ]
        self.looks = self._look(self.now)
        self.aligning = True

    def run(self, axes_from_body: FloatArray) -> ProfileFit:
        """Search, and return where it ends."""
        settled = 0
        for _ in range(MOST_STEPS):
            held = settled == SETTLING_STEPS
            if not (held or self.aligning):
                self._choose_again()
                self._weigh()
                settled += 1
            found = self._equations()
            over = self._reach(found.step)
            step, gained = found.step / over, found.gained / over**2
            size = float(step[:POSE] @ np.linalg.solve(found.covariance[:POSE, :POSE], step[:POSE]))
            improved = self._search_along(step)
            coming = improved and size > NEARLY_SETTLED and len(self.steps) < ALIGNING_STEPS
            self.aligning = self.aligning and coming
            if held and (not improved or (size < CONVERGED and gained < 1.0)):
                return self._found(found, axes_from_body)
        raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps")

    def _weigh(self) -> None:
        """Estimate the noise of all heads by their residuals as they are."""
        each = list(zip(self.models, self.looks, strict=True))
        guesses = [self._guess(k, self.now) for k in range(len(self.heads))]
        self.least = [least_variance(one, guess, look) for (one, look), guess in zip(each, guesses, strict=True)]
        found = zip(each, self.weights, self.least, strict=True)
        self.noises = [noise_at(*seen, weights, least) for seen, weights, least in found]
        seen_as = zip(each, guesses, self.noises, strict=True)
        self.wider = [wider(model, guess, look, noise) for (model, look), guess, noise in seen_as]
        self.weights = [noise.inverse_variance / by for noise, by in zip(self.noises, self.wider, strict=True)]

    def _models(self, guesses: Sequence[Guess]) -> list[ProfileModel]:
        return [
            ProfileModel(head.image, head.camera, _seen_from(self.body, head.cam_from_body), guess.blur, head.knowledge)
            for head, guess in zip(self.heads, guesses, strict=True)
        ]

    def _common(self) -> CommonAir:
        """Return the air of all models, which get their parts of it."""
        found = common_air([model.air for model in self.models], [head.table for head in self.heads])
        for model, air in zip(self.models, found.heads, strict=True):
            model.air = air
        return found

    def _choose_again(self) -> None:
        """Choose the pixels anew at the present pose; everything else stays as it is."""
        before = self.air
        self.body = self.body.moved(self.now.away)
        self.models = self._models(self.now.heads)
        self.air = self._common()
        self.now = _Unknowns(np.zeros(POSE), self.now.heads, self.air.taken_over(before, self.now.air))
        self.weights = [np.ones_like(model.near.values) for model in self.models]
        self.looks = self._look(self.now)

    def _guess(self, k: int, now: _Unknowns) -> Guess:
        """Return the unknowns of a head's own model."""
        return replace(
            now.heads[k], away=_turned(self.heads[k].cam_from_body) @ now.away, air=now.air[self.air.columns[k]]
        )

    def _look(self, now: _Unknowns) -> list[Seen]:
        return [model.look(self._guess(k, now)) for k, model in enumerate(self.models)]

    def _equations(self) -> ProfileStep:
        count = POSE + OWN * len(self.heads)
        shared, right = np.zeros((count, count)), np.zeros(count)
        mixed = np.zeros((count, self.air.count))
        air, right_air = np.zeros((self.air.count, self.air.count)), -self.now.air
        wanted = self.body.step_to(self.mean) - self.now.away
        shared[:POSE, :POSE] = self.information
        right[:POSE] = self.information @ wanted
        for k, (head, model, look) in enumerate(zip(self.heads, self.models, self.looks, strict=True)):
            guess = self._guess(k, self.now)
            pull_of_noise = None if self.aligning else self.noises[k].pull(look.residuals, guess.gain)
            parts = model.equations(guess, look, self.weights[k], pull_of_noise)
            picked = np.zeros((SHARED, count))
            picked[:POSE, :POSE] = _turned(head.cam_from_body)
            picked[POSE:, POSE + OWN * k : POSE + OWN * (k + 1)] = np.eye(OWN)
            own, pull = self._own_priors(k, self.now)
            free = np.ones(SHARED)
            free[[BLUR, SHARPNESS]] = not self.aligning
            shared += picked.T @ (free[:, None] * parts.shared * free + np.diag(own)) @ picked
            right += picked.T @ (free * (parts.right + own * pull))
            at = self.air.columns[k]
            mixed[:, at] += picked.T @ (free[:, None] * parts.mixed)
            air[np.ix_(at, at)] += parts.air
            right_air[at] += parts.right_air
        return step_without_air(shared, right, mixed, air, right_air)

    def _own_priors(self, k: int, now: _Unknowns) -> tuple[FloatArray, FloatArray]:
        """Return the information on what a head has of its own, shape (11,), and the step to where it points."""
        return priors_beside_pose(self.heads[k].knowledge, now.heads[k], self.models[k].floor)

    def _reach(self, step: FloatArray) -> float:
        """Return by how much a step is beyond the reach of the derivatives, at least 1."""
        over = 1.0
        for k, (head, model) in enumerate(zip(self.heads, self.models, strict=True)):
            own = step[POSE + OWN * k :]
            logs = float(np.abs(own[[BLUR - POSE, GAIN - POSE]]).max())
            moved = model.motion_px(_turned(head.cam_from_body) @ step[:POSE])
            over = max(over, moved / LARGEST_MOTION_PX, logs / LARGEST_LOG_STEP)
        return over

    def _moved(self, step: FloatArray) -> _Unknowns:
        heads = []
        for k, one in enumerate(self.now.heads):
            own = np.concatenate([np.zeros(POSE), step[POSE + OWN * k : POSE + OWN * (k + 1)]])
            heads.append(replace(one, air=np.zeros(0)).moved(own))
        return _Unknowns(self.now.away + step[:POSE], tuple(heads), self.now.air + step[POSE + OWN * len(heads) :])

    def _search_along(self, step: FloatArray) -> bool:
        """Take a step, or the first of its halves that makes nothing worse; return whether that is worth another."""
        before = self._merit(self.now, self.looks)
        for _ in range(MOST_TRIALS):
            now = self._moved(step)
            looks = self._look(now)
            merit = self._merit(now, looks)
            if merit <= before + ROUNDING:
                self.now, self.looks = now, looks
                self.steps.append(step[:POSE])
                return before - merit > WORTH
            step = 0.5 * step
        return False

    def _merit(self, now: _Unknowns, looks: Sequence[Seen]) -> float:
        wanted = self.body.step_to(self.mean) - now.away
        squares = float(now.air @ now.air) + float(wanted @ self.information @ wanted)
        for k, look in enumerate(looks):
            own, pull = self._own_priors(k, now)
            squares += float(own @ pull**2)
            if self.aligning:
                squares += float(self.weights[k] @ look.residuals**2)
            else:
                noise = noise_at(self.models[k], look, self.weights[k], self.least[k])
                squares += noise.improbability(look.residuals, self.wider[k])
        return squares

    def _found(self, last: ProfileStep, axes_from_body: FloatArray) -> ProfileFit:
        squares, count = float(self.now.air @ self.now.air), self.air.count
        wider = strained(squares, count - last.air_open)
        turned = _turned(axes_from_body)
        known = turned @ last.known[:POSE, :POSE] @ turned.T
        of_air = wider * (turned @ last.covariance[:POSE, :POSE] @ turned.T - known)
        first = self._guess(0, self.now)
        uv, off = by_sector(self.models[0], self.looks[0], first, self.weights[0])
        guesses = [self._guess(k, self.now) for k in range(len(self.heads))]
        shares = [explained(*one) for one in zip(self.models, self.looks, self.noises, strict=True)]
        return ProfileFit(
            pose=_seen_from(self.body.moved(self.now.away), axes_from_body),
            blur_px=first.blur,
            gain=first.gain,
            background=first.background,
            covariance=known + of_air,
            relief_covariance=of_air,
            improbable=max(improbable(m.air, g.air) for m, g in zip(self.models, guesses, strict=True)),
            explained=min(shares),
            uv=uv,
            residuals_rad=off,
            steps=np.array([turned @ step for step in self.steps]),
        )


def _turned(cam_from_body: FloatArray) -> FloatArray:
    """Return how a step of a camera's pose follows from one of the body's, shape (7, 7)."""
    turned = np.eye(POSE)
    turned[:3, :3] = cam_from_body
    return turned


def _seen_from(body: LimbPose, cam_from_body: FloatArray) -> LimbPose:
    return LimbPose(cam_from_body @ body.cam_from_itrs, body.r_itrs, body.height_m)


def _best_alone(heads: Sequence[ProfileHead]) -> LimbPose:
    """Return the body's pose as the head has it that knows its turn best."""
    best = min(heads, key=lambda head: float(np.trace(head.alone.covariance[:3, :3])))
    pose = best.alone.pose
    return _seen_from(pose, best.cam_from_body.T)
