"""One frame of a calibration by the whole profile of its limb.

The frame's unknowns are those of :mod:`..profile.fit`: pose, blur, sharpness, gain, background, and the unit unknowns
``z`` of the air. An error ``c`` of the lens changes the pixels' distances across the limb, with derivatives by central
differences. The air is eliminated first (Cholesky), then the frame's other unknowns. The prior of the pose moves with
the mounting and the lift of all air, which all frames share::

    (x - m - A c)^T P (x - m - A c)

Between two selections of pixels the distances are linear in ``c``, as they are in the pose.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.pose import LimbPose
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
from horizonval.estimation.likelihood.profile import model as profile
from horizonval.estimation.likelihood.profile.fit import ProfileSearch, least_variance, noise_at, wider
from horizonval.estimation.likelihood.profile.known_profile import KnownProfile
from horizonval.estimation.likelihood.profile.model import BLUR, GAIN, POSE, ProfileModel, priors_beside_pose
from horizonval.estimation.likelihood.profile.pixels import level_distance, ray_height
from horizonval.geometry.camera import CameraModel

STEP_PX = 0.02
"""Step [px of the limb in the image] of the distances' differences."""
OWN = profile.SHARED
"""Number of a frame's unknowns besides the air's."""
LARGEST_LOG_STEP = 0.5


class ProfileFrame:
    """One frame's contribution to the camera calibration.

    ``camera``: as calibrated before; ``turn_sigma_rad``: of the mounting, added to the search range of the attitude;
    ``bends``: whether its distortion may be wrong. Raises ``LinAlgError``: too little limb, or no fit with this camera.
    """

    def __init__(self, known: KnownProfile, camera: CameraModel, turn_sigma_rad: float, *, bends: bool = False) -> None:
        self.told, self.bends, self.knowledge = camera, bends, known.knowledge
        self._image = known.picture.unclipped
        tilt_sigma = float(np.hypot(known.tilt_sigma_rad, turn_sigma_rad))
        loose = known.knowledge.information.copy()
        loose[:3, :3] = np.eye(3) / tilt_sigma**2
        start = known.start(camera, tilt_sigma)
        found = ProfileSearch(self._image, camera, start, replace(known.knowledge, information=loose)).run()
        self.now, self.model, self._weights = found.now, found.model, found.inverse_variance
        self._at = np.zeros(OF_LENS)

    def equations(self, shared: SharedUnknowns, *, held: bool) -> tuple[FloatArray, FloatArray]:
        """Return the reduced normal matrix (8, 8) and right side (8,) of the shared unknowns.

        ``held``: keep pixels and weights. Raises ``LinAlgError``: too little limb in view, or singular equations.
        """
        if not held or not len(self.model.by_lens):
            self._choose(shared)
        found = self._reduced(shared, held=held)
        if not held:
            return found
        # Its own unknowns go to their best place for this camera first: without, sixty steps were too few for some.
        self.step(np.zeros(SHARED))
        return self._reduced(shared, held=True)

    def _reduced(self, shared: SharedUnknowns, *, held: bool) -> tuple[FloatArray, FloatArray]:
        """Return :meth:`equations` at the frame's unknowns as they are; what steps back need is kept."""
        self.model.moved = (shared.values[:OF_LENS] - self._at) @ self.model.by_lens
        look = self.model.look(self.now)
        if not held:
            least = least_variance(self.model, self.now, look)
            noise = noise_at(self.model, look, self._weights, least)
            self._weights = noise.inverse_variance / wider(self.model, self.now, look, noise)
        parts = self.model.equations(self.now, look, self._weights)
        if not all(np.isfinite(x).all() for x in (parts.shared, parts.right, parts.air, parts.right_air)):
            raise np.linalg.LinAlgError("the frame's equations have no solution")
        parts.air[np.diag_indices(len(parts.air))] += 1.0
        self._root = cholesky(parts.air, lower=True, overwrite_a=True, check_finite=False)
        both = np.concatenate([parts.mixed, (parts.right_air - self.now.air)[None]]).T
        half = solve_triangular(self._root, both, lower=True, check_finite=False)
        self._by_others, self._half = half[:, :-1], half[:, -1]
        normal = parts.shared - self._by_others.T @ self._by_others
        right = parts.right - self._by_others.T @ self._half
        total, pull = self._with_priors(normal, right, shared)
        self._gain, self._own, reduced, left = without_own(total, pull, OWN)
        return reduced, left

    def step(self, of_shared: FloatArray, share: float = 1.0) -> None:
        """Take a share of the frame's own step (Schur's complement, back) for a step of what is shared, shape (8,)."""
        own = share * (self._own - self._gain @ of_shared)
        own[[BLUR, GAIN]] = np.clip(own[[BLUR, GAIN]], -LARGEST_LOG_STEP, LARGEST_LOG_STEP)
        others = np.concatenate([own, share * of_shared[:OF_LENS]])
        left = share * self._half - self._by_others @ others
        of_air = solve_triangular(self._root, left, lower=True, trans=1, check_finite=False)
        self.now = self.now.moved(np.concatenate([own, of_air]))

    def _with_priors(
        self, normal: FloatArray, right: FloatArray, shared: SharedUnknowns
    ) -> tuple[FloatArray, FloatArray]:
        """Return the equations of the frame's own (11) and of what is shared (8), with the frame's priors."""
        total, pull = np.zeros((OWN + SHARED, OWN + SHARED)), np.zeros(OWN + SHARED)
        of_image = OWN + OF_LENS
        total[:of_image, :of_image], pull[:of_image] = normal, right
        to_prior = off_priors(POSE, POSE - 1, OWN)
        known, now = self.knowledge, self.now
        wanted = self.model.pose.step_to(self._mean(shared)) - now.away
        total += to_prior.T @ known.information @ to_prior
        pull += to_prior.T @ (known.information @ wanted)
        beside, to_beside = priors_beside_pose(known, now, self.model.floor)
        total[np.arange(OWN), np.arange(OWN)] += beside
        pull[:OWN] += beside * to_beside
        return total, pull

    def _mean(self, shared: SharedUnknowns) -> LimbPose:
        """Return the pose that the priors have of the frame, with the mounting and the lift as they are now."""
        stated = self.knowledge.mean
        return LimbPose(
            shared.turn @ stated.cam_from_itrs, stated.r_itrs, stated.height_m + float(shared.values[HEIGHT])
        )

    def _choose(self, shared: SharedUnknowns) -> None:
        """Choose the pixels anew, as the camera and the pose are now, and differentiate their distances by the lens."""
        before, camera = self.model, shared.camera(self.told)
        pose = before.pose.moved(self.now.away)
        self.model = model = ProfileModel(self._image, camera, pose, self.now.blur, self.knowledge)
        self.now = replace(self.now, away=np.zeros(POSE), air=model.air.taken_over(before.air, self.now.air))
        self._weights = np.ones_like(model.near.values)
        self._at = shared.values[:OF_LENS].copy()
        axes = self.knowledge.ellipsoid.axes_m

        def across(step: FloatArray) -> FloatArray:
            los = seen_by_changed(camera, model.near.pixels, step).los_cam
            height = ray_height(los, pose.cam_from_itrs, pose.r_itrs, axes).height_m
            return level_distance(height - pose.height_m, model.curve)[0]

        by_lens = np.zeros((OF_LENS, len(model.near.values)))
        for number, size in enumerate(STEP_PX * np.array([1.0 / max(camera.fx, camera.fy), 1.0, 1.0, 1.0])):
            if number != BEND or self.bends:
                step = size * np.eye(OF_LENS)[number]
                by_lens[number] = (across(step) - across(-step)) / (2.0 * size)
        model.by_lens = by_lens
