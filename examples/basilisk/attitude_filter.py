"""A small attitude filter: a gyro turns the attitude on, a measured nadir corrects it.

Multiplicative extended Kalman filter of six states, the attitude's error as a turn in body axes and the gyro's bias.
With the true matrix ``[BN] = exp(-[e x]) [BN]_filter`` a nadir ``n`` of the filter is seen at ``n + [n x] e``. It says
nothing about the turn around itself; as the orbit goes round, that turn becomes a tilt, which it does say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GyroNoise:
    """Of each axis, as data sheets state it."""

    angle_random_walk_deg_sqrt_h: float = 0.15
    bias_deg_h: float = 10.0
    bias_random_walk_deg_h_sqrt_h: float = 1.0

    @property
    def angle_rad_sqrt_s(self) -> float:
        return float(np.radians(self.angle_random_walk_deg_sqrt_h) / 60.0)

    @property
    def bias_rad_s(self) -> float:
        return float(np.radians(self.bias_deg_h) / 3600.0)

    @property
    def bias_walk_rad_s_sqrt_s(self) -> float:
        return float(np.radians(self.bias_random_walk_deg_h_sqrt_h) / 3600.0 / 60.0)


class NadirFilter:
    """Attitude among the stars from a rate-integrating gyro and nadirs in body axes.

    Parameters
    ----------
    body_from_gcrs : Rotation
        First attitude.
    attitude_sigma_rad : float
        Of it, about each axis.
    noise : GyroNoise
    gate_sigmas : float
        A nadir farther than this from where it is expected is left out.
    floor_rad : float
        Added in square to what an estimator claims, in both directions. Its error by season, place and cloud is alike
        in successive images, and a filter that takes it for noise trusts the mean of many too much.
    """

    def __init__(
        self,
        body_from_gcrs: Rotation,
        attitude_sigma_rad: float,
        noise: GyroNoise,
        gate_sigmas: float,
        floor_rad: float,
    ) -> None:
        self.body_from_gcrs, self.bias = body_from_gcrs, np.zeros(3)
        self.covariance = np.diag([attitude_sigma_rad**2] * 3 + [noise.bias_rad_s**2] * 3)
        self._noise, self._gate, self._floor = noise, gate_sigmas, floor_rad

    def turn_on(self, angle_body: Array, seconds: float) -> None:
        """Go on by what the gyro integrated in an interval, shape (3,) [rad]."""
        turn = Rotation.from_rotvec(-(angle_body - self.bias * seconds))
        self.body_from_gcrs = turn * self.body_from_gcrs
        transition = np.eye(6)
        transition[:3, :3] = turn.as_matrix()
        transition[:3, 3:] = -np.eye(3) * seconds
        growth = [self._noise.angle_rad_sqrt_s**2 * seconds] * 3 + [self._noise.bias_walk_rad_s_sqrt_s**2 * seconds] * 3
        self.covariance = transition @ self.covariance @ transition.T + np.diag(growth)

    def correct(self, nadir_gcrs: Array, nadir_body: Array, covariance: Array) -> bool:
        """Take a measured nadir with its covariance, shape (3, 3) [rad^2]; False where it was too far off."""
        expected = self.body_from_gcrs.apply(nadir_gcrs)
        across = np.linalg.svd(expected[None, :])[2][1:]
        difference = across @ (nadir_body - expected)
        design = np.zeros((2, 6))
        design[:, :3] = across @ _cross(expected)
        noise = across @ covariance @ across.T + self._floor**2 * np.eye(2)
        spread = design @ self.covariance @ design.T + noise
        if difference @ np.linalg.solve(spread, difference) > self._gate**2:
            return False
        gain = np.linalg.solve(spread, design @ self.covariance).T
        step = gain @ difference
        self.body_from_gcrs = Rotation.from_rotvec(-step[:3]) * self.body_from_gcrs
        self.bias = self.bias + step[3:]
        kept = np.eye(6) - gain @ design
        self.covariance = kept @ self.covariance @ kept.T + gain @ noise @ gain.T
        return True

    def tilt_sigma_rad(self, nadir_gcrs: Array) -> float:
        """Return the standard deviation of the attitude across the nadir, the mean of both directions."""
        nadir = self.body_from_gcrs.apply(nadir_gcrs)
        across = np.eye(3) - np.outer(nadir, nadir)
        return float(np.sqrt(np.trace(across @ self.covariance[:3, :3] @ across) / 2.0))


def _cross(v: Array) -> Array:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
