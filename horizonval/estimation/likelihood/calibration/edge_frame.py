"""One frame of a calibration by the limb's edge: its unknowns and equations.

Pixels and unknowns ``x`` (pose, blur, scale height, relief) are those of :mod:`horizonval.estimation.likelihood.fit`.
An error ``c`` of the camera moves the limb in the image through the pixels' lines of sight ``d``, and through the prior
of the pose, since the platform states the attitude of its body and the mean height of the limb is common to all
frames::

    d image / d c = (d image / d delta) (d delta / d d) (d d / d c)
    (x - m - A c)^T P (x - m - A c)

Derivatives by pose and lens are central differences: a turn and a shift of the principal point have the same effect to
a hundredth, and the fit's analytic derivatives are accurate to a few thousandths.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.known import LimbKnowledge
from horizonval.estimation.fit.light import PIXEL_VARIANCE
from horizonval.estimation.fit.pixels import pixel_at_limb_m
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.fit.start import EllipsoidStart
from horizonval.estimation.likelihood.calibration.shared import (
    BEND,
    HEIGHT,
    OF_LENS,
    SHARED,
    SharedUnknowns,
    off_priors,
    seen_by_changed,
    without_own,
)
from horizonval.estimation.likelihood.fit import (
    LARGEST_LOG_STEP,
    LARGEST_SCALE_STEP_M,
    POSE,
    LimbState,
    LimbUnknowns,
    by_sector,
    limb_jacobian,
    predicted,
    priors,
    scatter,
)
from horizonval.estimation.likelihood.light import LimbLight, solved, weighed
from horizonval.estimation.likelihood.pixels import LimbPixels, limb_pixels
from horizonval.estimation.likelihood.sectors import eliminated
from horizonval.estimation.limb.picture import smaller
from horizonval.geometry.camera import CameraModel

STEP_PX = 0.02
"""Step [px of the limb in the image] of the pixels' differences."""
WHOLE = 1.0
"""Share of the profile across the limb that must be in the picture. A real edge is no exponential, so that a truncated
profile misplaces it: by 0.3 px at three pixels from the border."""


class EdgeFrame:
    """One frame's contribution to the camera calibration.

    ``camera``: as calibrated before; ``bends``: whether its distortion may be wrong; ``scale``: pixels of the image per
    fitted pixel, each way; camera and shared unknowns are then in the wider pixels. Raises ``LinAlgError``: too little
    limb in view.
    """

    def __init__(self, start: EllipsoidStart, camera: CameraModel, *, bends: bool = False, scale: int = 1) -> None:
        self.bends = bends
        self.image, self.told, self.knowledge = start.picture.grey, camera, start.knowledge
        if scale > 1:
            self.image, self.told = smaller(self.image, camera, scale)
            self.knowledge = self.knowledge.in_wider_pixels(scale)
        state = LimbState(float(np.sqrt(self.knowledge.blur_px**2 + PIXEL_VARIANCE)), self.knowledge.scale_height_m)
        self.now = LimbUnknowns(start.pose, state, np.zeros(0))
        self.light: LimbLight | None = None
        self.factor = 1.0
        self._gain = np.empty((0, SHARED))
        self._own = np.empty(0)

    @property
    def pixel_m(self) -> float:
        """What a pixel sees at the distance of the limb."""
        return pixel_at_limb_m(self.told, self.knowledge.mean.r_itrs, float(self.knowledge.ellipsoid.axes_m[0]))

    def choose(self, camera: CameraModel) -> None:
        """Choose pixels whose whole profile is in the picture; raises ``LinAlgError`` for too little limb."""
        now = self.now
        self.near = limb_pixels(
            self.image, camera, now.pose, self.knowledge, now.state.blur, now.state.scale_m, whole=WHOLE
        )
        if len(self.near.modes) != len(now.relief):
            self.now = LimbUnknowns(now.pose, now.state, np.zeros(len(self.near.modes)))

    def equations(self, shared: SharedUnknowns, *, held: bool) -> tuple[FloatArray, FloatArray]:
        """Return the reduced normal matrix (8, 8) and right side (8,) of the shared unknowns.

        ``held``: keep pixels, weights and scatter. Raises ``LinAlgError``: too little limb in view, or singular
        equations.
        """
        camera = shared.camera(self.told)
        if not held or self.light is None:
            self.choose(camera)
        else:
            self._follow(camera)
        near = self.near
        knowledge = replace(self.knowledge, mean=self._mean(shared))
        model = predicted(near, self.now, knowledge)
        starts = near.sectors.starts
        if not held or self.light is None:
            self.light = weighed(model.basis, near.values, starts, near.neighbours)
            _, off = by_sector(near, model, self.light, self.now.relief)
            self.factor = max(scatter(near, model, self.light, off), 1.0)
        else:
            was = self.light
            spread = was.levels.spread_information
            self.light = solved(model.basis, near.values, starts, was.weights, was.variance, spread)
        light = self.light
        own = limb_jacobian(near, model, light.of_pixel, self.now.state)
        own[:POSE], by_lens = self._derivatives(camera, knowledge, light)
        of_shared = np.zeros((SHARED, len(light.residuals)))
        of_shared[:OF_LENS] = by_lens
        jacobian = np.concatenate([own, of_shared])
        normal, right = eliminated(jacobian, model.basis, light.residuals, light.weights, starts, light.levels)
        information, wanted = priors(knowledge, self.now)
        count = len(own)
        to_prior = off_priors(count, POSE - 1, count)
        total = normal / self.factor + to_prior.T @ information @ to_prior
        pull = right / self.factor + to_prior.T @ (information @ wanted)
        if not (np.isfinite(total).all() and np.isfinite(pull).all()):
            raise np.linalg.LinAlgError("the frame's equations have no solution")
        self._gain, self._own, reduced, left = without_own(total, pull, count)
        return reduced, left

    def step(self, of_shared: FloatArray, share: float = 1.0) -> None:
        """Take a share of the frame's own step (Schur's complement, back) for a step of what is shared, shape (8,)."""
        step = share * (self._own - self._gain @ of_shared)
        step[POSE] = np.clip(step[POSE], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
        step[POSE + 1] = np.clip(step[POSE + 1], -LARGEST_SCALE_STEP_M, LARGEST_SCALE_STEP_M)
        self.now = self.now.moved(step)

    def _derivatives(
        self, camera: CameraModel, knowledge: LimbKnowledge, light: LimbLight
    ) -> tuple[FloatArray, FloatArray]:
        """Return central differences of the pixels by the pose, shape (7, n), and by the lens, shape (4, n)."""
        pixel_rad, pixel_m = 1.0 / max(camera.fx, camera.fy), self.pixel_m

        def value(near: LimbPixels, now: LimbUnknowns) -> FloatArray:
            basis = predicted(near, now, knowledge).basis
            return np.asarray(np.einsum("ij,ij->j", basis, light.of_pixel))

        by_pose = []
        for number, size in enumerate(STEP_PX * np.array([*[pixel_rad] * 3, *[pixel_m] * 4])):
            step = size * np.eye(POSE + 2 + len(self.now.relief))[number]
            ahead, behind = self.now.moved(step), self.now.moved(-step)
            by_pose.append((value(self.near, ahead) - value(self.near, behind)) / (2.0 * size))
        by_lens = np.zeros((OF_LENS, len(light.residuals)))
        for number, size in enumerate(STEP_PX * np.array([pixel_rad, 1.0, 1.0, 1.0])):
            if number == BEND and not self.bends:
                continue
            step = size * np.eye(OF_LENS)[number]
            moved = [replace(self.near, pixels=seen_by_changed(camera, self.near.pixels, s)) for s in (step, -step)]
            by_lens[number] = (value(moved[0], self.now) - value(moved[1], self.now)) / (2.0 * size)
        return np.array(by_pose), by_lens

    def _mean(self, shared: SharedUnknowns) -> LimbPose:
        """Return the pose that the priors have of the frame, with the mounting and the height as they are now."""
        stated = self.knowledge.mean
        height = stated.height_m + float(shared.values[HEIGHT])
        return LimbPose(shared.turn @ stated.cam_from_itrs, stated.r_itrs, height)

    def _follow(self, camera: CameraModel) -> None:
        """Give the pixels that were chosen the lines of sight of another camera."""
        self.near = replace(self.near, pixels=self.near.pixels.seen_by(camera))
