"""A bundle of shots: which unknowns there are, what is shared, and the equations of all of them.

A *shot* is what was seen at one instant: one pose of the body, one image or several, one air. Its unknowns are the pose
(7), what each image has of its own, and the air. A bundle is one shot (an estimate of the attitude, from one camera or
several heads), or many of one camera whose errors they share (a calibration): ln focal length, principal point and
distortion, the turn of the mounting, and the common height of all limbs (8).

**Elimination.** With the air's unknowns ``z`` of unit priors, the shot's other unknowns ``x`` and the shared ones ``c``
the normal matrix of a shot is ::

    [[A + 1, M^T, ..], [M, X, Z], [.., Z^T, S]],        A + 1 = L L^T

The air is eliminated first (Cholesky), then ``x`` (Schur's complement; Triggs, McLauchlan, Hartley and Fitzgibbon,
"Bundle adjustment", 2000, section 6); what remains of all shots is summed with the prior of ``c``.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack, solve_triangular
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.image import LENS, POSE, Chooser, Chosen, Linear, Look, ShotState
from horizonval.estimation.fit.noise import PixelNoise
from horizonval.estimation.fit.pose import LimbPose, nadir_derivative
from horizonval.geometry.rotation import tangent_basis

TURN, HEIGHT, SHARED = slice(LENS, LENS + 3), LENS + 3, LENS + 4
"""Places of mounting and common height among the shared unknowns, and how many there are."""
UNDETERMINED = "the limb in view does not determine the fit's unknowns"


@dataclass(frozen=True)
class ShotPrior:
    """What is known of a shot: ``mean`` pose of its body, and ``information``, shape (7, 7), of a step from it."""

    mean: LimbPose
    information: FloatArray

    def wanted(self, pose: LimbPose, shared: FloatArray) -> FloatArray:
        """Return the step (7,) to the prior's pose, turned and raised by what all shots share."""
        mean = self.mean
        if shared.any():
            turn = Rotation.from_rotvec(shared[TURN]).as_matrix()
            mean = LimbPose(turn @ mean.cam_from_itrs, mean.r_itrs, mean.height_m + float(shared[HEIGHT]))
        return pose.step_to(mean)


@dataclass(frozen=True)
class Seen:
    """A shot as predicted: looks at its images, and minus twice its log likelihood with all priors."""

    looks: Sequence[Look]
    merit: float


class Shot:
    """One instant: pixels, unknowns and their equations.

    ``turns``: shape (3, 3) of every image, camera from body; ``state``: the unknowns as they are; ``common``: how many
    of the images' own unknowns, the last ones of each, are common to all of them; ``lowest``: shape (own,), least
    values of an image's own unknowns.
    """

    def __init__(
        self,
        chooser: Chooser,
        prior: ShotPrior,
        state: ShotState,
        turns: Sequence[FloatArray] = (np.eye(3),),
        common: int = 0,
        lowest: FloatArray | float = -np.inf,
    ) -> None:
        self._chooser, self.prior, self.turns = chooser, prior, tuple(turns)
        self.state, self._lowest = state, lowest
        alone = [len(own) - common for own in state.own]
        self.count = POSE + sum(alone) + common
        """Number of unknowns of pose and images."""
        self.own_at = [
            np.append(POSE + sum(alone[:k]) + np.arange(one), np.arange(self.count - common, self.count))
            for k, one in enumerate(alone)
        ]
        """Places of every image's own unknowns among them."""
        self.chosen: Chosen | None = None
        self.noises: list[PixelNoise] = []
        self.seen: Seen | None = None

    def choose(self, shared: FloatArray, most: int | None = None, tighter: float = 1.0) -> None:
        """Choose the pixels near the limb at the present state; parameters as for ``Chooser``."""
        self.chosen = self._chooser(self.state, shared[:LENS], most, tighter, self.chosen)
        self.state = self.chosen.state
        looks = self._looks(self.state, shared, None)
        self.noises = [model.noise(look) for model, look in zip(self.chosen.models, looks, strict=True)]
        self.seen = Seen(looks, np.nan)
        self.seen = self.look(self.state, shared)

    def weigh(self, shared: FloatArray) -> float:
        """Estimate the noise by the residuals; return the change of the variances' logarithms, root mean square."""
        assert self.seen is not None
        before = self.noises
        self.noises = [model.noise(look) for model, look in zip(self._chosen.models, self.seen.looks, strict=True)]
        self.seen = self.look(self.state, shared)
        changes = [
            np.log(new.variance * new.together / (old.variance * old.together))
            for new, old in zip(self.noises, before, strict=True)
        ]
        return float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))

    def look(self, state: ShotState, shared: FloatArray) -> Seen:
        """Return the images as a state predicts them, with the weights of the present residuals."""
        looks = self._looks(state, shared, self._weights)
        wanted = self.prior.wanted(state.pose, shared)
        merit = float(wanted @ self.prior.information @ wanted) + float(state.air @ state.air)
        of_all = zip(self._chosen.models, looks, self.noises, state.own, self.turns, strict=True)
        for model, look, noise, own, turn in of_all:
            merit += noise.improbability(look.residuals) + look.penalty
            merit += model.prior(state.pose.of_camera(turn), own).penalty
        return Seen(looks, merit)

    def moved(self, step: FloatArray, of_air: FloatArray) -> ShotState:
        """Return the state after a step of pose and own unknowns, and of the air."""
        of_all = zip(self._chosen.models, self.state.own, self.own_at, strict=True)
        own = [model.moved(one, step[at]) for model, one, at in of_all]
        return ShotState(self.state.pose.moved(step[:POSE]), tuple(own), self.state.air + of_air)

    def limited(self, step: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
        """Return the most probable step within the limits of the images' own unknowns, and the gain that they cost.

        ``covariance``: shape (x, x). An unknown that a step would take beyond its limit goes there, and the others
        follow as the covariance says.
        """
        cost = 0.0
        for own, at in zip(self.state.own, self.own_at, strict=True):
            beyond = np.maximum(self._lowest - own - step[at], 0.0)
            for k in np.flatnonzero(beyond):
                by_unit = covariance[at[k]] / covariance[at[k], at[k]]
                cost += float(beyond[k] ** 2 / covariance[at[k], at[k]])
                step = step + beyond[k] * by_unit
        return step, cost

    def reach(self, step: FloatArray, of_shared: FloatArray) -> float:
        """Return how far a step goes, 1 where derivatives end to hold."""
        steps = self._of_images(step, of_shared)
        return max(model.reach(one) for model, one in zip(self._chosen.models, steps, strict=True))

    def motion_px(self, step: FloatArray, of_shared: FloatArray) -> float:
        """Return by how much a step moves the limb where it moves it most [px]."""
        steps = self._of_images(step, of_shared)
        return max(model.motion_px(one) for model, one in zip(self._chosen.models, steps, strict=True))

    def equations(self, shared: FloatArray, free: NDArray[np.intp]) -> ShotEquations:
        """Return the equations at the present state; ``free``: indices of the shared unknowns that are not exact."""
        assert self.seen is not None
        models = self._chosen.models
        each = zip(models, self.seen.looks, self.state.own, self._weights, strict=True)
        linears = [model.linear(look, own, weights) for model, look, own, weights in each]
        return ShotEquations(self, linears, shared, free)

    @property
    def _chosen(self) -> Chosen:
        assert self.chosen is not None
        return self.chosen

    @property
    def _weights(self) -> list[FloatArray]:
        assert self.seen is not None
        return [noise.weights(look.residuals) for noise, look in zip(self.noises, self.seen.looks, strict=True)]

    def _looks(self, state: ShotState, shared: FloatArray, weights: Sequence[FloatArray] | None) -> list[Look]:
        chosen = self._chosen
        by_image: Sequence[FloatArray | None] = [None] * len(self.turns) if weights is None else weights
        return [
            model.look(state.pose.of_camera(turn), shared[:LENS], own, state.air[at], weight)
            for model, turn, own, at, weight in zip(
                chosen.models, self.turns, state.own, chosen.columns, by_image, strict=True
            )
        ]

    def _of_images(self, step: FloatArray, of_shared: FloatArray) -> list[FloatArray]:
        """Return the step of every image's shared unknowns (7 + 4 + own)."""
        return [
            np.concatenate([turn @ step[:3], step[3:POSE], of_shared[:LENS], step[at]])
            for turn, at in zip(self.turns, self.own_at, strict=True)
        ]


class ShotEquations:
    """Normal equations of a shot, with the derivatives of one state and the residuals of any.

    ``normal``: shape (x + c, x + c), of pose and own unknowns and of the shared ones that are free; ``mixed``: shape
    (x + c, a), of these and the air; ``air``: shape (a, a). All without the unit priors of air and shared unknowns.
    ``rights``: shapes (x + c,) and (a,), of the present state; ``exact``: see :class:`.image.Linear`.
    """

    def __init__(self, shot: Shot, linears: Sequence[Linear], shared: FloatArray, free: NDArray[np.intp]) -> None:
        self._shot, self.linears = shot, linears
        self.exact = all(linear.exact for linear in linears)
        chosen, count = shot.chosen, shot.count
        assert chosen is not None
        # How steps of the shared unknowns follow from those of which equations are made.
        of_shared = np.zeros((SHARED, count + len(free)))
        of_shared[free, count + np.arange(len(free))] = 1.0
        self._picked = self._picks(of_shared)
        air_count = len(shot.state.air)
        to_prior = np.eye(POSE, count + len(free))
        to_prior[:3] -= of_shared[TURN]
        to_prior[POSE - 1] -= of_shared[HEIGHT]
        self._to_prior = to_prior
        self.normal = to_prior.T @ shot.prior.information @ to_prior
        # One image's air is the shot's.
        alone = len(linears) == 1 and np.array_equal(chosen.columns[0], np.arange(air_count))
        self.air = linears[0].air if alone else np.zeros((air_count, air_count))
        self.mixed = np.zeros((count + len(free), air_count))
        for linear, picked, at, model, own, turn in zip(
            linears, self._picked, chosen.columns, chosen.models, shot.state.own, shot.turns, strict=True
        ):
            prior = model.prior(shot.state.pose.of_camera(turn), own)
            self.normal += picked.T @ (linear.shared + prior.information) @ picked
            self.mixed[:, at] += picked.T @ linear.mixed
            if not alone:
                self.air[np.ix_(at, at)] += linear.air
        self.rights = self._rights(shared)

    def again(self, shared: FloatArray) -> ShotEquations:
        """Return the same derivatives with the residuals of the shot's present state."""
        again = copy(self)
        again.rights = again._rights(shared)
        return again

    def _rights(self, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        shot = self._shot
        assert shot.seen is not None
        assert shot.chosen is not None
        right, right_air = np.zeros(len(self.normal)), -shot.state.air
        each = zip(
            self.linears,
            self._picked,
            shot.chosen.columns,
            shot.seen.looks,
            shot._weights,
            shot.chosen.models,
            shot.state.own,
            shot.turns,
            strict=True,
        )
        for linear, picked, at, look, weights, model, own, turn in each:
            of_pixels, of_air = linear.rights(look, weights)
            prior = model.prior(shot.state.pose.of_camera(turn), own)
            right += picked.T @ (of_pixels + prior.right)
            right_air[at] += of_air
        wanted = shot.prior.wanted(shot.state.pose, shared)
        return right + self._to_prior.T @ (shot.prior.information @ wanted), right_air

    def _picks(self, of_shared: FloatArray) -> list[FloatArray]:
        """Return how the unknowns of every image (7 + 4 + own) follow from those of shot and bundle."""
        picks = []
        for turn, at in zip(self._shot.turns, self._shot.own_at, strict=True):
            picked = np.zeros((POSE + LENS + len(at), of_shared.shape[1]))
            picked[:3, :3] = turn
            picked[3:POSE, 3:POSE] = np.eye(POSE - 3)
            picked[POSE : POSE + LENS] = of_shared[:LENS]
            picked[POSE + LENS + np.arange(len(at)), at] = 1.0
            picks.append(picked)
        return picks


class Eliminated:
    """A shot's equations with the air eliminated, and how steps of the air follow.

    ``normal``: shape (x + c, x + c); raises ``LinAlgError`` where there is no solution.
    """

    def __init__(self, equations: ShotEquations) -> None:
        if not all(np.isfinite(one).all() for one in (equations.normal, equations.air, equations.mixed)):
            raise np.linalg.LinAlgError("the fit's equations have no solution")
        # Symmetric: the transpose is the matrix in the order that the factorisation overwrites.
        air = equations.air.copy().T
        air[np.diag_indices(len(air))] += 1.0
        self._root = root_of(air)
        self._half = self._forward(equations.mixed.T)
        self.normal = equations.normal - self._half.T @ self._half

    def without_air(self, right: FloatArray, right_air: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return right sides (x + c,), (a,) with the air eliminated, and what the air needs of them."""
        if not (np.isfinite(right).all() and np.isfinite(right_air).all()):
            raise np.linalg.LinAlgError("the fit's equations have no solution")
        half_air = self._forward(right_air)
        return right - self._half.T @ half_air, half_air

    def air_step(self, step: FloatArray, half_air: FloatArray) -> FloatArray:
        """Return the step of the air that belongs to one of the other unknowns, shape (x + c,)."""
        if not len(half_air):
            return half_air
        return np.asarray(
            solve_triangular(self._root, half_air - self._half @ step, lower=True, trans=1, check_finite=False)
        )

    def air_open(self, covariance: FloatArray) -> float:
        """Return the trace of the air's covariance: how many of its unknowns the pixels leave open.

        ``covariance``: shape (x, x), of the shot's other unknowns.
        """
        if not len(self._root):
            return 0.0
        inverse = np.tril(lapack.dtrtri(self._root, lower=1)[0])
        through = inverse.T @ self._half[:, : len(covariance)]
        return float(np.sum(inverse**2)) + float(np.sum((through @ covariance) * through))

    def _forward(self, right: FloatArray) -> FloatArray:
        if not len(self._root):
            return np.zeros_like(right)
        return np.asarray(solve_triangular(self._root, right, lower=True, check_finite=False))


@dataclass(frozen=True)
class ShotSolution:
    """The uncertainty of a shot.

    ``covariance``: shape (x, x), of pose and own unknowns; ``known``: the same if the air were known; ``by_shared``:
    shape (x, 8), how the shot's unknowns follow the shared ones; ``air_open``: number of the air's unknowns that the
    pixels leave open.
    """

    covariance: FloatArray
    known: FloatArray
    by_shared: FloatArray
    air_open: float


class Bundle:
    """Shots with what they share.

    ``sigmas``: shape (8,), prior standard deviations of the shared unknowns, 0 for what is exact; ``shared``: their
    values, which the solver moves as it does the shots' states.
    """

    def __init__(
        self, shots: Sequence[Shot], sigmas: FloatArray | None = None, shared: FloatArray | None = None
    ) -> None:
        self.shots = shots
        self.sigmas = np.zeros(SHARED) if sigmas is None else sigmas
        self.shared = np.zeros(SHARED) if shared is None else shared

    @property
    def free(self) -> NDArray[np.intp]:
        """Indices of the shared unknowns that are not exact."""
        return np.flatnonzero(self.sigmas > 0.0)

    @property
    def merit(self) -> float:
        """Minus twice the log likelihood of all pixels, with all priors."""
        free = self.free
        prior = float(np.sum((self.shared[free] / self.sigmas[free]) ** 2))
        return prior + sum(shot.seen.merit for shot in self.shots if shot.seen is not None)


Parts = Sequence[FloatArray]
"""A vector of all unknowns: of the shared ones (8,), then of every shot's own and of its air in turn."""


@dataclass(frozen=True)
class Step:
    """A step of a bundle.

    ``parts``: the step; ``sides``: the right sides of the equations there, half the gradient of the merit;
    ``square``: squared length of the reported part (of the shared unknowns', where there are any) in its covariance;
    ``gained``: predicted decrease of the merit.
    """

    parts: Parts
    sides: Parts
    square: float
    gained: float

    @property
    def of_shared(self) -> FloatArray:
        """Step of the shared unknowns, shape (8,)."""
        return self.parts[0]

    @property
    def of_shots(self) -> Sequence[tuple[FloatArray, FloatArray]]:
        """Step of every shot's own unknowns and of its air."""
        return list(zip(self.parts[1::2], self.parts[2::2], strict=True))

    def shortened(self, share: float) -> Step:
        """Return a share of the step."""
        parts = [share * part for part in self.parts]
        return Step(parts, self.sides, share**2 * self.square, share * (2.0 - share) * self.gained)


@dataclass(frozen=True)
class Curvature:
    """A step that was taken, and by how much the right sides fell along it: curvature with second derivatives.

    The inverse of the equations' matrix is corrected by the last few of them (limited-memory BFGS; J. Nocedal, Math.
    Comp. 35, 773, 1980).
    """

    parts: Parts
    fallen: Parts

    @classmethod
    def between(cls, before: Step, after: Parts) -> Curvature | None:
        """Return that of a step, by the right sides ``after`` it; None of one that does not curve upwards."""
        fallen = [old - new for old, new in zip(before.sides, after, strict=True)]
        return cls(before.parts, fallen) if product(fallen, before.parts) > 0.0 else None


def product(one: Parts, other: Parts) -> float:
    """Return the scalar product of two vectors of all unknowns."""
    return sum(float(a @ b) for a, b in zip(one, other, strict=True))


def _added(one: Parts, share: float, other: Parts) -> list[FloatArray]:
    return [a + share * b for a, b in zip(one, other, strict=True)]


class Solved:
    """The equations of a bundle with everything eliminated but what all shots share."""

    def __init__(self, bundle: Bundle, equations: Sequence[ShotEquations]) -> None:
        self._bundle, self._free, self._sigmas = bundle, bundle.free, bundle.sigmas[bundle.free]
        self._airless, self._inverse, self._gains = [], [], []
        # In units of the priors' sigmas: their own information is the unit matrix.
        total = np.eye(len(self._free))
        for shot, one in zip(bundle.shots, equations, strict=True):
            airless, count = Eliminated(one), shot.count
            inverse = scaled_inverse(airless.normal[:count, :count])
            gain = inverse @ airless.normal[:count, count:]
            total += (airless.normal[count:, count:] - airless.normal[count:, :count] @ gain) * np.outer(
                self._sigmas, self._sigmas
            )
            self._airless.append(airless)
            self._inverse.append(inverse)
            self._gains.append(gain)
        self._information, self._total = total, scaled_inverse(total)

    def step(self, sides: Parts, curvatures: Sequence[Curvature] = ()) -> Step:
        """Return the step by right sides (:func:`right_sides`), corrected by curvatures, the last one last."""
        shares, left = [], sides
        for one in reversed(curvatures):
            shares.append(product(one.parts, left) / product(one.parts, one.fallen))
            left = _added(left, -shares[-1], one.fallen)
        parts = self._newton(left)
        for one, share in zip(curvatures, reversed(shares), strict=True):
            parts = _added(parts, share - product(one.fallen, parts) / product(one.parts, one.fallen), one.parts)
        gained, free = product(sides, parts), self._free
        in_sigmas = parts[0][free] / self._sigmas
        square = float(in_sigmas @ self._information @ in_sigmas)
        for k, (shot, inverse) in enumerate(zip(self._bundle.shots, self._inverse, strict=True)):
            own, cost = shot.limited(parts[1 + 2 * k], inverse)
            if cost > 0.0 and curvatures:
                # Limits follow from the equations' covariance, of which the curvatures are no part.
                return self.step(sides)
            if cost > 0.0:
                beyond = np.concatenate([own - parts[1 + 2 * k], np.zeros(len(free))])
                parts[1 + 2 * k], gained = own, gained - cost
                parts[2 + 2 * k] = parts[2 + 2 * k] + self._airless[k].air_step(beyond, np.zeros(len(parts[2 + 2 * k])))
            if not len(free):
                square = max(square, _reported_square(shot.state.pose, own[:POSE], inverse[:POSE, :POSE]))
        return Step(parts, sides, square, gained)

    def _newton(self, sides: Parts) -> list[FloatArray]:
        """Return the answer of the equations to right sides."""
        free, open_ = self._free, np.zeros(len(self._free))
        pull = sides[0][free].copy()
        rights = []
        for k, shot in enumerate(self._bundle.shots):
            right, half_air = self._airless[k].without_air(np.concatenate([sides[1 + 2 * k], open_]), sides[2 + 2 * k])
            pull += right[shot.count :] - self._gains[k].T @ right[: shot.count]
            rights.append((right[: shot.count], half_air))
        of_free = self._sigmas * (self._total @ (self._sigmas * pull))
        parts = [np.zeros(SHARED)]
        parts[0][free] = of_free
        for k, (right, half_air) in enumerate(rights):
            own = self._inverse[k] @ right - self._gains[k] @ of_free
            parts += [own, self._airless[k].air_step(np.concatenate([own, of_free]), half_air)]
        return parts

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the shared unknowns, shape (8, 8); 0 of what is exact."""
        covariance = np.zeros((SHARED, SHARED))
        covariance[np.ix_(self._free, self._free)] = self._total * np.outer(self._sigmas, self._sigmas)
        return covariance

    def of_shot(self, k: int, equations: ShotEquations) -> ShotSolution:
        """Return the uncertainty of a shot, the shared unknowns at their values."""
        count, covariance = self._bundle.shots[k].count, self._inverse[k]
        known = scaled_inverse(equations.normal[:count, :count])
        by_shared = np.zeros((count, SHARED))
        by_shared[:, self._free] = -self._gains[k]
        return ShotSolution(covariance, known, by_shared, self._airless[k].air_open(covariance))


def _reported_square(pose: LimbPose, step: FloatArray, covariance: FloatArray) -> float:
    """Return the squared length of a step (7,) in the claims that follow from a pose: of nadir and of altitude."""
    by_tilt = tangent_basis(pose.nadir_cam).T @ nadir_derivative(pose)
    by_altitude = np.concatenate([np.zeros(3), pose.r_itrs / np.linalg.norm(pose.r_itrs), np.zeros(1)])
    tilt, variance = by_tilt @ step, float(by_altitude @ covariance @ by_altitude)
    of_tilt = float(tilt @ np.linalg.solve(by_tilt @ covariance @ by_tilt.T, tilt))
    return max(of_tilt, float(by_altitude @ step) ** 2 / variance if variance > 0.0 else 0.0)


def right_sides(bundle: Bundle, equations: Sequence[ShotEquations]) -> Parts:
    """Return the right sides of the equations with these derivatives and the present residuals."""
    free = bundle.free
    of_shared = np.zeros(SHARED)
    of_shared[free] = -bundle.shared[free] / bundle.sigmas[free] ** 2
    sides = [of_shared]
    for shot, one in zip(bundle.shots, equations, strict=True):
        right, of_air = one.rights
        of_shared[free] += right[shot.count :]
        sides += [right[: shot.count], of_air]
    return sides


def scaled_inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix whose unknowns have units of their own.

    Raises ``LinAlgError``: undetermined unknowns.
    """
    square = np.diag(matrix)
    if not (np.isfinite(matrix).all() and (square > 0.0).all()):
        raise np.linalg.LinAlgError(UNDETERMINED)
    size = np.sqrt(square)
    root = root_of(np.array(matrix / np.outer(size, size), order="F"))
    half = solve_triangular(root, np.diag(1.0 / size), lower=True, check_finite=False)
    return half.T @ half


def root_of(matrix: FloatArray) -> FloatArray:
    """Return the lower root of a positive definite matrix in Fortran's order, which is overwritten (Cholesky).

    Raises ``LinAlgError``: undetermined unknowns.
    """
    if not len(matrix):
        return matrix
    root, failed = lapack.dpotrf(matrix, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError(UNDETERMINED)
    return np.asarray(root)
