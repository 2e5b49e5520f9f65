"""The pose of a camera or a body near a limb, and the nadir that follows from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import rotation_vector

FIXED_LENGTH_M = 0.1
"""Standard deviation of a length that is no unknown: below what an image shows, above rounding."""


@dataclass(frozen=True)
class LimbPose:
    """Pose and limb height.

    ``cam_from_itrs``: shape (3, 3), rotation matrix, of a body in place of a camera where a pose is the body's; for a
    sphere any fixed axes serve as Earth-fixed. ``r_itrs``: shape (3,) [m]. ``height_m``: mean height of the limb above
    the ellipsoid.
    """

    cam_from_itrs: FloatArray
    r_itrs: FloatArray
    height_m: float = 0.0

    @property
    def nadir_cam(self) -> FloatArray:
        """Unit vector to the Earth's centre, shape (3,)."""
        return np.asarray(-self.cam_from_itrs @ self.r_itrs / np.linalg.norm(self.r_itrs))

    def moved(self, step: FloatArray) -> LimbPose:
        """Return the pose after a step: rotation vector in its axes [rad], position [m], height [m], shape (7,)."""
        turn = Rotation.from_rotvec(step[:3]).as_matrix()
        return LimbPose(turn @ self.cam_from_itrs, self.r_itrs + step[3:6], self.height_m + float(step[6]))

    def step_to(self, other: LimbPose) -> FloatArray:
        """Return the step, shape (7,), that leads to another pose."""
        turn = rotation_vector(other.cam_from_itrs @ self.cam_from_itrs.T)
        return np.concatenate([turn, other.r_itrs - self.r_itrs, [other.height_m - self.height_m]])

    def way_to(self, other: LimbPose) -> FloatArray:
        """Return the step to another pose, its turn as a tilt after a turn about the nadir, which add as vectors."""
        way, nadir = self.step_to(other), self.nadir_cam
        angle = float(np.linalg.norm(way[:3]))
        if angle > 0.0:
            # Swing and twist: q = (sin(a / 2) axis, cos(a / 2)) = swing (twist about the nadir).
            part, rest = np.sin(0.5 * angle) / angle * way[:3], np.cos(0.5 * angle)
            along = float(part @ nadir)
            size = np.hypot(rest, along)
            swing = (rest * part - along * rest * nadir - along * np.cross(part, nadir)) / size
            sine = max(float(np.linalg.norm(swing)), 1e-300)
            way[:3] = 2.0 * swing * (np.arcsin(min(sine, 1.0)) / sine)
            way[:3] += 2.0 * np.arctan2(along, rest) * nadir
        return way

    def of_camera(self, cam_from_body: FloatArray) -> LimbPose:
        """Return the pose of a camera, of a body's pose; ``cam_from_body``: shape (3, 3)."""
        return LimbPose(cam_from_body @ self.cam_from_itrs, self.r_itrs, self.height_m)


def nadir_derivative(pose: LimbPose) -> FloatArray:
    """Return the derivative, shape (3, 7), of the geocentric nadir in the pose's axes by a step of the pose."""
    n = pose.nadir_cam
    turn = -np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    across = -(np.eye(3) - np.outer(n, n)) @ pose.cam_from_itrs / np.linalg.norm(pose.r_itrs)
    return np.concatenate([turn, across, np.zeros((3, 1))], axis=1)
