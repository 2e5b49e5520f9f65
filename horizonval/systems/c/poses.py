"""The ideal module's readings at known and at random poses, by three ways that share no line.

- the module that ships (:mod:`horizonval.estimation.methods.ideal`), vectors in camera axes;
- :func:`documented_reading`, the documentation's own steps: a direction cosine matrix pitched by +theta and -theta;
- :func:`exact_reading`: the nearest point of the exact horizon curve (:mod:`horizonval.geometry.horizon`), found by
  root finding along it, and the curve's chord as its level direction.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.ideal import HorizonReading, ReadingStatus, ideal_horizon_sensor
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import horizon_directions, limb_side
from horizonval.geometry.rotation import angle_between, perpendicular
from horizonval.systems.task_cache import rng_of

RADIUS_M = 6371e3
CHORD_RAD = 1e-3
"""Half of the chord of :func:`exact_reading`, in the curve's parameter: exact at any length, but for rounding."""


def documented_reading(r: FloatArray, q_cam_from_ref: FloatArray, radius_m: float) -> tuple[float, float, FloatArray]:
    """Return roll error, pitch error [rad] and the horizon point's direction (reference axes) by the documented steps.

    1. theta = asin(R / D); a matrix with the direction to the centre as forward axis and the boresight in its pitch
       plane is pitched by +theta and -theta: the tangents A and B; H is the one with the larger product with the
       boresight. 2. Roll: sensor's right against that of H, sign by H's up. 3. Pitch: sensor's forward against H's.
    """
    forward, right = (Rotation.from_quat(q_cam_from_ref).inv().apply(v) for v in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    distance = np.linalg.norm(r)
    theta = math.asin(radius_m / distance)
    centre = -r / distance
    side = np.cross(centre, forward)
    side /= np.linalg.norm(side)
    both = [Rotation.from_rotvec(sign * theta * side).apply(np.stack([centre, side])) for sign in (1.0, -1.0)]
    point, across = max(both, key=lambda dcm: float(dcm[0] @ forward))
    up = np.cross(point, across)
    up *= math.copysign(1.0, -float(up @ centre))
    level = np.cross(point, up)
    return _signed(right, level, up), _signed(forward, point, up), point


def exact_reading(r: FloatArray, q_cam_from_ref: FloatArray, radius_m: float) -> tuple[float, float, FloatArray]:
    """Return the same from the exact horizon curve h(t), by root finding.

    The nearest point is where the chord ``h(t + c) - h(t - c)`` is perpendicular to the boresight: a circle's chord is
    parallel to the tangent at its middle, so that position and level direction are exact.
    """
    earth = sphere(radius_m)
    forward, right = (Rotation.from_quat(q_cam_from_ref).inv().apply(v) for v in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))

    def chord(t: float) -> FloatArray:
        ends = horizon_directions(r, earth, np.array([t - CHORD_RAD, t + CHORD_RAD]))
        return np.asarray(ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])

    grid = np.linspace(0.0, math.tau, 64, endpoint=False)
    near = float(grid[np.argmax(horizon_directions(r, earth, grid) @ forward)])
    t = float(brentq(lambda x: float(chord(x) @ forward), near - 0.15, near + 0.15, xtol=1e-15, rtol=1e-15))
    point = horizon_directions(r, earth, t)
    up = r - (r @ point) * point
    level = chord(t)
    level *= math.copysign(1.0, float(level @ np.cross(point, up)))
    pitch = math.copysign(angle_between(forward, point), -float(limb_side(forward, r, earth)))
    return _signed(right, level, up), pitch, point


def _signed(axis: FloatArray, reference: FloatArray, up: FloatArray) -> float:
    return math.copysign(angle_between(axis, reference), float(axis @ up))


def pose_above_horizon(
    r: FloatArray, radius_m: float, elevation_rad: float, roll_rad: float, azimuth_rad: float
) -> FloatArray:
    """Return the attitude, scalar last, with an elevated boresight and a roll, positive for the right axis up."""
    zenith = r / np.linalg.norm(r)
    level = perpendicular(zenith)
    level = Rotation.from_rotvec(azimuth_rad * zenith).apply(level)
    nadir_angle = math.asin(radius_m / np.linalg.norm(r)) + elevation_rad
    forward = -math.cos(nadir_angle) * zenith + math.sin(nadir_angle) * level
    up = math.sin(nadir_angle) * zenith + math.cos(nadir_angle) * level
    right = np.cross(forward, up)
    ref_from_cam = np.column_stack([right, -up, forward])
    return (Rotation.from_euler("z", roll_rad) * Rotation.from_matrix(ref_from_cam).inv()).as_quat()


def random_poses(rng: np.random.Generator, count: int) -> list[tuple[FloatArray, FloatArray]]:
    """Return positions [m] from 100 to 100 000 km up, in all directions, with all attitudes."""
    altitude = 10.0 ** rng.uniform(5.0, 8.0, count)
    direction = Rotation.random(count, rng=rng).apply([1.0, 0.0, 0.0])
    attitude = Rotation.random(count, rng=rng).as_quat()
    return list(zip(direction * (RADIUS_M + altitude)[:, None], attitude, strict=True))


def departures(item: JsonObject) -> JsonObject:
    """Return the largest departures [rad] of the shipped module from the other two, over random poses."""
    poses = random_poses(rng_of(item["seed"], "ideal module", "poses"), item["count"])
    documented: list[tuple[float, float, float]] = []
    exact: list[tuple[float, float, float]] = []
    tangents: list[float] = []
    literal: list[float] = []
    elevation: list[float] = []
    for r, q in poses:
        ours = ideal_horizon_sensor(r, q, RADIUS_M)
        seen = Rotation.from_quat(q).inv().apply(ours.horizon_cam)
        for into, other in ((documented, documented_reading), (exact, exact_reading)):
            roll, pitch, point = other(r, q, RADIUS_M)
            roll_off = abs(math.remainder(ours.roll_error_rad - roll, math.tau))
            into.append((roll_off, abs(ours.pitch_error_rad - pitch), angle_between(seen, point)))
        literal.append(_literal_sign(r, q, seen))
        elevation.append(_elevations_apart(ours, roll, pitch))
        # A tangent's nearest point to the centre lies on the sphere, seen from there under a right angle.
        tangents.append(abs(math.asin(np.linalg.norm(np.cross(r, seen)) / np.linalg.norm(r)) - _theta(r)))
    return {
        "documented": np.max(documented, axis=0).tolist(),
        "exact": np.max(exact, axis=0).tolist(),
        "tangent": float(np.max(tangents)),
        "literal": float(np.max(literal)),
        "elevation": float(np.max(elevation)),
        "brute": float(max(_brute_force(r, q) for r, q in poses[: item["brute"]])),
    }


def _literal_sign(r: FloatArray, q_cam_from_ref: FloatArray, point: FloatArray) -> float:
    """Return the size of the product of the boresight with the axis along the horizon at H, whose sign it would be."""
    forward = Rotation.from_quat(q_cam_from_ref).inv().apply([0.0, 0.0, 1.0])
    along = np.cross(point, r)
    return abs(float(forward @ along)) / float(np.linalg.norm(along))


def _elevations_apart(ours: HorizonReading, roll: float, pitch: float) -> float:
    """Return the misfit of the other reading's angles, as sines, to their closed form in the first one's.

    Sines, since an elevation near 90 deg is lost in rounding. Beyond the zenith of the horizon point the first
    reading's roll changes its sign, which the elevation does not.
    """
    return max(
        abs(math.sin(ours.roll_elevation_rad) - math.sin(roll) * abs(math.cos(pitch))),
        abs(math.sin(ours.pitch_elevation_rad) - math.sin(pitch)),
    )


def _theta(r: FloatArray) -> float:
    return math.asin(RADIUS_M / float(np.linalg.norm(r)))


def _brute_force(r: FloatArray, q: FloatArray) -> float:
    """Return the pitch's departure [rad] from the smallest angle to the horizon, by plain minimisation."""
    forward = Rotation.from_quat(q).inv().apply([0.0, 0.0, 1.0])
    earth = sphere(RADIUS_M)

    def angle(t: float) -> float:
        return angle_between(forward, horizon_directions(r, earth, t))

    start = min(np.linspace(0.0, math.tau, 48), key=angle)
    found = minimize_scalar(angle, bounds=(start - 0.2, start + 0.2), method="bounded", options={"xatol": 1e-10})
    return abs(abs(ideal_horizon_sensor(r, q, RADIUS_M).pitch_error_rad) - float(found.fun))


def known_poses(item: JsonObject) -> JsonObject:
    """Return departures [rad] at poses whose reading is known, wrong signs and wrong statuses."""
    rng = rng_of(item["seed"], "ideal module", "known")
    pitch_off: list[float] = []
    roll_off: list[float] = []
    level: list[float] = []
    wrong = 0
    for r, _ in random_poses(rng, item["count"]):
        rho = _theta(r)
        elevation = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-8.0, math.log10(0.9 * rho)))
        roll = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-8.0, 0.4))
        azimuth = float(rng.uniform(0.0, math.tau))
        reading = ideal_horizon_sensor(r, pose_above_horizon(r, RADIUS_M, elevation, roll, azimuth), RADIUS_M)
        pitch_off.append(abs(reading.pitch_error_rad - elevation))
        roll_off.append(abs(reading.roll_error_rad - roll))
        wrong += (reading.pitch_error_rad > 0) != (elevation > 0)
        wrong += (reading.roll_error_rad > 0) != (roll > 0)
        zero = ideal_horizon_sensor(r, pose_above_horizon(r, RADIUS_M, 0.0, 0.0, azimuth), RADIUS_M)
        level.append(max(abs(zero.pitch_error_rad), abs(zero.roll_error_rad)))
    return {
        "pitch": max(pitch_off),
        "roll": max(roll_off),
        "wrong": int(wrong),
        "level": max(level),
        "statuses": _wrong_statuses(),
        "near_axis": float(_near_axis()),
    }


def _wrong_statuses() -> int:
    """Return how many of four poses without a horizon point get another status than their own."""
    r = np.array([RADIUS_M + 500e3, 0.0, 0.0])
    down = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[-1.0, 0.0, 0.0]])[0].as_quat()
    up = Rotation.align_vectors([[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])[0].as_quat()
    cases = [
        (r, down, ReadingStatus.BORESIGHT_AT_NADIR),
        (r, up, ReadingStatus.BORESIGHT_AT_ZENITH),
        (0.5 * r, down, ReadingStatus.INSIDE_EARTH),
        (np.array([RADIUS_M, 0.0, 0.0]), up, ReadingStatus.INSIDE_EARTH),
    ]
    return sum(ideal_horizon_sensor(place, q, RADIUS_M).status is not status for place, q, status in cases)


def _near_axis() -> float:
    """Return the largest departure [rad] of the pitch with the boresight 1e-8 to 1e-3 rad from nadir and zenith."""
    r = np.array([0.0, 0.0, RADIUS_M + 500e3])
    rho = _theta(r)
    off = []
    for small in 10.0 ** np.arange(-8.0, -2.0):
        for elevation in (-rho + small, math.pi - rho - small):
            reading = ideal_horizon_sensor(r, pose_above_horizon(r, RADIUS_M, elevation, 0.0, 0.3), RADIUS_M)
            off.append(abs(reading.pitch_error_rad - elevation))
    return max(off)
