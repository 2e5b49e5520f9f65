r"""The pose, and the air, that make the pixels of the limb's whole profile most probable: Gauss-Newton.

A pixel whose ray passes at the height ``h`` (:mod:`.ray_height`), between two nodes of azimuth, is ::

    I = b + g l P_s(h - H + c (s^2 + 1/12)) + noise,        P = mean + sum_k a_k f_k

with the profiles of :mod:`.air`, blurred by ``s`` and a lens as sharp as ``q`` (:mod:`.blurred`), linear between the
nodes, and ``l`` the light that the pixel gets of a radiance. ``c (s^2 + 1/12)`` is what a blur of lens and pixel makes
of a bent limb. Unknown are a turn of the camera (3), its position (3), a lift ``H`` of all air, the logarithms of the
blur and of the gain ``g``, ``q``, the background ``b``, and the unit unknowns ``z`` behind the coefficients ``a``.
Every prior is rows of the same equations::

    step = (J^T W J + P)^-1 (J^T W residuals + P (m - now)),        C = (J^T W J + P)^-1

``C`` is what is claimed; of it the part of the first unknowns alone, ``(J_1^T W J_1 + P_1)^-1``, is what it would be if
the air were known.

The variance of the noise is that of dark pixels and three parts that least squares find in the residuals: one as
bright as the pixel (photons), one as its square where clouds can be, one as the slope's square (what a lens does that
the model has not). Pixels further off than five standard deviations are left out (stars, hot pixels).

Where neighbouring residuals are alike (clouds, and what else no mode has), all variances are larger by how much more
their sums over squares scatter than independent ones would, of the size of squares where that is most.

**Neglected.** That residuals may be alike over more than the largest square.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.edge_profile import PIXEL_VARIANCE
from horizonval.estimation.likelihood.knowledge import LimbPose
from horizonval.estimation.likelihood.profile.air import NodeAir
from horizonval.estimation.likelihood.profile.blurred import BlurredProfiles
from horizonval.estimation.likelihood.profile.pixels import profile_pixels
from horizonval.estimation.likelihood.profile.ray_height import RayHeight, level_distance, ray_height
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import Ellipsoid

POSE = 7
"""Turn, position, lift."""
BLUR, SHARPNESS, GAIN, BACKGROUND, SHARED = 7, 8, 9, 10, 11
"""Places of the other shared unknowns, and how many there are."""
MOST_STEPS, FREE_STEPS = 40, 24
"""Of these so many without the noise held."""
SETTLED = 0.3
SETTLING_STEPS = 2
"""Steps of a square below the first, after which the noise is held: what a pose that is not there yet leaves would be
taken for noise. From then on a step that makes the pixels less probable is halved."""
STEADY = 0.1
"""Of the logarithm of the noise's variance from step to step: what a first guess leaves is no noise."""
CONVERGED = 1e-2
"""Square of a step of the pose over its own covariance: a tenth of a standard deviation, and it is still taken."""
MOST_HALVINGS = 8
RESELECT_PX, NEAR_PX = 1.0, 0.05
"""Way of the limb after which the pixels are chosen again: on the way, and once it is found, so that no start matters.
"""
LARGEST_MOTION_M, LARGEST_MOTION_PX, LARGEST_LOG_STEP = 15e3, 3.0, 0.5
"""Of the limb and of the logarithms: two scale heights of the air or some pixels, beyond which derivatives mislead."""
LEAST_GAIN = 0.2
"""Of the gain, that a step leaves of it."""
OUTLIER = 5.0
WEIGHINGS = 3
"""Rounds in which what counts as an outlier and the noise agree."""
CLOUD_TOP_M = 16e3
"""Of the tropics: clouds are below."""
DARK_LEVEL, BRIGHT_LEVEL = 0.05, 0.5
FEWEST_PIXELS = 20
NORMAL_QUARTILE = 0.67448975
DEPTH_M, DEPTH_PX = 0.0, 0.5
"""Of the window below the ground, at least. Lines that end farther before the limb see other air, ground and clouds
than those that pass it: with 40 km and four pixels errors of 8 to 14 um were twice as large."""
SPACE_PX = 4.0
"""Of the window above the air, at least."""
GRID_RIMS = 2.0
"""Of the grid of heights beyond the window, in rims: the grid's ends are then five blurs away, and a lift more."""
FINEST_STEP_M, STEPS_PER_PIXEL = 250.0, 32.0
"""Of the grid of heights: a thirtieth of the scale height of the air, or a twentieth of the blur."""
ALIKE_PX = (4, 8, 16, 32)
"""Sides of the squares over which residuals are summed: what clouds and the spread between neighbours make alike."""
LEAST_ALIKE = 1.2
"""Of independent residuals it is 1 to a tenth."""
EDGE_BLURS = 2.5
"""Of the table's ends, in blurs: nearer pixels see what lies beyond."""


@dataclass(frozen=True)
class ProfileKnowledge:
    """What is known beside the image.

    Attributes
    ----------
    ellipsoid : Ellipsoid
    mean : LimbPose
        The priors' values; ``height_m`` is the lift of the air.
    information : ndarray, shape (7, 7)
        About ``mean`` of a step from it, as in :class:`horizonval.estimation.likelihood.knowledge.LimbKnowledge`.
    heights_m : tuple of float
        First and last height of the table.
    air : callable
        From normals (m, 3) and lines of sight (m, 3) in camera axes, a pose, and a grid of distances across the limb
        (first, last, step) with their curve, to the air.
    blur_px, blur_log_sigma : float
        Of the lens.
    sharpness, sharpness_sigma : float
        Of the lens, as :mod:`.blurred` has it: nobody says it of a lens.
    gain, gain_log_sigma : float
        Levels per radiance of the table on the axis; an infinite sigma where the detector is not calibrated.
    """

    ellipsoid: Ellipsoid
    mean: LimbPose
    information: FloatArray
    heights_m: tuple[float, float]
    air: Callable[[FloatArray, FloatArray, LimbPose, tuple[float, float, float], float], NodeAir]
    blur_px: float = 0.7
    blur_log_sigma: float = 0.3
    sharpness: float = 0.5
    sharpness_sigma: float = 0.5
    gain: float = 1.0
    gain_log_sigma: float = np.inf


@dataclass(frozen=True)
class ProfileFit:
    """The most probable pose.

    Attributes
    ----------
    pose : LimbPose
    blur_px, gain, background : float
    covariance : ndarray, shape (7, 7)
        Of a step from the pose: noise, priors and air.
    relief_covariance : ndarray, shape (7, 7)
        The air's part of it.
    chi_squared : float
        Mean square of the residuals over the variance that neighbouring pixels show; NaN if that is not known.
    improbable : float
        Largest coefficient of a mode anywhere along the limb, in its own standard deviations.
    explained : float
        Share of the pixels' variance that the prediction explains.
    uv : ndarray, shape (m, 2)
    residuals_rad : ndarray, shape (m,)
    steps : ndarray, shape (k, 7)
    """

    pose: LimbPose
    blur_px: float
    gain: float
    background: float
    covariance: FloatArray
    relief_covariance: FloatArray
    chi_squared: float
    improbable: float
    explained: float
    uv: FloatArray
    residuals_rad: FloatArray
    steps: FloatArray


@dataclass(frozen=True)
class _Guess:
    pose: LimbPose
    blur: float
    sharpness: float
    gain: float
    background: float
    air: FloatArray

    def moved(self, step: FloatArray) -> _Guess:
        # Brightness is a product of gain and air: taken like this, it moves as the derivatives say, however far.
        brighter = max(1.0 + float(step[GAIN]), LEAST_GAIN)
        return _Guess(
            self.pose.moved(step[:POSE]),
            self.blur * float(np.exp(step[BLUR])),
            self.sharpness + float(step[SHARPNESS]),
            self.gain * brighter,
            self.background + float(step[BACKGROUND]),
            self.air + step[SHARED:] / brighter,
        )


@dataclass(frozen=True)
class _Seen:
    """The pixels as the present unknowns say they are; ``by_height`` is the change of the distance across the limb."""

    ray: RayHeight
    by_height: FloatArray
    weights: FloatArray
    place: np.ndarray
    share: FloatArray
    level: FloatArray
    slope: FloatArray
    residuals: FloatArray


class _ProfileSearch:
    """The way from the start to the most probable unknowns."""

    def __init__(self, image: FloatArray, camera: CameraModel, start: LimbPose, knowledge: ProfileKnowledge) -> None:
        self.image, self.camera, self.knowledge = image, camera, knowledge
        self.steps: list[FloatArray] = []
        self._select(start, knowledge.blur_px)
        self.now = _Guess(start, knowledge.blur_px, knowledge.sharpness, 1.0, 0.0, np.zeros(self.air.count))
        self.now = self._with_levels(self.now)
        self.look = self._look(self.now)
        self._weigh()
        self.covariance = np.empty((0, 0))
        self.normal = np.empty((0, 0))

    def _select(self, pose: LimbPose, blur: float) -> None:
        low, high = self.knowledge.heights_m
        axes = self.knowledge.ellipsoid.axes_m
        pixel_m = np.sqrt(max(pose.r_itrs @ pose.r_itrs - axes[0] ** 2, 1.0)) / max(self.camera.fx, self.camera.fy)
        rim = EDGE_BLURS * float(np.sqrt(blur**2 + PIXEL_VARIANCE)) * pixel_m
        bottom = max(low + rim, pose.height_m - max(DEPTH_M, DEPTH_PX * pixel_m))
        top = high + max(rim, SPACE_PX * pixel_m) + pose.height_m
        self.curve = 0.5 * axes[0] / max(float(pose.r_itrs @ pose.r_itrs - axes[0] ** 2), 1.0)
        self.near = profile_pixels(self.image, self.camera, pose, self.knowledge.ellipsoid, (bottom, top), self.curve)
        ends, _ = level_distance(np.array([bottom, top]), self.curve)
        grid = (ends[0] - GRID_RIMS * rim, ends[1] + GRID_RIMS * rim, max(FINEST_STEP_M, pixel_m / STEPS_PER_PIXEL))
        self.air = self.knowledge.air(self.near.normal_cam, self.near.los_cam, pose, grid, self.curve)
        self.inverse_variance = np.ones_like(self.near.values)
        self.tables = BlurredProfiles(self.air.functions, self.air.step_m, self.near.boxes_m)

    def _with_levels(self, now: _Guess) -> _Guess:
        """Return the unknowns with the gain and background that fit best."""
        bare = self._look(replace(now, gain=1.0, background=0.0))
        rows = np.array([bare.level * self.near.light, np.ones_like(bare.level)])
        gain, background = np.linalg.lstsq(rows.T, self.near.values, rcond=None)[0]
        if not gain > 0.0:
            raise np.linalg.LinAlgError("the image is not brighter where the limb's profile is")
        return replace(now, gain=float(gain), background=float(background))

    def run(self) -> _ProfileSearch:
        """Search; what the last step knew stays as attributes."""
        settled, away_px, size, spread, changed = 0, 0.0, np.inf, False, np.inf
        merit = self._merit(self.now, self.look)
        for _ in range(MOST_STEPS):
            matrix, right = self._equations()
            self.normal, self.covariance = matrix, _inverse(matrix)
            step = self._bounded(self.covariance @ right)
            held = spread or settled >= SETTLING_STEPS or len(self.steps) >= FREE_STEPS
            pose_step = step[:POSE]
            size = float(pose_step @ np.linalg.solve(self.covariance[:POSE, :POSE], pose_step))
            if held and size < CONVERGED and float(step @ matrix @ step) < 1.0:
                self.steps.append(step[:POSE])
                self.now = self.now.moved(step)
                self.look = self._look(self.now)
                alike = 1.0 if spread else self._alike()
                if alike <= LEAST_ALIKE:
                    return self
                # What is alike is known of residuals that nothing but noise and shapes without a mode is left in.
                self.inverse_variance /= alike
                merit, spread = self._merit(self.now, self.look), True
                continue
            before = self.now, self.look
            moved_px = self._motion_px(step)
            for _ in range(MOST_HALVINGS):
                self.now = before[0].moved(step)
                self.look = self._look(self.now)
                new = self._merit(self.now, self.look)
                if not held or new <= merit:
                    break
                step = 0.5 * step
            else:
                self.now, self.look = before
                self.steps.append(np.zeros(POSE))
                if not spread:
                    self.inverse_variance /= max(self._alike(), 1.0)
                    self.covariance = _inverse(self._equations()[0])
                return self
            self.steps.append(step[:POSE])
            settled = settled + 1 if size < SETTLED and changed < STEADY else 0
            away_px += moved_px
            if not held and (away_px > RESELECT_PX or (size < SETTLED and away_px > NEAR_PX)):
                self._reselect()
                settled, away_px = 0, 0.0
            if not held and settled < SETTLING_STEPS:
                changed = self._weigh()
                new = self._merit(self.now, self.look)
            merit = new
        if size > 1.0:
            raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps")
        return self

    def _reselect(self) -> None:
        self._select(self.now.pose, self.now.blur)
        if self.air.count != len(self.now.air):
            self.now = replace(self.now, air=np.zeros(self.air.count))
        self.look = self._look(self.now)

    def _look(self, now: _Guess) -> _Seen:
        near = self.near
        ray = ray_height(near.pixels.los_cam, now.pose.cam_from_itrs, now.pose.r_itrs, self.knowledge.ellipsoid.axes_m)
        lift = near.lift_m * (now.blur**2 + PIXEL_VARIANCE)
        t, s = near.along, near.sector
        across, by_height = level_distance(ray.height_m - now.pose.height_m, self.curve)
        across = across + lift[s] * (1.0 - t) + lift[s + 1] * t
        weights = self.air.coefficients(now.air)
        at = (across - self.air.bottom_m) / self.air.step_m
        top = self.air.functions.shape[2] - 2
        place = np.clip(at.astype(np.intp), 0, top)
        share = np.clip(at - place, 0.0, 1.0)
        slopes = self.tables.changes(weights, now.blur, now.sharpness, 1)
        slope = self._read(slopes, place, share)
        # The integral of the slopes, linear between heights: model and derivative are of one piece.
        ahead = 0.5 * self.air.step_m * share
        level = self._read(self.tables.changes(weights, now.blur, now.sharpness, 0), place, np.zeros_like(share))
        level += ahead * (slope + self._read(slopes, place, np.zeros_like(share)))
        residuals = near.values - now.background - now.gain * near.light * level
        return _Seen(ray, by_height, weights, place, share, level, slope, residuals)

    def _read(self, table: FloatArray, place: np.ndarray, share: FloatArray) -> FloatArray:
        """Return tables of nodes (m + 1, n) at the pixels, linear between heights and nodes."""
        near, size = self.near, table.shape[1]
        flat = table.ravel()
        first = near.sector * size + place
        left = flat[first] * (1.0 - share) + flat[first + 1] * share
        first += size
        right = flat[first] * (1.0 - share) + flat[first + 1] * share
        return np.asarray(left * (1.0 - near.along) + right * near.along)

    def _weigh(self) -> float:
        """Weigh the pixels by the residuals as they are; return by how much the variances changed (a logarithm)."""
        level = self.near.light * self.look.level
        level = np.clip(level / max(float(level.max()), 1e-300), 0.0, 1.0)
        width_m = self.near.width_m[self.near.sector]
        per_px = self.now.gain * self.near.light * self.look.slope * width_m
        # Whether a pixel sees what is below the highest clouds, softened by its own width.
        below = np.clip(0.5 - (self.look.ray.height_m - CLOUD_TOP_M) / (2.0 * width_m), 0.0, 1.0)
        squares = self.look.residuals**2
        used, before = self.inverse_variance > 0.0, float(np.mean(self.inverse_variance))
        dark, bright = (_variance(squares, there & used) for there in (level < DARK_LEVEL, level > BRIGHT_LEVEL))
        parts = np.array([level, (below * level) ** 2, per_px**2 / max(float(np.max(per_px**2)), 1e-300)])
        expected = dark + max(bright - dark, 0.0) * level
        for _ in range(WEIGHINGS):
            inside = squares < OUTLIER**2 * expected
            expected = dark + _components(squares[inside] - dark, expected[inside], parts[:, inside]) @ parts
        self.inverse_variance = np.where(squares < OUTLIER**2 * expected, 1.0 / expected, 0.0)
        return abs(float(np.log(max(float(np.mean(self.inverse_variance)), 1e-300) / before)))

    def _alike(self) -> float:
        """Return how much larger the variance of the residuals' sums over squares is than of independent ones."""
        pixels, root = self.near.pixels, np.sqrt(self.inverse_variance)
        most = 1.0
        for side in ALIKE_PX:
            across = int(pixels.columns.max()) // side + 1
            square = (pixels.rows // side) * across + pixels.columns // side
            sums = np.bincount(square, root * self.look.residuals)
            count = np.bincount(square, root > 0.0)
            full = count > side
            most = max(most, float(np.sum(sums[full] ** 2) / max(float(np.sum(count[full])), 1.0)))
        return most

    def _merit(self, now: _Guess, look: _Seen) -> float:
        wanted = self._wanted(now)
        prior = self.knowledge.information
        squares = float(self.inverse_variance @ look.residuals**2) + float(now.air @ now.air)
        squares += float(wanted[:POSE] @ prior @ wanted[:POSE]) + float(wanted[BLUR] ** 2) * self._blur_prior
        squares += float(wanted[SHARPNESS] ** 2) * self._sharpness_prior
        return squares + float(wanted[GAIN] ** 2) * self._gain_prior

    @property
    def _blur_prior(self) -> float:
        return self.knowledge.blur_log_sigma**-2

    @property
    def _sharpness_prior(self) -> float:
        return self.knowledge.sharpness_sigma**-2

    @property
    def _gain_prior(self) -> float:
        return self.knowledge.gain_log_sigma**-2

    def _wanted(self, now: _Guess) -> FloatArray:
        """Return the step to the priors' values."""
        return np.concatenate(
            [
                now.pose.step_to(self.knowledge.mean),
                [np.log(self.knowledge.blur_px / now.blur), self.knowledge.sharpness - now.sharpness],
                [np.log(self.knowledge.gain / now.gain), 0.0],
                -now.air,
            ]
        )

    def _equations(self) -> tuple[FloatArray, FloatArray]:
        near, look, now = self.near, self.look, self.now
        functions = self.tables.values(now.blur, now.sharpness)[:, 1:]
        slope = look.slope
        by_blur, by_sharpness = (
            self._read(self.tables.changes(look.weights, now.blur, now.sharpness, kind), look.place, look.share)
            for kind in (2, 3)
        )
        lifted = 2.0 * now.blur**2 * near.lift_m
        by_blur += slope * (lifted[near.sector] * (1.0 - near.along) + lifted[near.sector + 1] * near.along)
        amplitude = now.gain * near.light
        by_height = amplitude * slope * look.by_height
        shared = np.concatenate(
            [
                by_height * look.ray.by_rotation,
                by_height * look.ray.by_position,
                -by_height[None],
                (amplitude * by_blur)[None],
                (amplitude * by_sharpness)[None],
                (amplitude * look.level)[None],
                np.ones((1, len(slope))),
            ]
        )
        root = np.sqrt(self.inverse_variance)
        shared *= root
        amplitude = amplitude * root
        residuals = root * look.residuals
        total = SHARED + len(now.air)
        matrix, right = np.zeros((total, total)), np.zeros(total)
        matrix[:SHARED, :SHARED] = shared @ shared.T
        right[:SHARED] = shared @ residuals
        k, nodes = functions.shape[1], len(functions)
        own, next_, to_shared = np.zeros((nodes, k, k)), np.zeros((nodes - 1, k, k)), np.zeros((nodes, SHARED, k))
        pull = np.zeros((nodes, k))
        for i, (first, last) in enumerate(pairwise(near.starts)):
            here = slice(first, last)
            place, share, right_share = look.place[here], look.share[here], near.along[here]
            rows = []
            for node, weight in ((i, 1.0 - right_share), (i + 1, right_share)):
                weight = weight * amplitude[here]
                table = functions[node]
                rows.append(table[:, place] * ((1.0 - share) * weight) + table[:, place + 1] * (share * weight))
                own[node] += rows[-1] @ rows[-1].T
                to_shared[node] += shared[:, here] @ rows[-1].T
                pull[node] += rows[-1] @ residuals[here]
            next_[i] = rows[0] @ rows[1].T
        self._air_equations(matrix, right, own, next_, to_shared, pull)
        matrix[SHARED:, :SHARED] = matrix[:SHARED, SHARED:].T
        information = np.zeros((total, total))
        information[:POSE, :POSE] = self.knowledge.information
        information[BLUR, BLUR] = self._blur_prior
        information[SHARPNESS, SHARPNESS] = self._sharpness_prior
        information[GAIN, GAIN] = self._gain_prior
        information[SHARED:, SHARED:] = np.eye(len(now.air))
        if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
            raise np.linalg.LinAlgError("the fit's equations have no solution")
        return matrix + information, right + information @ self._wanted(now)

    def _air_equations(
        self,
        matrix: FloatArray,
        right: FloatArray,
        own: FloatArray,
        next_: FloatArray,
        to_shared: FloatArray,
        pull: FloatArray,
    ) -> None:
        """Fill in the equations of the unknowns of the air from those of the coefficients at the nodes.

        A pixel lies between two nodes, so that these hold products of functions at a node (m, k, k) and of a node with
        the next (m - 1, k, k) alone.
        """
        function, waves = self.air.function, np.concatenate(self.air.waves, axis=1)
        matrix[:SHARED, SHARED:] = np.einsum("ijk,ik->jk", to_shared[:, :, function], waves)
        right[SHARED:] = np.einsum("ik,ik->k", pull[:, function], waves)
        for j in range(own.shape[1]):
            mine = function == j
            spread = own[:, j][:, function] * waves
            spread[:-1] += next_[:, j][:, function] * waves[1:]
            spread[1:] += next_[:, :, j][:, function] * waves[:-1]
            matrix[SHARED:, SHARED:][mine] = waves[:, mine].T @ spread

    def _motion_px(self, step: FloatArray) -> float:
        ray = self.look.ray
        moved = step[:3] @ ray.by_rotation + step[3:6] @ ray.by_position - step[6]
        return float(np.abs(moved).max() / np.median(self.near.width_m))

    def _bounded(self, step: FloatArray) -> FloatArray:
        """Return a step within the reach of the derivatives."""
        most_px = max(LARGEST_MOTION_M / float(np.median(self.near.width_m)), LARGEST_MOTION_PX)
        over = max(self._motion_px(step) / most_px, float(np.abs(step[[BLUR, GAIN]]).max()) / LARGEST_LOG_STEP)
        return np.asarray(step / max(over, 1.0))


def fit_profile(
    image: FloatArray,
    camera: CameraModel,
    start: LimbPose,
    knowledge: ProfileKnowledge,
    noise_sigma: float | None = None,
) -> ProfileFit:
    """Fit the limb's profile near a pose that is right to some kilometres of height at the limb.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        Grey levels, linear in radiance.
    camera : CameraModel
    start : LimbPose
    knowledge : ProfileKnowledge
    noise_sigma : float, optional
        Of a pixel as neighbours show it, for ``chi_squared``.

    Raises
    ------
    numpy.linalg.LinAlgError
        Too little limb in view, no light where it should be, or no convergence.
    """
    found = _ProfileSearch(image, camera, start, knowledge).run()
    near, look, now = found.near, found.look, found.now
    known = _inverse(found.normal[:SHARED, :SHARED])[:POSE, :POSE]
    weights = found.inverse_variance
    used = weights > 0.0
    mean = float(weights @ near.values) / float(weights.sum())
    explained = 1.0 - float(weights @ look.residuals**2) / float(weights @ (near.values - mean) ** 2)
    chi = float("nan") if noise_sigma is None else float(np.mean(look.residuals[used] ** 2)) / noise_sigma**2
    uv, off = _by_sector(found)
    return ProfileFit(
        pose=now.pose,
        blur_px=now.blur,
        gain=now.gain,
        background=now.background,
        covariance=found.covariance[:POSE, :POSE],
        relief_covariance=found.covariance[:POSE, :POSE] - known,
        chi_squared=chi,
        improbable=_improbable(found),
        explained=explained,
        uv=uv,
        residuals_rad=off,
        steps=np.array(found.steps),
    )


def _improbable(found: _ProfileSearch) -> float:
    """Return the largest coefficient of any function of the air in its own standard deviations."""
    sizes = [float(np.sqrt((wave**2).sum(axis=1).max())) for wave in found.air.waves]
    largest = np.abs(found.air.coefficients(found.now.air)[:, 1:]).max(axis=0)
    return float(np.max(largest / np.array(sizes)))


def _by_sector(found: _ProfileSearch) -> tuple[FloatArray, FloatArray]:
    """Return a place on the limb for every sector, and by how much its pixels would have the limb farther in [rad]."""
    near, look, now = found.near, found.look, found.now
    per_rad = now.gain * near.light * look.slope * look.by_height * look.ray.distance_m
    weights = found.inverse_variance * per_rad
    uv, off = [], []
    for first, last in pairwise(near.starts):
        here = slice(first, last)
        information = float(weights[here] @ per_rad[here])
        off.append(-float(weights[here] @ look.residuals[here]) / information if information > 0.0 else 0.0)
        nearest = first + int(np.argmin(np.abs(look.ray.height_m[here])))
        uv.append([near.pixels.columns[nearest], near.pixels.rows[nearest]])
    return np.array(uv, dtype=float), np.array(off)


def _variance(squares: FloatArray, there: np.ndarray) -> float:
    """Return the mean of squared residuals that are no outliers by their quartiles."""
    some = squares[there] if there.sum() > FEWEST_PIXELS else squares
    inside = some <= OUTLIER**2 * float(np.median(some)) / NORMAL_QUARTILE**2
    return max(float(np.mean(some[inside])), 1e-300)


def _components(squares: FloatArray, expected: FloatArray, parts: FloatArray) -> FloatArray:
    """Return what parts (k, n) of a variance come to, none below 0, by least squares.

    The square of a normal number scatters by twice its variance squared, so that all are over what is expected.
    """
    rows = parts / expected
    normal = rows @ rows.T
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    root = np.linalg.cholesky(normal / np.outer(size, size) + 1e-9 * np.eye(len(parts)))
    right = np.linalg.solve(root, (rows @ (squares / expected)) / size)
    return np.asarray(nnls(root.T, right)[0] / size)


def _inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix whose unknowns have units of their own."""
    size = np.sqrt(np.diag(matrix))
    if not (np.isfinite(size).all() and (size > 0.0).all()):
        raise np.linalg.LinAlgError("the limb in view does not determine the fit's unknowns")
    return np.asarray(np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size))
