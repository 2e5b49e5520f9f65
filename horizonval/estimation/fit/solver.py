"""The solver of all fits: damped Gauss-Newton on a bundle of shots, in stages.

The residuals' derivatives are computed at the first step of a stage and again after a long step, or one that does not
gain what they predict. In between they are frozen, a step costs one look at the pixels and one product, and the changes
of the gradient along the last steps stand in for the second derivatives that the equations neglect. The noise is
estimated again after every step down to one of a standard deviation; from then on the variances are held, since a
minimum is that of one function.

**Stages** are data: how many pixels take part, whether the lens may change, how near the end must be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.progress import Progress, Silent
from horizonval.estimation.fit.bundle import (
    Bundle,
    Curvature,
    Seen,
    ShotEquations,
    ShotSolution,
    Solved,
    Step,
    right_sides,
)
from horizonval.estimation.fit.image import POSE, ShotState

MEMORY = 4
"""Number of curvatures, beside the last one, that correct a step."""


@dataclass(frozen=True)
class Stage:
    """A part of the way to the most probable unknowns.

    ``pixels``: about how many per image, None for all; ``tighter``: factor on the priors' information on the blur,
    above 1 where the lens is held at first; ``tolerance``: motion of nadir and altitude, in their claimed standard
    deviations, that ends the stage; ``reselect_px``: motion of the limb after which the pixels are chosen again;
    ``settle``: whether the noise is estimated again on the way.
    """

    pixels: int | None = None
    tighter: float = 1.0
    tolerance: float = 0.05
    reselect_px: float = 0.5
    settle: bool = True


@dataclass(frozen=True)
class SolverOptions:
    """Settings of the solver.

    ``stages``: see :class:`Stage`; ``most_steps``: per stage; ``steady``: change of the log variances up to which the
    noise is held from within a standard deviation on; ``most_weighs``: how often it is estimated in a stage;
    ``reweighed``: change up to which derivatives stay frozen; ``good``: share of the predicted gain above which they
    do; ``frozen``: predicted gain up to which they do [sigma^2]; ``most_cuts``, ``least_share``: how often a step that
    gains nothing is shortened, and to which share of it; ``rounding``: loss of merit that counts as none [sigma^2].
    """

    stages: tuple[Stage, ...] = (Stage(),)
    most_steps: int = 30
    steady: float = 0.1
    most_weighs: int = 8
    reweighed: float = 0.5
    good: float = 0.7
    frozen: float = np.inf
    most_cuts: int = 8
    least_share: float = 0.1
    rounding: float = 1e-3


@dataclass(frozen=True)
class Solution:
    """The most probable unknowns of a bundle are its state; this is their uncertainty.

    ``covariance``: shape (8, 8), of the shared unknowns; ``shots``: of every shot; ``steps``: of every shot's pose,
    shape (k, 7) each; ``equations``, ``solved``: those that it is from.
    """

    covariance: FloatArray
    shots: Sequence[ShotSolution]
    steps: Sequence[FloatArray]
    equations: Sequence[ShotEquations]
    solved: Solved


def solve(bundle: Bundle, options: SolverOptions, progress: Progress | None = None) -> Solution:
    """Move a bundle to its most probable unknowns.

    Raises ``LinAlgError``: too little limb in view, undetermined unknowns, or no convergence.
    """
    return _Search(bundle, options, progress or Silent()).run()


class _Search:
    def __init__(self, bundle: Bundle, options: SolverOptions, progress: Progress) -> None:
        self.bundle, self.options, self.progress = bundle, options, progress
        self.steps: list[list[FloatArray]] = [[] for _ in bundle.shots]
        self.moved_px = 0.0

    def run(self) -> Solution:
        for stage in self.options.stages:
            equations, solved = self._stage(stage, last=stage is self.options.stages[-1])
        shots = [solved.of_shot(k, one) for k, one in enumerate(equations)]
        steps = [np.array(one).reshape(-1, POSE) for one in self.steps]
        return Solution(solved.covariance, shots, steps, equations, solved)

    def _stage(self, stage: Stage, *, last: bool) -> tuple[Sequence[ShotEquations], Solved]:
        """Go one stage of the way; return the equations before the last step, which is short, and their solution."""
        options, bundle = self.options, self.bundle
        self._choose(stage)
        equations: list[ShotEquations] = []
        solved: Solved | None = None
        before: Step | None = None
        curvatures: list[Curvature] = []
        settled, square, weighs = not stage.settle, np.inf, 0
        for number in range(options.most_steps):
            fresh = solved is None
            if solved is None:
                equations = self._equations()
                solved = Solved(bundle, equations)
            else:
                equations = [one.again(bundle.shared) for one in equations]
            sides = right_sides(bundle, equations)
            if before is not None:
                curvature = Curvature.between(before, sides)
                curvatures = curvatures if curvature is None else [*curvatures[-MEMORY:], curvature]
            step = solved.step(sides, curvatures)
            square, bounded = step.square, self._bounded(step)
            gain = self._try(bounded)
            short = square < stage.tolerance**2 and (not last or step.gained < len(bundle.shots))
            if short and (settled or not last):
                if fresh or not last or all(one.exact for one in equations):
                    return equations, solved
                # Derivatives of elsewhere end a few hundredths of a sigma from the best unknowns.
                solved, before = None, None
                continue
            cuts = 0
            while gain < -options.rounding:
                if not fresh:
                    equations, fresh, curvatures = self._equations(), True, []
                    solved = Solved(bundle, equations)
                    bounded = self._bounded(solved.step(right_sides(bundle, equations)))
                elif cuts == options.most_cuts:
                    # Nothing near is better: the best place is this one, to rounding.
                    return equations, solved
                else:
                    # The parabola through this merit and the present one, with the slope that the equations predict.
                    cuts += 1
                    share = bounded.gained / (2.0 * bounded.gained - gain)
                    bounded = bounded.shortened(float(np.clip(share, options.least_share, 0.5)))
                gain = self._try(bounded)
            before = bounded
            self.progress.step("fit", f"step {number + 1} of at most {options.most_steps}, {np.sqrt(square):.2g} sigma")
            if gain < options.good * bounded.gained - options.rounding or bounded.gained > options.frozen:
                solved = None
            if cuts > 1 and last and gain < stage.tolerance and self.moved_px < options.least_share * stage.reselect_px:
                # A valley too bent for equations to follow, whose floor is level (a limb that is nearly hard).
                return equations, Solved(bundle, equations)
            # Pixels of elsewhere may be why a step gains nothing.
            if self.moved_px > stage.reselect_px or cuts > 1:
                self._choose(stage)
                solved, before, curvatures = None, None, []
            elif not settled:
                # A minimum is that of one function: from within a standard deviation on the noise is held.
                change = self._weigh()
                weighs += 1
                # Two estimates may follow each other by turns.
                settled = (bounded.square < 1.0 and change < options.steady) or weighs >= options.most_weighs
                # Slopes by other weights say nothing of the curvature.
                before, curvatures = None, []
                solved = None if change > options.reweighed else solved
        if square > 1.0:
            raise np.linalg.LinAlgError(f"no convergence in {options.most_steps} steps")
        return equations, Solved(bundle, equations)

    def _weigh(self) -> float:
        """Estimate the noise again; return the largest change of a shot's."""
        return max(shot.weigh(self.bundle.shared) for shot in self.bundle.shots)

    def _choose(self, stage: Stage) -> None:
        for shot in self.bundle.shots:
            shot.choose(self.bundle.shared, stage.pixels, stage.tighter)
        self.moved_px = 0.0

    def _equations(self) -> list[ShotEquations]:
        return [shot.equations(self.bundle.shared, self.bundle.free) for shot in self.bundle.shots]

    def _bounded(self, step: Step) -> Step:
        """Return a step within the reach of the derivatives."""
        parts = zip(self.bundle.shots, step.of_shots, strict=True)
        over = max(shot.reach(own, step.of_shared) for shot, (own, _) in parts)
        return step if over <= 1.0 else step.shortened(1.0 / over)

    def _try(self, step: Step) -> float:
        """Take a step if it makes nothing worse; return by how much the merit falls."""
        bundle, before = self.bundle, self.bundle.merit
        old: list[tuple[ShotState, Seen | None]] = [(shot.state, shot.seen) for shot in bundle.shots]
        old_shared = bundle.shared
        bundle.shared = bundle.shared + step.of_shared
        for shot, (own, air) in zip(bundle.shots, step.of_shots, strict=True):
            state = shot.moved(own, air)
            shot.seen = shot.look(state, bundle.shared)
            shot.state = state
        gain = before - bundle.merit
        if not gain >= -self.options.rounding:
            bundle.shared = old_shared
            for shot, (state, seen) in zip(bundle.shots, old, strict=True):
                shot.state, shot.seen = state, seen
            return -np.inf if np.isnan(gain) else gain
        moved = 0.0
        for shot, (own, _), steps in zip(bundle.shots, step.of_shots, self.steps, strict=True):
            steps.append(own[:POSE])
            moved = max(moved, shot.motion_px(own, step.of_shared))
        self.moved_px += moved
        return gain
