"""Bundle and solver on images whose pixels are functions of a linear prediction, against dense linear algebra."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.bundle import SHARED, Bundle, Shot, ShotPrior
from horizonval.estimation.fit.image import LENS, POSE, Chosen, OwnPrior, ShotState
from horizonval.estimation.fit.noise import PixelNoise
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.solver import SolverOptions, Stage, solve

UNITS = np.array([1e-5] * 3 + [1.0] * 4)
"""Of the pose's unknowns [rad, m]: turns so small that they add."""
OWN, AIR, PIXELS = 2, 5, 60
EXACT = SolverOptions((Stage(tolerance=1e-6),), good=np.inf)


def straight(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    return u, np.ones_like(u)


def bent(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    return u + 0.02 * u**2, 1.0 + 0.04 * u


def saturating(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Newton's steps from far away go ever further."""
    return np.arctan(u), 1.0 / (1.0 + u**2)


@dataclass(frozen=True)
class ToyLook:
    residuals: FloatArray
    by_unknowns: FloatArray
    penalty: float = 0.0


class ToyLinear:
    exact: ClassVar[bool] = False

    def __init__(self, rows: FloatArray, weights: FloatArray) -> None:
        normal, s = rows.T @ (weights[:, None] * rows), POSE + LENS + OWN
        self.shared, self.mixed, self.air = normal[:s, :s], normal[:s, s:], normal[s:, s:]
        self._rows = rows

    def rights(self, look: Any, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        right = self._rows.T @ (weights * look.residuals)
        return right[: POSE + LENS + OWN], right[POSE + LENS + OWN :]


@dataclass
class ToyImage:
    """Pixels ``curve(rows @ unknowns)``; the unknowns are pose from ``origin``, lens, own, air."""

    rows: FloatArray
    values: FloatArray
    origin: LimbPose
    curve: Callable[[FloatArray], tuple[FloatArray, FloatArray]] = straight
    own_sigma: float = np.inf

    def moved(self, own: FloatArray, step: FloatArray) -> FloatArray:
        return own + step

    def prior(self, pose: LimbPose, own: FloatArray) -> OwnPrior:
        information = np.zeros((POSE + LENS + OWN,) * 2)
        information[-OWN:, -OWN:] = np.eye(OWN) / self.own_sigma**2
        right = np.concatenate([np.zeros(POSE + LENS), -own / self.own_sigma**2])
        return OwnPrior(information, right, float(own @ own) / self.own_sigma**2)

    def reach(self, step: FloatArray) -> float:
        return float(np.abs(step[-OWN:]).max()) / 1e3

    def motion_px(self, step: FloatArray) -> float:
        return 0.0

    def look(
        self, pose: LimbPose, lens: FloatArray, own: FloatArray, air: FloatArray, weights: FloatArray | None
    ) -> ToyLook:
        value, slope = self.curve(self.rows @ np.concatenate([self.origin.step_to(pose), lens, own, air]))
        return ToyLook(self.values - value, slope[:, None] * self.rows)

    def noise(self, look: Any) -> PixelNoise:
        return PixelNoise(np.ones_like(self.values))

    def linear(self, look: Any, own: FloatArray, weights: FloatArray) -> ToyLinear:
        return ToyLinear(look.by_unknowns, weights)


ORIGIN = LimbPose(Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([7e6, 0.0, 0.0]), 30e3)


class Toy:
    """A bundle of such images with its truth, drawn from the priors; the unknowns of a shot are pose, own, air."""

    def __init__(
        self,
        seed: int,
        shots: int = 1,
        turns: int = 1,
        sigmas: FloatArray | None = None,
        curve: Callable[[FloatArray], tuple[FloatArray, FloatArray]] = straight,
        start: float = 0.0,
        outliers: float = 0.0,
    ) -> None:
        random = np.random.default_rng(seed)
        self.heads = [np.asarray(Rotation.random(random_state=seed + k).as_matrix()) for k in range(turns)]
        shared_sigmas = np.zeros(SHARED) if sigmas is None else sigmas
        self.shared = shared_sigmas * random.standard_normal(SHARED)
        self.information = np.diag(1.0 / (3.0 * UNITS) ** 2)
        self.bundle = Bundle([], shared_sigmas)
        self.truth: list[FloatArray] = []
        made = []
        for _ in range(shots):
            # The platform states the pose without what all shots share of it.
            departure = 3.0 * UNITS * random.standard_normal(POSE)
            departure[:3] += self.shared[LENS : LENS + 3]
            departure[6] += self.shared[LENS + 3]
            pose = ORIGIN.moved(departure)
            air = random.standard_normal(AIR)
            own, images = [], []
            for head in self.heads:
                rows = random.standard_normal((PIXELS, POSE + LENS + OWN + AIR))
                rows[:, :POSE] /= UNITS
                origin = ORIGIN.of_camera(head)
                of_image = 2.0 * random.standard_normal(OWN)
                unknowns = np.concatenate([origin.step_to(pose.of_camera(head)), self.shared[:LENS], of_image, air])
                noise = random.standard_normal(PIXELS)
                noise[: int(outliers * PIXELS)] += 40.0
                images.append(ToyImage(rows, curve(rows @ unknowns)[0] + noise, origin, curve))
                own.append(of_image)
            self.truth.append(np.concatenate([departure, *own, air]))
            first = ShotState(ORIGIN, tuple(np.full(OWN, start) for _ in self.heads), np.zeros(AIR))
            made.append(Shot(self._chooser(images), ShotPrior(ORIGIN, self.information), first, self.heads))
        self.bundle.shots = made

    @staticmethod
    def _chooser(images: list[ToyImage]) -> Callable[..., Chosen]:
        columns = [np.arange(AIR)] * len(images)
        return lambda state, lens, most, tighter, before: Chosen(images, columns, state)

    def errors(self, k: int = 0) -> FloatArray:
        """Return what is found less what is true of a shot's pose, own unknowns and air."""
        state = self.bundle.shots[k].state
        return np.concatenate([ORIGIN.step_to(state.pose), *state.own, state.air]) - self.truth[k]

    def dense(self) -> FloatArray:
        """Return the covariance of all unknowns, the shared ones first, by one inverse of the whole normal matrix."""
        of_shot = POSE + OWN * len(self.heads) + AIR
        sigmas = self.bundle.sigmas
        normal = np.zeros((SHARED + of_shot * len(self.truth),) * 2)
        normal[:SHARED, :SHARED] = np.diag(np.where(sigmas > 0.0, 1.0 / np.maximum(sigmas, 1e-15) ** 2, 1e30))
        for k, shot in enumerate(self.bundle.shots):
            at = SHARED + of_shot * k
            to_prior = np.zeros((POSE, len(normal)))
            to_prior[:, at : at + POSE] = np.eye(POSE)
            to_prior[:3, LENS : LENS + 3], to_prior[6, LENS + 3] = -np.eye(3), -1.0
            normal += to_prior.T @ self.information @ to_prior
            last = at + of_shot
            normal[range(last - AIR, last), range(last - AIR, last)] += 1.0
            assert shot.chosen is not None
            assert shot.seen is not None
            for j, (head, look, noise) in enumerate(zip(self.heads, shot.seen.looks, shot.noises, strict=True)):
                to_image = np.zeros((POSE + LENS + OWN + AIR, len(normal)))
                to_image[:3, at : at + 3] = head
                to_image[3:POSE, at + 3 : at + POSE] = np.eye(4)
                to_image[POSE : POSE + LENS, :LENS] = np.eye(LENS)
                own = at + POSE + OWN * j
                to_image[POSE + LENS : POSE + LENS + OWN, own : own + OWN] = np.eye(OWN)
                to_image[POSE + LENS + OWN :, last - AIR : last] = np.eye(AIR)
                rows = look.by_unknowns @ to_image  # type: ignore[attr-defined]
                normal += rows.T @ (noise.weights(look.residuals)[:, None] * rows)
        size = np.sqrt(np.diag(normal))
        return np.asarray(np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size))


SIGMAS = np.array([0.5, 0.5, 0.0, 0.5, 2e-5, 2e-5, 2e-5, 2.0])
"""Of the shared unknowns; one of them is exact."""


@pytest.mark.parametrize("turns", [1, 2])
def test_the_covariance_of_a_shot_is_that_of_the_dense_equations(turns: int) -> None:
    toy = Toy(1, turns=turns)
    found = solve(toy.bundle, EXACT).shots[0]
    dense, count = toy.dense()[SHARED:, SHARED:], POSE + turns * OWN
    np.testing.assert_allclose(found.covariance, dense[:count, :count], rtol=1e-5, atol=1e-9 * dense.max())
    assert found.air_open == pytest.approx(np.trace(dense[count:, count:]), rel=1e-6)
    known = np.linalg.inv(np.linalg.inv(dense)[:count, :count])
    np.testing.assert_allclose(found.known, known, rtol=1e-3, atol=1e-6 * known.max())


def test_the_covariance_of_what_shots_share_is_that_of_the_dense_equations() -> None:
    toy = Toy(2, shots=4, sigmas=SIGMAS)
    found, dense = solve(toy.bundle, EXACT), toy.dense()
    np.testing.assert_allclose(found.covariance, dense[:SHARED, :SHARED], rtol=1e-5, atol=1e-16)
    count, of_shot = POSE + OWN, POSE + OWN + AIR
    for k, shot in enumerate(found.shots):
        at = slice(SHARED + of_shot * k, SHARED + of_shot * k + count)
        through = shot.by_shared @ found.covariance
        np.testing.assert_allclose(through, dense[at, :SHARED], rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(shot.covariance + through @ shot.by_shared.T, dense[at, at], rtol=1e-4, atol=1e-9)


def test_claims_are_honest() -> None:
    """Chi-squared per degree of freedom over draws of everything: of the shared unknowns, and of a pose known to them.

    7 and 7 degrees of freedom, 60 draws: standard deviation 0.07.
    """
    squares = []
    free = SIGMAS > 0.0
    for seed in range(60):
        toy = Toy(100 + seed, shots=3, sigmas=SIGMAS)
        found = solve(toy.bundle, SolverOptions())
        error = (toy.bundle.shared - toy.shared)[free]
        pose = toy.errors()[:POSE]
        by_shared = found.shots[0].by_shared[:POSE]
        covariance = found.shots[0].covariance[:POSE, :POSE] + by_shared @ found.covariance @ by_shared.T
        of_both = ((error, found.covariance[np.ix_(free, free)]), (pose, covariance))
        squares.append([one @ np.linalg.solve(claimed, one) for one, claimed in of_both])
    assert np.mean(squares, axis=0) / 7.0 == pytest.approx([1.0, 1.0], abs=0.25)


@pytest.mark.parametrize("sigmas", [None, SIGMAS], ids=["one shot", "many"])
def test_frozen_derivatives_lead_to_the_same_unknowns(sigmas: FloatArray | None) -> None:
    shots = 1 if sigmas is None else 3
    found = []
    for good in (SolverOptions().good, np.inf):
        toy = Toy(3, shots, sigmas=sigmas, curve=bent)
        solution = solve(toy.bundle, SolverOptions((Stage(tolerance=1e-4),), good=good))
        found.append(toy.errors()[: POSE + OWN] / np.sqrt(np.diag(solution.shots[0].covariance)))
    np.testing.assert_allclose(found[0], found[1], atol=1e-4)


def test_equations_are_made_three_times_where_all_is_linear(monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    equations = Shot.equations
    monkeypatch.setattr(Shot, "equations", lambda *args: made.append(1) or equations(*args))  # type: ignore[func-returns-value]
    solve(Toy(4).bundle, SolverOptions())
    assert len(made) <= 3


def test_a_tenth_of_wild_pixels_moves_nothing_by_two_sigmas() -> None:
    worst = []
    for seed in range(10):
        toy = Toy(200 + seed, outliers=0.1)
        clean = Toy(200 + seed)
        found = solve(toy.bundle, SolverOptions()).shots[0]
        solve(clean.bundle, SolverOptions())
        moved = (toy.errors() - clean.errors())[: POSE + OWN]
        worst.append(float(np.abs(moved / np.sqrt(np.diag(found.covariance))).max()))
    assert np.median(worst) < 2.0


def test_steps_that_go_too_far_are_damped() -> None:
    toy = Toy(5, curve=saturating, start=30.0)
    shot = toy.bundle.shots[0]
    shot.choose(toy.bundle.shared, None)
    assert shot.seen is not None
    before = shot.seen.merit
    solve(toy.bundle, SolverOptions(most_steps=200))
    assert toy.bundle.merit < before
    near = Toy(5, curve=saturating)
    near.bundle.shots[0].state = replace(
        near.bundle.shots[0].state, pose=ORIGIN.moved(near.truth[0][:POSE]), own=(near.truth[0][POSE : POSE + OWN],)
    )
    solve(near.bundle, SolverOptions(most_steps=200))
    assert toy.bundle.merit == pytest.approx(near.bundle.merit, abs=1.0)


def test_what_the_pixels_do_not_determine_is_an_error() -> None:
    toy = Toy(6)
    image = toy.bundle.shots[0]._chooser(toy.bundle.shots[0].state, np.zeros(LENS), None, 1.0, None).models[0]
    image.rows[:, POSE + LENS] = 0.0  # type: ignore[attr-defined]
    with pytest.raises(np.linalg.LinAlgError, match="does not determine"):
        solve(toy.bundle, SolverOptions())
    image.own_sigma = 1.0  # type: ignore[attr-defined]
    found = solve(toy.bundle, SolverOptions()).shots[0]
    assert found.covariance[POSE, POSE] == pytest.approx(1.0)
    image.values[3] = np.nan  # type: ignore[attr-defined]
    with pytest.raises(np.linalg.LinAlgError, match="no solution"):
        solve(toy.bundle, SolverOptions())
