"""What all frames of a camera share: the errors of its calibration, and what is wrong of the limb's model alike."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.pixels import NearPixels
from horizonval.estimation.lens_error import k1_per_px, miscalibrated
from horizonval.estimation.observation import Observation
from horizonval.geometry.camera import CameraModel, unproject

FOCAL, POINT, BEND, TURN, HEIGHT = 0, slice(1, 3), 3, slice(4, 7), 7
OF_LENS = 4
"""Number of shared unknowns that move the image; they come first."""
SHARED = 8
"""ln f, principal point [px], distortion at the farthest corner [px], turn of the mounting in camera axes [rad], and
height of all limbs [m]."""
FOCAL_SIGMA, POINT_SIGMA_PX, MOUNTING_SIGMA_RAD = 0.05, 20.0, np.radians(2.0)
"""Default priors, as from a data sheet and a workshop."""


@dataclass(frozen=True)
class SharedUnknowns:
    """The errors of a camera, counted from what was told of it."""

    values: FloatArray

    def camera(self, camera: CameraModel) -> CameraModel:
        """Return the camera as it is now believed, of the one that was told."""
        u, v = self.values[POINT]
        bend = float(self.values[BEND])
        focal = float(np.expm1(self.values[FOCAL]))
        return miscalibrated(camera, focal, (float(u), float(v)), bend)

    @property
    def turn(self) -> FloatArray:
        """Matrix (3, 3) from the camera's axes as told to those of the camera as it is."""
        return np.asarray(Rotation.from_rotvec(self.values[TURN]).as_matrix())


def prior_sigmas(observation: Observation, height_sigma_m: float) -> FloatArray:
    """Return prior standard deviations (8,) of the shared unknowns; ``height_sigma_m``: common height of all limbs."""
    said = observation.calibration
    sigmas = np.empty(SHARED)
    sigmas[FOCAL] = said.focal_length_sigma if said and said.focal_length_sigma > 0.0 else FOCAL_SIGMA
    sigmas[POINT] = said.principal_point_sigma_px if said and said.principal_point_sigma_px > 0.0 else POINT_SIGMA_PX
    # A distortion that nobody says is wrong is right.
    sigmas[BEND] = said.distortion_sigma_px if said else 0.0
    sigmas[TURN] = MOUNTING_SIGMA_RAD
    if said and any(said.mounting_sigma_rad):
        sigmas[TURN] = max(said.mounting_sigma_rad)
    sigmas[HEIGHT] = height_sigma_m
    return sigmas


def off_priors(priors: int, height: int, own: int) -> FloatArray:
    """Return how far a frame's unknowns are from their priors, as rows (own unknowns, shared unknowns).

    Turn and height are counted from the shared ones. ``priors``: number of leading unknowns with a prior; ``height``:
    index of the height among them; ``own``: number of the frame's unknowns.
    """
    rows = np.zeros((priors, own + SHARED))
    rows[:, :priors] = np.eye(priors)
    rows[:3, own + TURN.start : own + TURN.stop] = -np.eye(3)
    rows[height, own + HEIGHT] = -1.0
    return rows


def without_own(
    normal: FloatArray, right: FloatArray, own: int
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Eliminate a frame's own unknowns, the first ``own`` of its equations (Schur complement).

    ``normal``: shape (own + 8, own + 8); ``right``: shape (own + 8,). Result: the gain (own, 8), by which the own step
    decreases per shared step; the own step (own,) without one; the reduced matrix (8, 8) and right side (8,).
    """
    size = np.sqrt(np.diag(normal)[:own])
    inverse = np.linalg.inv(normal[:own, :own] / np.outer(size, size)) / np.outer(size, size)
    cross = normal[own:, :own]
    gain, step = inverse @ cross.T, inverse @ right[:own]
    return gain, step, normal[own:, own:] - cross @ gain, right[own:] - cross @ step


def seen_by_changed(camera: CameraModel, pixels: NearPixels, step: FloatArray) -> NearPixels:
    """Return pixels with lines of sight after a camera step (4,) of ln f, principal point and distortion."""
    bend = k1_per_px(camera) * float(step[3]) if step[3] else 0.0
    changed = replace(
        camera,
        fx=camera.fx * float(np.exp(step[0])),
        fy=camera.fy * float(np.exp(step[0])),
        cx=camera.cx + float(step[1]),
        cy=camera.cy + float(step[2]),
        distortion=(camera.distortion[0] + bend, *camera.distortion[1:]),
    )
    here = np.column_stack([pixels.columns, pixels.rows]).astype(float)
    sides = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    middle, right, left, below, above = unproject(changed, here + sides[:, None, :]).transpose(0, 2, 1)
    return replace(pixels, los_cam=middle, by_column=0.5 * (right - left), by_row=0.5 * (below - above))
