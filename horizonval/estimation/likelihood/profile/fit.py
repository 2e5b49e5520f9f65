"""The fit of the whole profile of the limb, pose and air together: model, step, search and result.

**Model.** A pixel whose ray passes at the height ``h`` (:mod:`.pixels`), between two nodes of azimuth, is ::

    I = b + g l P_s(h - H + c (s^2 + 1/12)) + noise,        P = mean + sum_k a_k f_k

with the profiles of :mod:`.air`, blurred by ``s`` and a lens of sharpness ``q`` (:mod:`.blurred`), linear between the
nodes, and ``l`` the level per radiance. ``c (s^2 + 1/12)`` is the shift of a bent limb by blur. Unknown are a turn of
the camera (3), its position (3), a lift ``H`` of all air, the logarithms of the blur and of the gain ``g``, ``q``, the
background ``b``, and the unit unknowns ``z`` behind the coefficients ``a``. Every prior is rows of the same equations::

    step = (J^T W J + P)^-1 (J^T W residuals + P (m - now)),        C = (J^T W J + P)^-1

**Step**, with the air eliminated first. With the normal matrix in blocks of the shared unknowns and of the unit
unknowns of the air, priors in both, and ``A = L L^T`` (Cholesky)::

    N = [[S, M], [M^T, A]],        C_s = (S - M A^-1 M^T)^-1,        C_a = A^-1 + A^-1 M^T C_s M A^-1

``C_s`` is the covariance of the shared unknowns, ``S^-1`` the covariance if the air were known.

**Search**: damped Gauss-Newton. Images with many pixels across the limb use part of them until the last steps. The
noise depends on the unknowns, since it grows with the level. The minimised function is minus twice the log likelihood,
with the noise fitted to the residuals of every trial::

    F = sum_i (r_i^2 / v_i + ln v_i) / w_i + priors,        v = v(residuals, levels)

``w`` is the number of correlated pixels that count as one (:func:`wider`); it is larger below clouds than in clear air
above them. A step has the weights ``1 / (w v)``, with ``r + (r^2 / v - 1) (dv / dp) / 2`` in place of ``r``, the
gradient of ``F`` through the variance's dependence on the level ``p``. ``F`` has local minima with a softer lens and
more noise in place of air, because radiance above a limb that is predicted too low looks like a soft lens. The lens is
therefore fixed in the first part of the search, and the noise for one step.

**Claim.** ``C`` is the claimed covariance; the covariance of the first unknowns alone, ``(J_1^T W J_1 + P_1)^-1``,
holds if the air were known. If the air is inconsistent with its prior, the sum of squares of its unknowns exceeds the
degrees of freedom that the pixels determine, ``tr(1 - C_z)``. Where the excess is more than two standard deviations the
air's part of ``C`` is multiplied by the ratio of the two (Birge's, as in :mod:`..fit`).

Noise, also where the converter's floor cuts it off, is that of :mod:`.noise`.

**Neglected.** Correlation of residuals beyond the largest square of pixels that is tested.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.bundle import scaled_inverse
from horizonval.estimation.fit.limb import SCATTERED
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.likelihood.profile.air import NodeAir
from horizonval.estimation.likelihood.profile.knowledge import NoLimbError, ProfileFit, ProfileKnowledge
from horizonval.estimation.likelihood.profile.model import (
    BACKGROUND,
    BLUR,
    GAIN,
    POSE,
    SHARED,
    SHARPNESS,
    Equations,
    Guess,
    ProfileModel,
    Seen,
)
from horizonval.estimation.likelihood.profile.noise import PixelNoise, alike, noise_of
from horizonval.estimation.limb.picture import rounding_variance
from horizonval.geometry.camera import CameraModel


@dataclass(frozen=True)
class ProfileStep:
    """A step and the uncertainty of the shared unknowns.

    ``step``: shape (s + k,), shared unknowns, then the air's; ``gained``: predicted decrease of chi-squared;
    ``covariance``, ``known``: shape (s, s), of the shared unknowns, with unknown and with known air; ``air_open``:
    trace of the covariance of the air's unknowns, the number of them left undetermined.
    """

    step: FloatArray
    gained: float
    covariance: FloatArray
    known: FloatArray
    root: FloatArray
    by_shared: FloatArray

    @property
    def air_open(self) -> float:
        inverse = solve_triangular(self.root, np.eye(len(self.root)), lower=True, check_finite=False)
        through = inverse.T @ self.by_shared
        return float(np.sum(inverse**2)) + float(np.sum((through @ self.covariance) * through))


def step_without_air(
    shared: FloatArray, right: FloatArray, mixed: FloatArray, air: FloatArray, right_air: FloatArray
) -> ProfileStep:
    """Solve the equations of a step.

    ``shared``: shape (s, s), with priors; ``right``: shape (s,); ``mixed``: shape (s, k); ``air``: shape (k, k),
    overwritten, without the unit priors, which are added; ``right_air``: shape (k,), with the priors' gradient. Raises
    ``LinAlgError``: no solution, or undetermined unknowns.
    """
    if not (np.isfinite(shared).all() and np.isfinite(right).all() and np.isfinite(air).all()):
        raise np.linalg.LinAlgError("the fit's equations have no solution")
    count = len(shared)
    # A unit normal unknown of the air has the information 1.
    air[np.diag_indices(len(air))] += 1.0
    root = cholesky(air, lower=True, overwrite_a=True, check_finite=False)
    half = solve_triangular(root, np.concatenate([mixed, right_air[None]]).T, lower=True, check_finite=False)
    by_shared, half_air = half[:, :count], half[:, count]
    covariance = scaled_inverse(shared - by_shared.T @ by_shared)
    of_shared = covariance @ (right - by_shared.T @ half_air)
    of_air = solve_triangular(root, half_air - by_shared @ of_shared, lower=True, trans=1, check_finite=False)
    return ProfileStep(
        step=np.concatenate([of_shared, of_air]),
        gained=float(right @ of_shared + right_air @ of_air),
        covariance=covariance,
        known=scaled_inverse(shared),
        root=root,
        by_shared=by_shared,
    )


MOST_STEPS = 40
FEW_PX = 6000
"""Candidates, at least, of the pixels that a first part of the way asks for: enough to be within a tenth of a pixel."""
LOST_STEPS, LOST = 12, 0.25
"""Step after which a prediction that explains less than the given share of the pixels' variance is given up; otherwise
an image without the Earth takes all steps. Correct answers have at least 0.58 then."""
SETTLED, NEARLY_SETTLED = 0.03, 1.0
"""Squares of steps below which a search is near, and near enough to leave its first part."""
SETTLING_STEPS = 2
"""Number of steps after a step's square first falls below :data:`SETTLED`, after which the noise is fixed."""
STEADY = 0.03
"""Largest change of the log variances between steps for a settled noise."""
CONVERGED = 1e-3
"""Square of a step of the pose over its own covariance: a thirtieth of a standard deviation, and it is still taken."""
MOST_TRIALS, LEAST_SHARE, MOST_SHARE = 8, 0.1, 0.7
"""Largest number of trials along a step, and limits of the ratio between successive lengths."""
ROUNDING, WORTH = 1e-3, 0.002
"""Largest loss of merit, in squared sigmas, that counts as none, a thirtieth of a standard deviation; and smallest gain
worth a step, a twentieth of a standard deviation."""
RESELECT_PX, NEAR_PX = 1.0, 0.02
"""Way of the limb after which the pixels are chosen again: on the way, and once it is found, so that no start matters.
With 0.05, and a noise that was held after steps of 0.3 and changes of 0.1, starts a third of a pixel apart ended up to
0.2 standard deviations from each other."""
LARGEST_MOTION_M, LARGEST_MOTION_PX, LARGEST_LOG_STEP = 15e3, 3.0, 0.5
"""Largest step of the limb and of logarithms: two scale heights of the air or some pixels, the range of the
derivatives."""
GROWTH_SIGMA = 0.5
"""Prior standard deviation of ln(corner blur / axis blur)."""
MOST_GROWTH, SURE_GROWTH = 0.25, 3.0
"""Largest change of ln blur over the limb in view, and its significance. A lens with 0.6 px on the axis and 1.1 px in
the corners shows 0.36 to 0.57 and biases the nadir; one with uniform blur shows below 0.12."""
HELD = 10.0
"""Information on the lens in the first stage, relative to its prior: the lens then moves by a third of its prior's
range. Less lets thin clouds soften the lens; more increases the dependence on the start."""
PULLED, LEAST_LEARNT = 3.0, 1e-3
"""Pull of the altitude's prior, in what chance makes of it, from which the claim is widened: chance alone exceeds it in
0.3 % of frames. And share of its variance that the image must have taken away."""
LEAST_ALIKE, SURELY_ALIKE = 1.1, 1.3
"""Correlation factor between which inflation sets in; independent residuals have 1.0 to 1.1. A ramp, since a step would
displace the nadir."""


class ProfileSearch:
    """The search; results of its last step stay as attributes. ``image``: shape (H, W).

    ``least``: shape (n,), minimum variance; ``wider``: shape (n,) or 1, number of correlated pixels that count as one;
    ``inverse_variance``: shape (n,), with both; ``covariance``, ``known``: shape (11, 11), of the shared unknowns, with
    unknown and with known air; ``steps``: list of shape (7,).
    """

    def __init__(
        self,
        image: FloatArray,
        camera: CameraModel,
        start: LimbPose,
        knowledge: ProfileKnowledge,
    ) -> None:
        self.image, self.camera, self.knowledge = image, camera, knowledge
        self.steps: list[FloatArray] = []
        self.covariance = self.known = np.empty((0, 0))
        self._last: ProfileStep | None = None
        self._priors = np.array([knowledge.blur_log_sigma, knowledge.sharpness_sigma, knowledge.gain_log_sigma]) ** -2.0
        self._choose(start, knowledge.blur_px, FEW_PX)
        now = Guess(np.zeros(POSE), knowledge.blur_px, knowledge.sharpness, 1.0, 0.0, np.zeros(self.model.air.count))
        self.now = self._with_levels(now)
        self.look = self.model.look(self.now)
        self._weigh()

    @property
    def pose(self) -> LimbPose:
        """Pose of the present unknowns."""
        return self.model.pose.moved(self.now.away)

    def run(self) -> ProfileSearch:
        """Search; raises ``LinAlgError`` without convergence, without resemblance, or for undetermined unknowns."""
        settled, size = 0, np.inf
        for number in range(MOST_STEPS):
            if number >= LOST_STEPS and explained(self.model, self.look, self.noise) < LOST:
                raise NoLimbError(f"the predicted limb explains less than {LOST:.0%} of the pixels where it should be")
            step, gained = self._step()
            size = float(step[:POSE] @ np.linalg.solve(self.covariance[:POSE, :POSE], step[:POSE]))
            held = settled >= SETTLING_STEPS
            if held and size < CONVERGED and gained < 1.0:
                self._take(step, self.now.moved(step))
                return self
            improved = self._search_along(step, gained)
            if held:
                if not improved:
                    return self
                continue
            near = size < (NEARLY_SETTLED if self._few else SETTLED) or not improved
            away_px = self.model.motion_px(self.now.away)
            if (near and self._few) or away_px > (NEAR_PX if near else RESELECT_PX):
                self._choose_again(thinned=self._few and not near)
            changed = self._weigh()
            settled = settled + 1 if near and changed < STEADY else 0
        if size > 1.0:
            raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps")
        # The claim is that of the noise as it is now.
        self._step()
        return self

    def strain(self) -> tuple[float, float]:
        """Return the sum of squares of the air's unit unknowns and its expectation.

        The expectation is the number that the pixels determine, the trace of 1 - C, with ``C`` their covariance.
        """
        assert self._last is not None
        return float(self.now.air @ self.now.air), len(self.now.air) - self._last.air_open

    def pulled(self) -> FloatArray:
        """Return what the image has against the altitude that is known, as a covariance of the pose, shape (7, 7).

        The altitude has moved by ``d`` from a prior of sigma ``s``, and is left with ``p``. By chance ``d`` has the
        variance ``s^2 - p^2``; beyond :data:`PULLED` of its roots the prior is taken to be as wrong as the image says,
        ``d s^2 / (s^2 - p^2)``, and the claim has what this makes of the pose.
        """
        up = np.zeros(POSE)
        up[3:6] = self.pose.r_itrs / np.linalg.norm(self.pose.r_itrs)
        information = float(up @ self.knowledge.information @ up)
        along = self.covariance[:POSE, :POSE] @ up
        left = float(up @ along)
        learnt = 1.0 / information - left if information > 0.0 else 0.0
        moved = -float(up @ self._wanted()[:POSE])
        if not learnt > LEAST_LEARNT / information or abs(moved) <= PULLED * np.sqrt(learnt):
            return np.zeros((POSE, POSE))
        wrong = moved / information / learnt * along / left
        return np.outer(wrong, wrong)

    def growth(self) -> tuple[float, float]:
        """Return the change of ln blur over the limb in view, and its standard deviation.

        Lenses soften towards the corners as the angle squared. It is no unknown: this is the step if it were one.
        """
        pull = self.noise.pull(self.look.residuals, self.now.gain)
        parts = self.model.equations(self.now, self.look, self.inverse_variance, pull, of_growth=True)
        parts.shared[-1, -1] += GROWTH_SIGMA**-2
        found, over = self._solved(parts), float(np.ptp(self.model.off_axis))
        return over * float(found.step[SHARED]), over * float(np.sqrt(found.covariance[SHARED, SHARED]))

    def _choose(self, pose: LimbPose, blur: float, most: int | None) -> None:
        self._few = most is not None
        self.model = ProfileModel(self.image, self.camera, pose, blur, self.knowledge, most)
        self.inverse_variance = np.ones_like(self.model.near.values)
        self._wanted_pose = pose.step_to(self.knowledge.mean)

    def _choose_again(self, *, thinned: bool) -> None:
        """Select the pixels at the present pose; noise and weights stay, since new ones would move the pose again."""
        before, weights = self.model, self.inverse_variance
        self._choose(self.pose, self.now.blur, FEW_PX if thinned else None)
        self.inverse_variance = taken_over(self.image.shape, before, weights, self.model)
        self.now = replace(self.now, away=np.zeros(POSE), air=self.model.air.taken_over(before.air, self.now.air))
        self.look = self.model.look(self.now)

    def _with_levels(self, now: Guess) -> Guess:
        """Return the unknowns with the gain and background that fit best."""
        bare = self.model.look(replace(now, gain=1.0, background=0.0))
        light, values = bare.level * self.model.near.light, self.model.near.values
        rows = np.array([light, np.ones_like(light)])
        gain, background = np.linalg.solve(rows @ rows.T, rows @ values)
        if self.model.floor is not None:
            background = self.model.floor.background
        if not gain > 0.0:
            raise NoLimbError("the image is not brighter where the limb's profile is")
        return replace(now, gain=float(gain), background=float(background))

    def _step(self) -> tuple[FloatArray, float]:
        """Return a step within the reach of the derivatives, and the merit that it should gain."""
        pull = None if self._few else self.noise.pull(self.look.residuals, self.now.gain)
        found = self._solved(self.model.equations(self.now, self.look, self.inverse_variance, pull))
        self.known, self.covariance, self._last = found.known, found.covariance, found
        step = found.step
        most_px = max(LARGEST_MOTION_M / float(np.median(self.model.near.width_m)), LARGEST_MOTION_PX)
        over = max(
            self.model.motion_px(step) / most_px, float(np.abs(step[[BLUR, GAIN]]).max()) / LARGEST_LOG_STEP, 1.0
        )
        return step / over, found.gained / over**2

    def _solved(self, parts: Equations) -> ProfileStep:
        """Return the step that equations ask for, with the priors."""
        wanted = self._wanted()
        priors = self._priors * np.array([HELD, HELD, 1.0]) if self._few else self._priors
        shared, right = parts.shared.copy(), parts.right
        shared[:POSE, :POSE] += self.knowledge.information
        shared[[BLUR, SHARPNESS, GAIN], [BLUR, SHARPNESS, GAIN]] += priors
        right[:POSE] += self.knowledge.information @ wanted[:POSE]
        right[[BLUR, SHARPNESS, GAIN]] += priors * wanted[POSE:]
        away, information = self._off_floor(self.now)
        shared[BACKGROUND, BACKGROUND] += information
        right[BACKGROUND] += information * away
        return step_without_air(shared, right, parts.mixed, parts.air, parts.right_air - self.now.air)

    def _search_along(self, step: FloatArray, gained: float) -> bool:
        """Go along a step while the likelihood grows; return whether it did.

        Where less than half of the predicted merit ``gained`` is reached, as in a bent valley, a parabola gives the
        length.
        """
        before, best, share = self._merit(self.now, self.look), np.inf, 1.0
        found: tuple[Guess, Seen, FloatArray] | None = None
        for _ in range(MOST_TRIALS):
            way = share * step
            now = self.now.moved(way)
            look = self.model.look(now)
            merit = self._merit(now, look)
            if merit < best and merit <= before + ROUNDING:
                best, found = merit, (now, look, way)
            elif found is not None:
                break
            if before - merit >= 0.5 * gained * share * (2.0 - share) - ROUNDING:
                break
            bend = (merit - before + 2.0 * gained * share) / share**2
            share = float(np.clip(gained / bend, LEAST_SHARE * share, MOST_SHARE * share))
        # Nothing on the way is better: the best place is this one, to rounding.
        self.now, self.look, way = found or (self.now, self.look, np.zeros_like(step))
        self.steps.append(way[:POSE])
        return before - best > WORTH

    def _take(self, step: FloatArray, now: Guess) -> None:
        self.steps.append(step[:POSE])
        self.now, self.look = now, self.model.look(now)

    def _weigh(self) -> float:
        """Estimate the noise by the residuals as they are; return by how much the weights' logarithms changed (rms)."""
        before = self.inverse_variance
        self.least = least_variance(self.model, self.now, self.look)
        self.noise = noise_at(self.model, self.look, before, self.least)
        self.wider = 1.0 if self._few else wider(self.model, self.now, self.look, self.noise)
        self.inverse_variance = self.noise.inverse_variance / self.wider
        both = (before > 0.0) & (self.inverse_variance > 0.0)
        return float(np.sqrt(np.mean(np.log(self.inverse_variance[both] / before[both]) ** 2)))

    def _merit(self, now: Guess, look: Seen) -> float:
        wanted = self._wanted(now)
        if self._few:
            squares = float(self.inverse_variance @ look.residuals**2)
        else:
            noise = noise_at(self.model, look, self.inverse_variance, self.least)
            squares = noise.improbability(look.residuals, self.wider)
        squares += float(now.air @ now.air)
        squares += float(wanted[:POSE] @ self.knowledge.information @ wanted[:POSE])
        away, information = self._off_floor(now)
        return squares + float(self._priors @ wanted[POSE:] ** 2) + information * away**2

    def _off_floor(self, now: Guess) -> tuple[float, float]:
        """Return the step of the background towards dark pixels at the floor, and its information."""
        floor = self.model.floor
        return (0.0, 0.0) if floor is None else (floor.background - now.background, floor.sigma**-2)

    def _wanted(self, now: Guess | None = None) -> FloatArray:
        """Return the step to the priors' values: of the pose, and of blur, sharpness and gain."""
        now, known = now or self.now, self.knowledge
        beside = [np.log(known.blur_px / now.blur), known.sharpness - now.sharpness, np.log(known.gain / now.gain)]
        return np.concatenate([self._wanted_pose - now.away, beside])


def taken_over(shape: tuple[int, ...], before: ProfileModel, weights: FloatArray, after: ProfileModel) -> FloatArray:
    """Return the weights that an image's pixels had in another model; new ones are as good as the median one."""
    by_pixel = np.full(shape, float(np.median(weights[weights > 0.0])))
    by_pixel[before.near.pixels.rows, before.near.pixels.columns] = weights
    return by_pixel[after.near.pixels.rows, after.near.pixels.columns]


def uneven_lens(growth: float, sigma: float) -> str | None:
    """Return what is wrong with a lens whose blur's logarithm changes by ``growth`` over the limb, if anything is."""
    if abs(growth) <= max(MOST_GROWTH, SURE_GROWTH * sigma):
        return None
    return f"the lens is {np.expm1(abs(growth)):.0%} softer at one part of the limb than at another"


def explained(model: ProfileModel, look: Seen, noise: PixelNoise) -> float:
    """Return the share of the pixels' variance that the prediction explains, outliers apart; of none it explains 0."""
    values, residuals = model.near.values[noise.used], look.residuals[noise.used]
    whole = float(np.sum((values - values.mean()) ** 2))
    return 1.0 - float(np.sum(residuals**2)) / whole if whole > 0.0 else 0.0


def least_variance(model: ProfileModel, now: Guess, look: Seen) -> FloatArray:
    """Return the variance that there is at least, shape (n,): of rounding, and of what the prediction leaves out."""
    return np.asarray(rounding_variance(model.near.values) + model.neglected(now, look) ** 2)


def noise_at(model: ProfileModel, look: Seen, before: FloatArray, least: FloatArray) -> PixelNoise:
    """Return the noise of the pixels by their residuals; ``before``: inverse variances so far, 0 of outliers."""
    light = model.near.light
    per_px = light * look.changes[0] * model.width_m
    clouds = light * look.brightest * model.below_clouds
    return noise_of(look.residuals, light * look.level, clouds, per_px, before > 0.0, least)


def wider(model: ProfileModel, now: Guess, look: Seen, noise: PixelNoise) -> FloatArray:
    """Return how many correlated pixels count as one, shape (n,).

    Residuals beyond the dark pixels' noise have the correlation that their sums over squares show (:func:`.alike`);
    neglected bumps have a bump's height and length. Neither is an unknown of the fit.
    """
    beyond = alike(model.near.pixels, look.residuals, noise.inverse_variance)
    counts = float(np.clip((beyond - LEAST_ALIKE) / (SURELY_ALIKE - LEAST_ALIKE), 0.0, 1.0))
    shown = noise.shown / max(float(noise.shown[noise.used].mean()), 1e-300)
    left = np.minimum(model.neglected(now, look) ** 2 / noise.variance, 1.0)
    return np.asarray(1.0 + counts * (beyond - 1.0) * shown + (model.left_alike - 1.0) * left)


def fit_profile(
    image: FloatArray,
    camera: CameraModel,
    start: LimbPose,
    knowledge: ProfileKnowledge,
) -> ProfileFit:
    """Fit the limb's profile near a pose that is right to some kilometres of height at the limb.

    ``image``: shape (H, W), linear in radiance, NaN where missing. Raises ``LinAlgError``: too little limb in view, no
    radiance there, or no convergence.
    """
    found = ProfileSearch(image, camera, start, knowledge).run()
    look, now = found.look, found.now
    uv, off = by_sector(found.model, look, now, found.inverse_variance)
    growth, growth_sigma = found.growth()
    of_air = (found.covariance - found.known)[:POSE, :POSE] * strained(*found.strain()) + found.pulled()
    return ProfileFit(
        pose=found.pose,
        blur_px=now.blur,
        gain=now.gain,
        background=now.background,
        covariance=found.known[:POSE, :POSE] + of_air,
        relief_covariance=of_air,
        improbable=improbable(found.model.air, now.air),
        explained=explained(found.model, look, found.noise),
        uv=uv,
        residuals_rad=off,
        steps=np.array(found.steps),
        growth=growth,
        growth_sigma=growth_sigma,
    )


def strained(squares: float, determined: float) -> float:
    """Return the excess scatter of unit unknowns, 1 if chance explains it.

    ``squares``: their sum of squares; ``determined``: their number, the mean of ``squares`` and half its variance.
    """
    ratio = squares / max(determined, 1e-300)
    return ratio if determined > 0.0 and ratio > 1.0 + SCATTERED * np.sqrt(2.0 / determined) else 1.0


def improbable(air: NodeAir, unknowns: FloatArray) -> float:
    """Return the largest coefficient of any function of the air in its own standard deviations."""
    sizes = [float(np.sqrt((wave**2).sum(axis=1).max())) for wave in air.waves]
    largest = np.abs(air.coefficients(unknowns)[:, 1:]).max(axis=0)
    return float(np.max(largest / np.array(sizes)))


def by_sector(
    model: ProfileModel, look: Seen, now: Guess, inverse_variance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a place on the limb for every sector, and by how much its pixels would have the limb farther in [rad]."""
    near = model.near
    # The lift lowers all distances across the limb alike.
    per_rad = -now.gain * near.light * look.kept * look.changes[0] * model.by_pose[6] * near.ray.distance_m
    weights = inverse_variance * per_rad
    uv, off = [], []
    for first, last in pairwise(near.starts):
        here = slice(first, last)
        information = float(weights[here] @ per_rad[here])
        off.append(-float(weights[here] @ look.residuals[here]) / information if information > 0.0 else 0.0)
        nearest = first + int(np.argmin(np.abs(near.ray.height_m[here])))
        uv.append([near.pixels.columns[nearest], near.pixels.rows[nearest]])
    return np.array(uv, dtype=float), np.array(off)
