"""The ideal horizon sensor: exact by definition, the reference that image estimators are compared with.

Input is the pose, not an image. With the Earth's centre C, the sensor at P and the Earth radius R:

1. The two tangents from P in the plane of nadir and boresight, to the horizon points A and B, make the angle
   ``theta = asin(R / |PC|)`` with the nadir. The nearer point H is the one whose direction has the larger dot product
   with the boresight. Its axes HR: *forward* towards H, *up* away from the Earth in the plane of nadir and H, *right*
   across both.
2. Roll error: the angle between the sensor's right axis and HR's right axis, signed by the dot product of the sensor's
   right axis with HR's up axis.
3. Pitch error: the angle between the boresight and the direction to H, signed by the boresight's component along HR's
   up axis: positive above the horizon (towards space), negative below it.

With the boresight exactly at nadir or zenith every horizon point is equally near: that is a status, not a number.

Steps 2 and 3 are one reading of the published module's documentation. By another, the sensor's axes are projected on
the Earth's tangent plane at H, and each error is the elevation of an axis over that plane::

    roll = asin(right . up) = asin(sin(roll error) |cos(pitch error)|),     pitch = asin(boresight . up)

They agree where the boresight is on the horizon. :class:`HorizonReading` has both.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.frames import roll_pitch_of_nadir
from horizonval.geometry.rotation import off_axis_angle

SIGMA_RAD = 1e-12
"""Standard deviation that the estimator claims: rounding of float64 over its few operations."""


class ReadingStatus(StrEnum):
    """Whether a nearest horizon point exists."""

    DEFINED = "defined"
    BORESIGHT_AT_NADIR = "boresight_at_nadir"
    BORESIGHT_AT_ZENITH = "boresight_at_zenith"
    INSIDE_EARTH = "inside_earth"


@dataclass(frozen=True)
class HorizonReading:
    """Reading of the ideal sensor, in sensor axes: x right, y down, z along the boresight.

    Everything but the status is zero unless the status is ``defined``.

    Attributes
    ----------
    status : ReadingStatus
    theta_rad : float
        Angle between the nadir and the horizon.
    tangents_cam : ndarray, shape (2, 3)
        Unit vectors to the horizon points A and B in the plane of nadir and boresight.
    horizon_cam : ndarray, shape (3,)
        Unit vector to the nearer of them, H.
    axes_cam : ndarray, shape (3, 3)
        HR: its forward, right and up axes, one a row.
    roll_error_rad, pitch_error_rad : float
        Signed angles between the axes of the sensor and those of HR: the right axis up and the boresight above the
        horizon are positive.
    roll_elevation_rad, pitch_elevation_rad : float
        The other reading: elevations of the right axis and the boresight over the tangent plane at H.
    """

    status: ReadingStatus
    theta_rad: float = 0.0
    tangents_cam: FloatArray = field(default_factory=lambda: np.zeros((2, 3)))
    horizon_cam: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes_cam: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    roll_error_rad: float = 0.0
    pitch_error_rad: float = 0.0
    roll_elevation_rad: float = 0.0
    pitch_elevation_rad: float = 0.0


def horizon_sensor(position_m: ArrayLike, attitude: ArrayLike, radius_m: float = MEAN_RADIUS_M) -> HorizonReading:
    """Return the reading of an ideal horizon sensor over a spherical body, from the pose alone.

    Parameters
    ----------
    position_m : array_like, shape (3,)
        From the body's centre, in any axes.
    attitude : array_like, shape (4,)
        Quaternion from those axes to the sensor's, scalar last. The sensor's boresight is z, its right axis x.
    radius_m : float
        Of the body; the Earth's mean radius by default.

    Raises
    ------
    UserError
        Vectors of another shape, zero or not finite; a radius that is not positive.

    Examples
    --------
    A sensor 500 km up, boresight 70 deg from the nadir and its right axis level:

    >>> import horizonval as hv, numpy as np
    >>> half = np.radians(70.0) / 2
    >>> reading = hv.horizon_sensor([0.0, 0.0, -6871e3], [-np.sin(half), 0.0, 0.0, np.cos(half)], radius_m=6371e3)
    >>> print(f"theta {np.degrees(reading.theta_rad):.3f}, pitch {np.degrees(reading.pitch_error_rad):.3f} deg")
    theta 68.007, pitch 1.993 deg
    >>> print(f"roll {abs(np.degrees(reading.roll_error_rad)):.3f} deg, H {np.round(reading.horizon_cam, 3)}")
    roll 0.000 deg, H [0.    0.035 0.999]
    """
    r, q = np.asarray(position_m, dtype=float), np.asarray(attitude, dtype=float)
    distance = float(np.linalg.norm(r)) if r.shape == (3,) else 0.0
    if not (np.isfinite(distance) and distance > 0.0):
        raise UserError(f"found {position_m!r}", where="position_m", expected="three finite numbers, not all zero")
    if q.shape != (4,) or not (np.isfinite(q).all() and q.any()):
        raise UserError(f"found {attitude!r}", where="attitude", expected="a quaternion of four finite numbers")
    if not radius_m > 0.0:
        raise UserError(f"found {radius_m}", where="radius_m", expected="a positive number")
    if distance <= radius_m:
        return HorizonReading(ReadingStatus.INSIDE_EARTH)
    nadir = Rotation.from_quat(q).apply(-r / distance)
    boresight, right = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    across = boresight - (boresight @ nadir) * nadir
    size = float(np.linalg.norm(across))
    if size < SIGMA_RAD:
        at_nadir = nadir[2] > 0.0
        return HorizonReading(ReadingStatus.BORESIGHT_AT_NADIR if at_nadir else ReadingStatus.BORESIGHT_AT_ZENITH)
    across /= size
    # Next to the nadir the difference above is mostly rounding along it, which would lift H off the horizon.
    across -= (across @ nadir) * nadir
    across /= np.linalg.norm(across)
    sin_theta = radius_m / distance
    cos_theta = float(np.sqrt((1.0 - sin_theta) * (1.0 + sin_theta)))
    tangents = np.array([cos_theta * nadir + side * sin_theta * across for side in (1.0, -1.0)])
    horizon = tangents[np.argmax(tangents @ boresight)]
    up = (horizon @ nadir) * horizon - nadir
    up /= np.linalg.norm(up)
    level = np.cross(horizon, up)
    return HorizonReading(
        ReadingStatus.DEFINED,
        float(np.arcsin(sin_theta)),
        tangents,
        horizon,
        np.array([horizon, level, up]),
        float(off_axis_angle(right, level)) * _sign(float(right @ up)),
        float(off_axis_angle(boresight, horizon)) * _sign(float(boresight @ up)),
        *(_elevation(axis, up) for axis in (right, boresight)),
    )


def _elevation(axis: FloatArray, up: FloatArray) -> float:
    """Return the angle [rad] of a unit vector over the plane that ``up`` is square to."""
    lift = float(axis @ up)
    return float(np.arctan2(lift, np.linalg.norm(axis - lift * up)))


def _sign(value: float) -> float:
    return -1.0 if value < 0.0 else 1.0


def run(observation: Observation) -> Fit | Refusal:
    """Return the exact nadir from the pose; the image is not used."""
    pose = observation.oracle
    if pose is None:
        return Refusal(Outcome.BAD_INPUT, "the ideal sensor needs the pose, which only our own EXR files carry")
    r = np.asarray(pose.r_itrs, dtype=float)
    distance = float(np.linalg.norm(r))
    if not np.isfinite(distance) or distance <= pose.radius_m:
        return Refusal(Outcome.BAD_INPUT, "the pose lies inside the Earth")
    nadir = Rotation.from_quat(pose.q_cam_from_itrs).apply(-r / distance)
    nadir /= np.linalg.norm(nadir)
    nadir_body = Rotation.from_quat(observation.q_cam_from_body).inv().apply(nadir)
    roll, pitch = roll_pitch_of_nadir(nadir_body)
    return Fit(
        nadir_cam=nadir,
        covariance_nadir_cam=SIGMA_RAD**2 * (np.eye(3) - np.outer(nadir, nadir)),
        roll_rad=float(roll),
        pitch_rad=float(pitch),
        angular_radius_rad=float(np.arcsin(pose.radius_m / distance)),
        altitude_m=distance - observation.prior.sphere_radius_m,
        sigma_altitude_m=1e-6,
    )


ESTIMATOR = Estimator(
    name="ideal",
    title="Ideal horizon sensor (exact pose)",
    run=run,
    estimates="geocentric",
    needs="pose",
)
