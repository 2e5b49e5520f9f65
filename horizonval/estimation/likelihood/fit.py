"""The pose that makes the pixels across the limb most probable: Gauss-Newton on their likelihood.

A pixel near the limb is ``I = b + B(x) E(x) + noise`` with the edge profile ``E`` (:mod:`.light`), ``x`` its distance
inside the limb in pixels, background and brightness of its sector of azimuth (:mod:`.sectors`). Unknown are also a turn
of the camera (3), its position (3), the mean height of the limb, the logarithm of the blur, the scale height, and the
modes of the relief (:mod:`.sectors`). With the noise's weights ``W``, the information ``P`` of all priors about ``m``,
and ``J`` the derivatives with the levels eliminated::

    step = (J^T W J + P)^-1 (J^T W residuals + P (m - now)),        C = (J^T W J + P)^-1

Every prior, that of the relief included, is rows of these equations. ``C`` is the claimed covariance; its part ``C J^T
W J C`` is due to noise and ``C P_r C`` to the relief.

Uneven ground, clouds and coasts move the limb of some sectors more than noise and relief do. The scatter of the
sectors' positions gives chi-squared per degree of freedom; where it exceeds one by two of its standard deviations the
covariance is multiplied by it (Birge's ratio, Phys. Rev. 40, 207, 1932).

**Neglected.** The change of the image scale over the distance itself, a thousandth per pixel where ``x`` is a few
pixels. The noise of pixels is taken as independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.known import FIXED_LENGTH_M, LimbKnowledge
from horizonval.estimation.fit.light import (
    EARTH_LEVEL,
    PIXEL_VARIANCE,
    EdgeProfile,
    brightness,
    edge_profile,
    light_basis,
)
from horizonval.estimation.fit.pixels import LimbAngle, image_scale, limb_angle
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.likelihood.light import LimbLight, solved, weighed
from horizonval.estimation.likelihood.pixels import LimbPixels, limb_pixels
from horizonval.estimation.likelihood.sectors import eliminated
from horizonval.geometry.camera import CameraModel

POSE = 7
"""Turn, position, height of the limb."""
FITTED = 3
"""Degrees of freedom constrained by the sector residuals: two tilts and a size."""
SCATTERED = 2.0
"""Standard deviations of chi-squared per degree of freedom beyond which sectors scatter by more than chance."""
MOST_STEPS = 30
"""Gauss-Newton takes 3 to 6 from within a pixel; where blur and softness are hard to tell apart, twice as many."""
SETTLING_STEPS = 2
"""Number of steps after which noise, outliers and the spread of levels are fixed, since marginal outliers would
alternate. Later steps that reduce the likelihood are halved."""
CONVERGED = 1e-2
"""Square of a step over its own covariance: a tenth of a standard deviation, and it is still taken."""
RESELECT_PX = 0.5
"""Motion of the limb after which the pixels near it are chosen again."""
LARGEST_MOTION_PX, LARGEST_LOG_STEP, LARGEST_SCALE_STEP_M = 2.0, 0.5, 4e3
"""Largest step of limb, ln blur and scale height for which the derivatives hold."""
LARGEST_BLUR_PX = 8.0
"""Blur of an edge as wide as the window inside it: what is fitted there is no limb. Searches for a limb pass 6.7."""
LEAST_SAG = 0.5
"""Smallest ratio of a height to its tangent: far above any air; keeps the exponential edge monotonic."""
MOST_HALVINGS = 10
"""Largest number of halvings of a step that reduces the likelihood: to a thousandth."""


@dataclass(frozen=True)
class LimbLikelihoodFit:
    """The most probable pose.

    ``covariance`` (7, 7): of turn in camera axes [rad], position [m], limb height [m], from noise, priors, relief and
    excess scatter of the sectors; ``relief_covariance``: its part of relief and scatter. ``noise_sigma``: pixel noise
    in space and on the Earth, in grey levels. ``chi_squared``: mean square residual over the noise variance between
    neighbouring pixels. ``pixels``: number used. ``uv`` (m, 2): a point on each sector's limb [px]; ``residuals_rad``
    (m,): how far inside the fitted limb each sector shows it, including relief; ``levels`` (m,): the Earth's brightness
    there above space. ``steps``: shape (k, 7).
    """

    pose: LimbPose
    blur_px: float
    scale_height_m: float
    covariance: FloatArray
    relief_covariance: FloatArray
    noise_sigma: tuple[float, float]
    chi_squared: float
    pixels: int
    uv: FloatArray
    residuals_rad: FloatArray
    levels: FloatArray
    steps: FloatArray

    @property
    def by_nadir(self) -> FloatArray:
        """How a step moves the nadir in camera axes, shape (3, 7)."""
        return nadir_derivative(self.pose)


def nadir_derivative(pose: LimbPose) -> FloatArray:
    """Return the derivative, shape (3, 7), of the geocentric nadir in camera axes by a step of the pose."""
    n = pose.nadir_cam
    turn = -np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    across = -(np.eye(3) - np.outer(n, n)) @ pose.cam_from_itrs / np.linalg.norm(pose.r_itrs)
    return np.concatenate([turn, across, np.zeros((3, 1))], axis=1)


@dataclass(frozen=True)
class LimbState:
    """Unknowns beside the pose: blur of lens and pixel [px], scale height."""

    blur: float
    scale_m: float


@dataclass(frozen=True)
class LimbUnknowns:
    """All unknowns of one image that are solved for by steps; ``relief``: of its modes."""

    pose: LimbPose
    state: LimbState
    relief: FloatArray

    def moved(self, step: FloatArray) -> LimbUnknowns:
        """Return the unknowns after a step: of the pose (7), ln blur, scale height [m], modes of the relief."""
        blur = self.state.blur * float(np.exp(step[POSE]))
        scale = max(self.state.scale_m + float(step[POSE + 1]), 0.0)
        return LimbUnknowns(self.pose.moved(step[:POSE]), LimbState(blur, scale), self.relief + step[POSE + 2 :])


@dataclass(frozen=True)
class LimbModel:
    """The pixels as the present unknowns say they are; ``soft`` is the scale height in the image [px/m]."""

    angle: LimbAngle
    scale: FloatArray
    x: FloatArray
    edge: EdgeProfile
    soft: FloatArray | None
    basis: FloatArray


def fit_limb(
    image: FloatArray, camera: CameraModel, start: LimbPose, knowledge: LimbKnowledge, noise_sigma: float | None = None
) -> LimbLikelihoodFit:
    """Fit the limb near a pose that is right to some pixels.

    ``image``: shape (H, W), linear in radiance; ``noise_sigma``: pixel noise seen between neighbours, for
    ``chi_squared`` (NaN without). Raises ``LinAlgError``: too little limb in view, or no convergence.
    """
    found = _Search(image, camera, start, knowledge).run()
    near, model, light, covariance = found.near, found.model, found.light, found.covariance
    pose, state, relief = found.now.pose, found.now.state, found.now.relief
    relief_part = covariance[:POSE, POSE + 2 :] @ covariance[POSE + 2 :, :POSE]
    uv, off = by_sector(near, model, light, relief)
    # What the sectors scatter by beyond all that is in the model is no noise of the detector, and not to be averaged.
    beyond = (scatter(near, model, light, off) - 1.0) * covariance[:POSE, :POSE]
    used = light.weights > 0.0
    # A sky of one level, as a compressed picture has it, shows no noise to compare with.
    chi_squared = float(np.mean(light.residuals[used] ** 2)) / noise_sigma**2 if noise_sigma else float("nan")
    return LimbLikelihoodFit(
        pose=pose,
        blur_px=float(np.sqrt(max(state.blur**2 - PIXEL_VARIANCE, 0.0))),
        scale_height_m=state.scale_m,
        covariance=covariance[:POSE, :POSE] + beyond,
        relief_covariance=relief_part + beyond,
        noise_sigma=(float(np.sqrt(light.variance[0])), float(np.sqrt(light.variance[1]))),
        chi_squared=chi_squared,
        pixels=int(used.sum()),
        uv=uv,
        residuals_rad=off,
        levels=inner_levels(near, model, light),
        steps=np.array(found.steps),
    )


class _Search:
    """The way from the start to the most probable unknowns."""

    def __init__(self, image: FloatArray, camera: CameraModel, start: LimbPose, knowledge: LimbKnowledge) -> None:
        self.image, self.camera, self.knowledge = image, camera, knowledge
        state = LimbState(float(np.sqrt(knowledge.blur_px**2 + PIXEL_VARIANCE)), knowledge.scale_height_m)
        self.near = limb_pixels(image, camera, start, knowledge, state.blur, state.scale_m)
        self._known: tuple[LimbUnknowns, FloatArray, FloatArray] | None = None
        self.now = LimbUnknowns(start, state, np.zeros(len(self.near.modes)))
        self.steps: list[FloatArray] = []
        self.model, self.light = self._look(None)
        self.covariance = np.empty((0, 0))

    def run(self) -> _Search:
        """Search, and keep the last step as attributes; raises ``LinAlgError`` without convergence or solution."""
        settled = 0
        merit = self._merit()
        for _ in range(MOST_STEPS):
            matrix, right = self._equations()
            self.covariance = scaled_inverse(matrix)
            full = self._bounded(self.covariance @ right, self.covariance)
            if settled > 0 and float(full @ matrix @ full) < CONVERGED:
                self.steps.append(full[:POSE])
                self.now = self.now.moved(full)
                return self
            before, step = (self.now, self.model, self.light), full
            moved_px = float(np.abs(motion_px(self.model, step[:POSE])).max())
            held = settled >= SETTLING_STEPS
            for _ in range(MOST_HALVINGS):
                self.now = before[0].moved(step)
                self.model, self.light = self._look(before[2] if held else None)
                new = self._merit()
                if not held or new <= merit:
                    break
                step = 0.5 * step
            else:
                # Nothing on the way is better: the best place is this one, to rounding.
                self.now, self.model, self.light = before
                self.steps.append(np.zeros(POSE))
                return self
            self.steps.append(step[:POSE])
            settled += 1
            if moved_px > RESELECT_PX:
                if self.now.state.blur > LARGEST_BLUR_PX:
                    raise np.linalg.LinAlgError(
                        f"the edge is wider than {LARGEST_BLUR_PX:.0f} px: no limb near the start"
                    )
                self._reselect()
                settled = min(settled, SETTLING_STEPS - 1)
                self.model, self.light = self._look(None)
                new = self._merit()
            merit = new
        # Blur and softness may go on to and fro where nothing tells them apart, with the limb in its place: what the
        # pose still moves is a part of what is not known of it.
        pose_step = full[:POSE]
        if float(np.abs(motion_px(self.model, pose_step)).max()) > RESELECT_PX:
            raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps")
        if float(pose_step @ np.linalg.solve(self.covariance[:POSE, :POSE], pose_step)) > CONVERGED:
            self.covariance[:POSE, :POSE] += np.outer(pose_step, pose_step)
        return self

    def _look(self, held: LimbLight | None) -> tuple[LimbModel, LimbLight]:
        """Return model and light of the present unknowns, weighed anew or as it was held."""
        model = predicted(self.near, self.now, self.knowledge)
        starts = self.near.sectors.starts
        if held is None:
            return model, weighed(model.basis, self.near.values, starts, self.near.neighbours)
        spread = held.levels.spread_information
        return model, solved(model.basis, self.near.values, starts, held.weights, held.variance, spread)

    def _merit(self) -> float:
        information, wanted = self._priors()
        squares = float(self.light.weights @ self.light.residuals**2) + self.light.levels.penalty
        return squares + float(wanted @ information @ wanted)

    def _equations(self) -> tuple[FloatArray, FloatArray]:
        starts, light = self.near.sectors.starts, self.light
        jacobian = limb_jacobian(self.near, self.model, light.of_pixel, self.now.state)
        normal, right = eliminated(jacobian, self.model.basis, light.residuals, light.weights, starts, light.levels)
        information, wanted = self._priors()
        if not (np.isfinite(normal).all() and np.isfinite(right).all()):
            raise np.linalg.LinAlgError("the fit's equations have no solution")
        return normal + information, right + information @ wanted

    def _priors(self) -> tuple[FloatArray, FloatArray]:
        """Return :func:`priors` of the present unknowns."""
        if self._known is None or self._known[0] is not self.now:
            self._known = (self.now, *priors(self.knowledge, self.now))
        return self._known[1:]

    def _bounded(self, step: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return a step within the reach of the derivatives."""
        scale = self.now.state.scale_m
        if step[POSE + 1] < -scale:
            # A scale height of less than nothing is a hard limb: the most probable step to that one.
            to_hard = (-scale - step[POSE + 1]) / covariance[POSE + 1, POSE + 1]
            step = step + to_hard * covariance[:, POSE + 1]
        motion = float(np.abs(motion_px(self.model, step[:POSE])).max())
        over = max(
            motion / LARGEST_MOTION_PX,
            abs(float(step[POSE])) / LARGEST_LOG_STEP,
            abs(float(step[POSE + 1])) / LARGEST_SCALE_STEP_M,
        )
        return np.asarray(step / max(over, 1.0))

    def _reselect(self) -> None:
        now = self.now
        self.near = limb_pixels(self.image, self.camera, now.pose, self.knowledge, now.state.blur, now.state.scale_m)
        if len(self.near.modes) != len(now.relief):
            self.now = LimbUnknowns(now.pose, now.state, np.zeros(len(self.near.modes)))


def inner_levels(near: LimbPixels, model: LimbModel, light: LimbLight) -> FloatArray:
    """Return how much brighter than space every sector is inside the limb, shape (m,)."""
    inside = (model.edge.level > EARTH_LEVEL) & (light.weights > 0.0)
    above = np.where(inside, near.values - light.of_pixel[0], 0.0)
    starts = near.sectors.starts[:-1]
    return np.asarray(np.add.reduceat(above, starts) / np.maximum(np.add.reduceat(inside.astype(float), starts), 1.0))


def predicted(near: LimbPixels, now: LimbUnknowns, knowledge: LimbKnowledge) -> LimbModel:
    """Return the pixels as unknowns say they are; of the knowledge, planet and softness are used."""
    pixels, pose, state, relief = near.pixels, now.pose, now.state, now.relief
    axes = knowledge.ellipsoid.axes_m + pose.height_m
    angle = limb_angle(pixels.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    scale = image_scale(angle, pixels.by_column, pixels.by_row)
    lift = near.lift_m + relief @ near.modes if len(relief) else near.lift_m
    delta = angle.delta + angle.by_height * lift
    x = delta / scale + 0.5 * state.blur**2 * near.bend
    soft = None
    if knowledge.scale_sigma_m > 0.0:
        # The ray at the angle y outside has its lowest point y tan(rho) / 2 of its height below the tangent's straight
        # line: 0.4 % at 8 km seen from 500 km, 2 arcsec.
        sag = 1.0 + 0.5 * np.minimum(angle.delta, 0.0) * axes[0] * angle.by_height
        soft = angle.by_height / (scale * np.maximum(sag, LEAST_SAG))
    edge = edge_profile(x, state.blur, None if soft is None else state.scale_m * soft)
    return LimbModel(angle, scale, x, edge, soft, light_basis(edge.level, x, near.along))


def limb_jacobian(near: LimbPixels, model: LimbModel, levels: FloatArray, state: LimbState) -> FloatArray:
    """Return the derivatives, shape (p, n): pose, ln blur, scale height, modes of the relief."""
    edge, angle = model.edge, model.angle
    lift, change = brightness(levels, model.x, near.along)
    by_x = lift * edge.slope + change * edge.level
    per_rad = by_x / model.scale
    by_height = angle.by_height * per_rad
    by_blur = state.blur * (lift * edge.by_blur + by_x * state.blur * near.bend)
    by_scale = np.zeros_like(by_x) if model.soft is None else lift * edge.by_scale * model.soft
    return np.concatenate(
        [
            angle.by_rotation * per_rad,
            angle.by_position * per_rad,
            by_height[None],
            by_blur[None],
            by_scale[None],
            near.modes * by_height,
        ]
    )


def priors(knowledge: LimbKnowledge, now: LimbUnknowns) -> tuple[FloatArray, FloatArray]:
    """Return the priors' information (p, p) and the step (p,) that leads to their values."""
    count = POSE + 2 + len(now.relief)
    information = np.zeros((count, count))
    information[:POSE, :POSE] = knowledge.information
    information[POSE, POSE] = knowledge.blur_log_sigma**-2
    information[POSE + 1, POSE + 1] = max(knowledge.scale_sigma_m, FIXED_LENGTH_M) ** -2
    information[POSE + 2 :, POSE + 2 :] = np.eye(len(now.relief))
    middle = np.zeros(count)
    middle[[POSE - 1, POSE + 1]] = 1.0
    information += np.outer(middle, middle) / knowledge.middle_sigma_m**2
    blur = float(np.sqrt(knowledge.blur_px**2 + PIXEL_VARIANCE))
    beside = [np.log(blur / now.state.blur), knowledge.scale_height_m - now.state.scale_m]
    return information, np.concatenate([now.pose.step_to(knowledge.mean), beside, -now.relief])


def scaled_inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite matrix whose unknowns have units of their own."""
    size = np.sqrt(np.diag(matrix))
    if not (np.isfinite(size).all() and (size > 0.0).all()):
        raise np.linalg.LinAlgError("the limb in view does not determine the fit's unknowns")
    return np.asarray(np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size))


def motion_px(model: LimbModel, step: FloatArray) -> FloatArray:
    """Return by how far a step of the pose moves the limb in the image [px]."""
    angle = model.angle
    moved = step[:3] @ angle.by_rotation + step[3:6] @ angle.by_position + step[6] * angle.by_height
    return np.asarray(moved / model.scale)


def by_sector(
    near: LimbPixels, model: LimbModel, light: LimbLight, relief: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return a place on the limb for every sector and how far inside of it the sector shows the limb [rad]."""
    slope = brightness(light.of_pixel, model.x, near.along)[0] * model.edge.slope / model.scale
    weights = light.weights * slope
    uv, off = [], []
    for first, last in pairwise(near.sectors.starts):
        here = slice(first, last)
        information = float(weights[here] @ slope[here])
        shift = float(weights[here] @ light.residuals[here]) / information if information > 0.0 else 0.0
        if len(relief):
            lifted = model.angle.by_height[here] * (relief @ near.modes[:, here])
            shift += float(np.mean(lifted))
        nearest = first + int(np.argmin(np.abs(model.x[here])))
        uv.append([near.pixels.columns[nearest], near.pixels.rows[nearest]])
        off.append(shift)
    return np.array(uv, dtype=float), np.array(off)


def scatter(near: LimbPixels, model: LimbModel, light: LimbLight, off_rad: FloatArray) -> float:
    """Return chi-squared per degree of freedom of the sectors' positions ``off_rad``, shape (m,), of :func:`by_sector`.

    Expected are noise and relief with their correlation along the limb. The result is 1 if chance explains the scatter;
    beyond, it is increased by the uncertainty of so few sectors.
    """
    slope = brightness(light.of_pixel, model.x, near.along)[0] * model.edge.slope / model.scale
    starts = near.sectors.starts[:-1]
    information = np.add.reduceat(light.weights * slope * slope, starts)
    counts = np.diff(near.sectors.starts)
    relief = np.add.reduceat(model.angle.by_height * near.modes, starts, axis=1) / counts
    seen = information > 0.0
    free = int(seen.sum()) - FITTED
    if free < 1:
        return 1.0
    covariance = relief[:, seen].T @ relief[:, seen] + np.diag(1.0 / information[seen])
    ratio = float(off_rad[seen] @ np.linalg.solve(covariance, off_rad[seen])) / free
    # A variance of so few is not known well: that of Student's distribution.
    return ratio * free / max(free - 2, 1) if ratio > 1.0 + SCATTERED * float(np.sqrt(2.0 / free)) else 1.0
