"""The ideal horizon sensor: exact by definition, the oracle that image estimators are held against.

Input is the pose, not an image. With the Earth's centre C, the sensor at P and the Earth radius R:

1. The two tangents from P in the plane of nadir and boresight make the angle ``theta = asin(R / |PC|)`` with the
   nadir; the nearer horizon point H is the one whose direction has the larger dot product with the boresight. Its
   axes: *forward* towards H, *up* away from the Earth in the plane of nadir and H, *right* across both.
2. Roll error: the angle between the sensor's right axis and the horizon's right axis, signed by the dot product of the
   sensor's right axis with the horizon's up axis.
3. Pitch error: the angle between the boresight and the direction to H, signed by the boresight's component along the
   horizon's up axis: positive above the horizon (towards space), negative below it.

With the boresight exactly at nadir or zenith every horizon point is equally near: that is a status, not a number.

Steps 2 and 3 are one reading of the documentation. By the other one the sensor's axes are projected on the Earth's
tangent plane at H, and each error is the elevation of an axis over that plane::

    roll = asin(right . up) = asin(sin(roll error) |cos(pitch error)|),     pitch = asin(boresight . up)

They agree where the boresight is on the horizon. :class:`HorizonReading` has both. (The documentation's pitch sign is
that of the product with the axis "across the horizon", which is *up* here: along the horizon it is always zero.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.observation import Estimator, Fit, Observation, fit_of_nadir
from horizonval.geometry.rotation import off_axis_angle

SIGMA_RAD = 1e-12
"""Standard deviation the oracle claims: rounding of float64 over its few operations."""


class ReadingStatus(StrEnum):
    """Whether a nearest horizon point exists."""

    DEFINED = "defined"
    BORESIGHT_AT_NADIR = "boresight_at_nadir"
    BORESIGHT_AT_ZENITH = "boresight_at_zenith"
    INSIDE_EARTH = "inside_earth"


@dataclass(frozen=True)
class HorizonReading:
    """Reading of the ideal sensor.

    ``horizon_cam``: shape (3,), unit vector to the nearest horizon point; it and the errors are zero unless
    ``defined``. ``roll_elevation_rad``, ``pitch_elevation_rad``: the other reading, of right axis and boresight above
    the tangent plane at the horizon point.
    """

    status: ReadingStatus
    horizon_cam: FloatArray
    roll_error_rad: float = 0.0
    pitch_error_rad: float = 0.0
    roll_elevation_rad: float = 0.0
    pitch_elevation_rad: float = 0.0


def ideal_horizon_sensor(r: FloatArray, q_cam_from_ref: FloatArray, radius_m: float) -> HorizonReading:
    """Return the reading of an ideal sensor over a sphere; boresight +z, right +x, up -y.

    ``r``: shape (3,), from the Earth's centre [m], in any axes; ``q_cam_from_ref``: shape (4,), scalar last.
    """
    undefined = np.zeros(3)
    distance = float(np.linalg.norm(r))
    if distance <= radius_m:
        return HorizonReading(ReadingStatus.INSIDE_EARTH, undefined)
    nadir = Rotation.from_quat(q_cam_from_ref).apply(-np.asarray(r, dtype=float) / distance)
    boresight, right = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    across = boresight - (boresight @ nadir) * nadir
    size = float(np.linalg.norm(across))
    if size < SIGMA_RAD:
        at_nadir = nadir[2] > 0.0
        status = ReadingStatus.BORESIGHT_AT_NADIR if at_nadir else ReadingStatus.BORESIGHT_AT_ZENITH
        return HorizonReading(status, undefined)
    across /= size
    # Next to the nadir the difference above is mostly rounding along it, which would lift H off the horizon.
    across -= (across @ nadir) * nadir
    across /= np.linalg.norm(across)
    sin_rho = radius_m / distance
    cos_rho = float(np.sqrt((1.0 - sin_rho) * (1.0 + sin_rho)))
    both = [cos_rho * nadir + side * sin_rho * across for side in (1.0, -1.0)]
    horizon = max(both, key=lambda h: float(h @ boresight))
    up = (horizon @ nadir) * horizon - nadir
    up /= np.linalg.norm(up)
    roll = float(np.copysign(off_axis_angle(right, np.cross(horizon, up)), right @ up))
    pitch = float(np.copysign(off_axis_angle(boresight, horizon), boresight @ up))
    elevations = (float(np.arctan2(axis @ up, np.linalg.norm(axis - (axis @ up) * up))) for axis in (right, boresight))
    return HorizonReading(ReadingStatus.DEFINED, horizon, roll, pitch, *elevations)


def run(observation: Observation) -> Fit | Refusal:
    """Return the exact nadir. The image is not looked at."""
    pose = observation.oracle
    if pose is None:
        return Refusal(Outcome.BAD_INPUT, "the ideal sensor needs the pose, which only our own EXR files carry")
    r = np.asarray(pose.r_itrs, dtype=float)
    distance = float(np.linalg.norm(r))
    if not np.isfinite(distance) or distance <= pose.radius_m:
        return Refusal(Outcome.BAD_INPUT, "the pose lies inside the Earth")
    nadir = Rotation.from_quat(pose.q_cam_from_itrs).apply(-r / distance)
    nadir /= np.linalg.norm(nadir)
    rho = float(np.arcsin(pose.radius_m / distance))
    found = fit_of_nadir(observation, nadir, SIGMA_RAD**2 * (np.eye(3) - np.outer(nadir, nadir)), rho)
    return replace(found, altitude_m=distance - observation.prior.sphere_radius_m, sigma_altitude_m=1e-6)


ESTIMATOR = Estimator(
    name="ideal",
    title="Ideal horizon sensor (exact pose)",
    run=run,
    estimates="geocentric",
    needs="pose",
)
