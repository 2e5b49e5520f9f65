"""The pose of a body that makes the pixels across the limb of all its heads most probable.

The equations of one image (:mod:`horizonval.estimation.likelihood.fit`) are summed. With the unknowns ``g`` of the body
(a turn in body axes, position, height and softness of the limb, modes of its relief, one blur for each head), those of
head ``k`` are ``T_k g``: a turn of the body turns its cameras by ``theta_k = R_k theta``, and the rest is selected.
Backgrounds, brightness and noise are separate for each head and eliminated before (:mod:`..sectors`)::

    N = P + sum T_k^T N_k T_k,        step = N^-1 (P (m - now) + sum T_k^T r_k),        C = N^-1

The relief is one random function round the whole horizon, so that heads on opposite sides share the effect of the
flattening. A linear array is an image of one row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief
from horizonval.estimation.likelihood.fit import (
    CONVERGED,
    LARGEST_LOG_STEP,
    LARGEST_MOTION_PX,
    LARGEST_SCALE_STEP_M,
    MOST_HALVINGS,
    MOST_STEPS,
    POSE,
    RESELECT_PX,
    SETTLING_STEPS,
    LimbLikelihoodFit,
    LimbModel,
    LimbState,
    LimbUnknowns,
    by_sector,
    inner_levels,
    limb_jacobian,
    motion_px,
    predicted,
    scaled_inverse,
)
from horizonval.estimation.likelihood.height import UnevenLimb
from horizonval.estimation.likelihood.knowledge import FIXED_LENGTH_M, LimbKnowledge, LimbPose
from horizonval.estimation.likelihood.light import PIXEL_VARIANCE, LimbLight, solved, weighed
from horizonval.estimation.likelihood.pixels import FEWEST_LIMB_PX, LimbPixels, limb_pixels
from horizonval.estimation.likelihood.sectors import eliminated, relief_modes
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.rotation import tangent_basis

SHARED = POSE + 1
"""Pose of the body, height of the limb, scale height; the modes of the relief follow, then a blur for each head."""


@dataclass(frozen=True)
class HeadImage:
    """The image of one head, shape (H, W), linear in radiance, and ``cam_from_body``, shape (3, 3)."""

    image: FloatArray
    camera: CameraModel
    cam_from_body: FloatArray


@dataclass(frozen=True)
class _Now:
    """Unknowns of all heads: the pose's axes are the body's."""

    body: LimbPose
    scale_m: float
    relief: FloatArray
    blurs: FloatArray

    def moved(self, step: FloatArray) -> _Now:
        first = SHARED + len(self.relief)
        return _Now(
            self.body.moved(step[:POSE]),
            max(self.scale_m + float(step[POSE]), 0.0),
            self.relief + step[SHARED:first],
            self.blurs * np.exp(step[first:]),
        )

    def of_head(self, k: int, head: HeadImage) -> LimbUnknowns:
        return LimbUnknowns(_pose_of(self.body, head), LimbState(float(self.blurs[k]), self.scale_m), self.relief)


@dataclass(frozen=True)
class _Looks:
    """Model and light of every head."""

    models: list[LimbModel]
    lights: list[LimbLight]


def fit_heads(heads: Sequence[HeadImage], start: LimbPose, knowledge: LimbKnowledge) -> LimbLikelihoodFit:
    """Fit the limb in the images of all heads near a pose that is right to some pixels.

    ``start`` and ``knowledge`` refer to the body: ``cam_from_itrs`` is ``body_from_itrs``. The result is in the camera
    axes of the first head, with its points and ``chi_squared`` NaN. Raises ``LinAlgError``: too little limb in a head,
    or no convergence.
    """
    return _JointSearch(list(heads), start, knowledge).run()


def _pose_of(body: LimbPose, head: HeadImage) -> LimbPose:
    return LimbPose(head.cam_from_body @ body.cam_from_itrs, body.r_itrs, body.height_m)


class _JointSearch:
    """The way from the start to the most probable unknowns."""

    def __init__(self, heads: list[HeadImage], start: LimbPose, knowledge: LimbKnowledge) -> None:
        self.heads, self.knowledge = heads, knowledge
        # One relief for all: heads choose their pixels without.
        self.alone = [self._alone(head) for head in heads]
        axes = knowledge.ellipsoid.axes_m + start.height_m
        rho = float(np.arcsin(min(float(axes[0]) / float(np.linalg.norm(start.r_itrs)), 1.0)))
        self.nodes, self.modes = _modes(knowledge.reliefs, knowledge.flattened_m, rho)
        self.basis_body = tangent_basis(start.nadir_cam)
        blur = float(np.sqrt(knowledge.blur_px**2 + PIXEL_VARIANCE))
        self.now = _Now(start, knowledge.scale_height_m, np.zeros(len(self.modes)), np.full(len(heads), blur))
        self.near = self._pixels()

    def run(self) -> LimbLikelihoodFit:
        """Search, and return where it ends."""
        settled, steps = 0, []
        looks = self._look(None)
        merit = self._merit(looks)
        for _ in range(MOST_STEPS):
            matrix, right = self._equations(looks)
            covariance = scaled_inverse(matrix)
            full = self._bounded(covariance @ right, covariance, looks)
            if settled > 0 and float(full @ matrix @ full) < CONVERGED:
                steps.append(full[:POSE])
                self.now = self.now.moved(full)
                return self._found(looks, covariance, steps)
            before, step, held = (self.now, looks), full, settled >= SETTLING_STEPS
            for _ in range(MOST_HALVINGS):
                self.now = before[0].moved(step)
                looks = self._look(before[1].lights if held else None)
                new = self._merit(looks)
                if not held or new <= merit:
                    break
                step = 0.5 * step
            else:
                # Nothing on the way is better: the best place is this one, to rounding.
                self.now, looks = before
                return self._found(looks, covariance, [*steps, np.zeros(POSE)])
            steps.append(step[:POSE])
            settled += 1
            if self._motion_px(step, before[1]) > RESELECT_PX:
                self.near = self._pixels()
                settled = min(settled, SETTLING_STEPS - 1)
                looks = self._look(None)
                new = self._merit(looks)
            merit = new
        raise np.linalg.LinAlgError(f"no convergence in {MOST_STEPS} steps")

    def _alone(self, head: HeadImage) -> LimbKnowledge:
        """Return what is known of a head's limb: without the relief, and with the Sun in its own axes."""
        alone = replace(self.knowledge, reliefs=(), flattened_m=0.0)
        uneven = self.knowledge.uneven
        if not isinstance(uneven, UnevenLimb):
            return alone
        sun_cam = uneven.sun_cam
        if sun_cam is not None:
            sun_cam = head.cam_from_body @ self.heads[0].cam_from_body.T @ sun_cam
        # Heights above the planet: what two limbs differ by is no tilt.
        return replace(alone, uneven=replace(uneven, sun_cam=sun_cam, typical_m=0.0))

    def _pixels(self) -> list[LimbPixels]:
        chosen = []
        for k, head in enumerate(self.heads):
            now = self.now.of_head(k, head)
            fewest = 1 if min(head.image.shape) == 1 else FEWEST_LIMB_PX
            state, known = now.state, self.alone[k]
            near = limb_pixels(head.image, head.camera, now.pose, known, state.blur, state.scale_m, fewest)
            across = self.basis_body.T @ (head.cam_from_body.T @ near.pixels.los_cam)
            azimuth = np.mod(np.arctan2(across[1], across[0]), 2.0 * np.pi)
            modes = np.array([np.interp(azimuth, self.nodes, mode) for mode in self.modes])
            chosen.append(replace(near, modes=modes.reshape(len(self.modes), len(azimuth))))
        # The height of the pose is the common height of all limbs.
        common = float(np.mean([near.lift_m.mean() for near in chosen]))
        return [replace(near, lift_m=near.lift_m - common) for near in chosen]

    def _look(self, held: Sequence[LimbLight] | None) -> _Looks:
        models, lights = [], []
        for k, (head, near) in enumerate(zip(self.heads, self.near, strict=True)):
            model = predicted(near, self.now.of_head(k, head), self.knowledge)
            starts = near.sectors.starts
            if held is None:
                light = weighed(model.basis, near.values, starts, near.neighbours)
            else:
                was = held[k]
                spread = was.levels.spread_information
                light = solved(model.basis, near.values, starts, was.weights, was.variance, spread)
            models.append(model)
            lights.append(light)
        return _Looks(models, lights)

    def _merit(self, looks: _Looks) -> float:
        information, wanted = self._priors()
        squares = sum(float(one.weights @ one.residuals**2) + one.levels.penalty for one in looks.lights)
        return squares + float(wanted @ information @ wanted)

    def _equations(self, looks: _Looks) -> tuple[FloatArray, FloatArray]:
        information, wanted = self._priors()
        total, right = information, information @ wanted
        for k, (head, near) in enumerate(zip(self.heads, self.near, strict=True)):
            model, light = looks.models[k], looks.lights[k]
            jacobian = limb_jacobian(near, model, light.of_pixel, self.now.of_head(k, head).state)
            starts = near.sectors.starts
            normal, pull = eliminated(jacobian, model.basis, light.residuals, light.weights, starts, light.levels)
            picked = self._picked(k, head)
            total = total + picked.T @ normal @ picked
            right = right + picked.T @ pull
        if not (np.isfinite(total).all() and np.isfinite(right).all()):
            raise np.linalg.LinAlgError("the fit's equations have no solution")
        return total, right

    def _picked(self, k: int, head: HeadImage) -> FloatArray:
        """Return how the unknowns of a head follow from those of all: pose, ln blur, scale height, relief."""
        relief = len(self.now.relief)
        picked = np.zeros((POSE + 2 + relief, SHARED + relief + len(self.heads)))
        picked[:3, :3] = head.cam_from_body
        picked[3:POSE, 3:POSE] = np.eye(POSE - 3)
        picked[POSE, SHARED + relief + k] = 1.0
        picked[POSE + 1, POSE] = 1.0
        picked[POSE + 2 :, SHARED : SHARED + relief] = np.eye(relief)
        return picked

    def _priors(self) -> tuple[FloatArray, FloatArray]:
        """Return the priors' information and the step that leads to their values."""
        knowledge, now = self.knowledge, self.now
        first = SHARED + len(now.relief)
        count = first + len(self.heads)
        information = np.zeros((count, count))
        information[:POSE, :POSE] = knowledge.information
        diagonal = np.ones(count - POSE)
        diagonal[0] = max(knowledge.scale_sigma_m, FIXED_LENGTH_M) ** -2
        diagonal[first - POSE :] = knowledge.blur_log_sigma**-2
        information[POSE:, POSE:] = np.diag(diagonal)
        blur = float(np.sqrt(knowledge.blur_px**2 + PIXEL_VARIANCE))
        softer = [knowledge.scale_height_m - now.scale_m]
        return information, np.concatenate(
            [now.body.step_to(knowledge.mean), softer, -now.relief, np.log(blur / now.blurs)]
        )

    def _motion_px(self, step: FloatArray, looks: _Looks) -> float:
        """Return by how far a step moves the limb in the image of the head that it moves most."""
        moved = 0.0
        for head, model in zip(self.heads, looks.models, strict=True):
            turned = np.concatenate([head.cam_from_body @ step[:3], step[3:POSE]])
            moved = max(moved, float(np.abs(motion_px(model, turned)).max()))
        return moved

    def _bounded(self, step: FloatArray, covariance: FloatArray, looks: _Looks) -> FloatArray:
        """Return a step within the reach of the derivatives."""
        scale = self.now.scale_m
        if step[POSE] < -scale:
            # A scale height of less than nothing is a hard limb: the most probable step to that one.
            step = step + (-scale - step[POSE]) / covariance[POSE, POSE] * covariance[:, POSE]
        blurs = step[SHARED + len(self.now.relief) :]
        over = max(
            self._motion_px(step, looks) / LARGEST_MOTION_PX,
            float(np.abs(blurs).max()) / LARGEST_LOG_STEP,
            abs(float(step[POSE])) / LARGEST_SCALE_STEP_M,
        )
        return np.asarray(step / max(over, 1.0))

    def _found(self, looks: _Looks, covariance: FloatArray, steps: list[FloatArray]) -> LimbLikelihoodFit:
        first, light = self.heads[0], looks.lights[0]
        turn = np.eye(POSE)
        turn[:3, :3] = first.cam_from_body
        relief = slice(SHARED, SHARED + len(self.now.relief))
        by_relief = covariance[:POSE, relief] @ covariance[relief, :POSE]
        uv, off = by_sector(self.near[0], looks.models[0], light, self.now.relief)
        return LimbLikelihoodFit(
            pose=_pose_of(self.now.body, first),
            blur_px=float(np.sqrt(max(float(self.now.blurs[0]) ** 2 - PIXEL_VARIANCE, 0.0))),
            scale_height_m=self.now.scale_m,
            covariance=turn @ covariance[:POSE, :POSE] @ turn.T,
            relief_covariance=turn @ by_relief @ turn.T,
            noise_sigma=(float(np.sqrt(light.variance[0])), float(np.sqrt(light.variance[1]))),
            chi_squared=float("nan"),
            pixels=sum(int((one.weights > 0.0).sum()) for one in looks.lights),
            uv=uv,
            residuals_rad=off,
            levels=inner_levels(self.near[0], looks.models[0], light),
            steps=np.array(steps),
        )


def _modes(reliefs: tuple[Relief, ...], flattened_m: float, rho_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return nodes of azimuth round the whole horizon and the modes of the relief there."""
    return relief_modes(2.0 * np.pi, reliefs, flattened_m, rho_rad)
