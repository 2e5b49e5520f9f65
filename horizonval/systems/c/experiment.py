"""System C: the ideal horizon-sensor module of a space simulator, compared with the exact horizon.

:func:`horizonval.horizon_sensor` is compared with the nearest point of the exact horizon curve, with poses whose errors
are known by construction, and with rendered pictures, read without any pose. The documentation's sentences are tested
literally under every choice of the axes of its horizon-point matrix HR.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods.ideal import ReadingStatus, horizon_sensor
from horizonval.geometry.camera import unproject
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import fit_cone, horizon_directions, limb_side
from horizonval.geometry.rotation import angle_between, off_axis_angle, perpendicular
from horizonval.systems.covered_edge import column_edges
from horizonval.systems.entries import Result, Table, Values
from horizonval.systems.task_cache import TaskCache, rng_of

RADIUS_M = 6371e3
POSES = 1000
CHORD_RAD = 1e-3
"""Half of the chord of :func:`exact_axes` in the curve's parameter; exact at any length, but for rounding."""
SAME_RAD = 1e-9
CAMERA = "ir-bolometer-160-57deg"
PICTURES = ((55.0, 25.0, 500.0), (0.0, 65.0, 500.0), (-40.0, 20.0, 2000.0))
"""Mounting pitch and roll [deg] and altitude [km]: a level limb, an upright one, and a boresight above the horizon."""


def exact_axes(r: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, float]:
    """Return direction to the nearest horizon point, level and up axes there, and the side of the boresight.

    The nearest point of the horizon curve is where its chord is perpendicular to the boresight, found by root finding:
    a circle's chord is parallel to the tangent at its middle. Reference axes; the side is positive above the horizon.
    """
    earth = sphere(RADIUS_M)
    forward = Rotation.from_quat(q).inv().apply([0.0, 0.0, 1.0])

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
    return point, level, up / np.linalg.norm(up), -float(limb_side(forward, r, earth))


def pose_above_horizon(r: FloatArray, elevation_rad: float, roll_rad: float, azimuth_rad: float) -> FloatArray:
    """Return the attitude, scalar last, of a boresight above the horizon, its right axis up by the roll."""
    zenith = r / np.linalg.norm(r)
    level = Rotation.from_rotvec(azimuth_rad * zenith).apply(perpendicular(zenith))
    nadir_angle = _theta(r) + elevation_rad
    forward = -math.cos(nadir_angle) * zenith + math.sin(nadir_angle) * level
    up = math.sin(nadir_angle) * zenith + math.cos(nadir_angle) * level
    ref_from_cam = np.column_stack([np.cross(forward, up), -up, forward])
    return (Rotation.from_euler("z", roll_rad) * Rotation.from_matrix(ref_from_cam).inv()).as_quat()


def random_poses(rng: np.random.Generator, count: int) -> list[tuple[FloatArray, FloatArray]]:
    """Return positions [m] from 100 to 100 000 km up, in all directions, with all attitudes."""
    altitude = 10.0 ** rng.uniform(5.0, 8.0, count)
    direction = Rotation.random(count, rng=rng).apply([1.0, 0.0, 0.0])
    attitude = Rotation.random(count, rng=rng).as_quat()
    return list(zip(direction * (RADIUS_M + altitude)[:, None], attitude, strict=True))


CHOICES = tuple(
    (forward, up, right)
    for forward, up in itertools.product(("to H", "from H", "away", "down"), repeat=2)
    for right in ("right", "left")
    if (forward in ("to H", "from H")) != (up in ("to H", "from H"))
)
"""HR's forward and up axes, and which way its right axis points."""


def literal_holds(
    axes: dict[str, FloatArray], choice: tuple[str, str, str], forward: FloatArray, right: FloatArray, exact: FloatArray
) -> tuple[bool, bool]:
    """Return whether the printed roll and the printed pitch equal the exact ones [rad] with HR's axes so chosen.

    Printed: roll is the angle from the sensor's right axis to HR's, signed by its product with HR's up; pitch is the
    angle from the sensor's forward axis to HR's up, signed by its product with HR's forward.
    """
    hr_forward, hr_up, hr_right = (axes[name] for name in choice)
    printed = (
        math.copysign(angle_between(right, hr_right), float(right @ hr_up)),
        math.copysign(angle_between(forward, hr_up), float(forward @ hr_forward)),
    )
    roll, pitch = (abs(math.remainder(a - b, math.tau)) < SAME_RAD for a, b in zip(printed, exact, strict=True))
    return roll, pitch


def random_figures(item: JsonObject) -> JsonObject:
    """Return the largest differences to the exact curve, and in how many poses the printed sentences hold."""
    off = []
    holds = {choice: np.zeros(3) for choice in CHOICES}
    for r, q in random_poses(rng_of(item["seed"], "ideal module", "poses"), item["count"]):
        reading = horizon_sensor(r, q, RADIUS_M)
        forward, right = (Rotation.from_quat(q).inv().apply(v) for v in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
        point, level, up, side = exact_axes(r, q)
        exact = np.array([math.copysign(angle_between(right, level), float(right @ up)),
                          math.copysign(angle_between(forward, point), side)])  # fmt: skip
        seen = Rotation.from_quat(q).inv().apply(reading.horizon_cam)
        # The line to H passes the centre at the radius: a tangent.
        theta = math.asin(np.linalg.norm(np.cross(r, seen)) / np.linalg.norm(r))
        off.append(
            (
                angle_between(seen, point),
                abs(theta - reading.theta_rad),
                abs(math.remainder(reading.roll_error_rad - exact[0], math.tau)),
                abs(reading.pitch_error_rad - exact[1]),
            )
        )
        axes = {"to H": point, "from H": -point, "away": up, "down": -up, "right": level, "left": -level}
        for choice in CHOICES:
            roll, pitch = literal_holds(axes, choice, forward, right, exact)
            holds[choice] += (roll, pitch, roll and pitch)
    return {
        "off": np.max(off, axis=0).tolist(),
        "literal": {", ".join(choice): (found / len(off)).tolist() for choice, found in holds.items()},
    }


def known_figures(item: JsonObject) -> JsonObject:
    """Return how far the readings of poses with known errors are off, and how many signs and statuses are wrong."""
    rng = rng_of(item["seed"], "ideal module", "known")
    off, level, wrong = [], [], 0
    for r, _ in random_poses(rng, item["count"]):
        elevation = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-8.0, math.log10(0.9 * _theta(r))))
        roll = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-8.0, 0.4))
        azimuth = float(rng.uniform(0.0, math.tau))
        reading = horizon_sensor(r, pose_above_horizon(r, elevation, roll, azimuth), RADIUS_M)
        off.append((abs(reading.roll_error_rad - roll), abs(reading.pitch_error_rad - elevation)))
        wrong += (reading.pitch_error_rad > 0) != (elevation > 0)
        wrong += (reading.roll_error_rad > 0) != (roll > 0)
        zero = horizon_sensor(r, pose_above_horizon(r, 0.0, 0.0, azimuth), RADIUS_M)
        level.append(max(abs(zero.pitch_error_rad), abs(zero.roll_error_rad)))
    return {"off": np.max(off, axis=0).tolist(), "level": max(level), "wrong": int(wrong), "statuses": _statuses()}


def _statuses() -> int:
    """Return how many of four poses without a nearest horizon point do not get the status that says why."""
    r = np.array([RADIUS_M + 500e3, 0.0, 0.0])
    down, up = (Rotation.align_vectors([[0.0, 0.0, 1.0]], [[x, 0.0, 0.0]])[0].as_quat() for x in (-1.0, 1.0))
    cases = [
        (r, down, ReadingStatus.BORESIGHT_AT_NADIR),
        (r, up, ReadingStatus.BORESIGHT_AT_ZENITH),
        (0.5 * r, down, ReadingStatus.INSIDE_EARTH),
        (np.array([RADIUS_M, 0.0, 0.0]), up, ReadingStatus.INSIDE_EARTH),
    ]
    return sum(horizon_sensor(place, q, RADIUS_M).status is not status for place, q, status in cases)


def picture_figures(item: JsonObject) -> JsonObject:
    """Return the larger departure [px] of the module from a rendered picture of a warm sphere without air."""
    scene = hv.Scene(
        camera=CAMERA,
        mount_pitch_deg=item["pitch"],
        mount_roll_deg=item["roll"],
        altitude_km=item["altitude_km"],
        earth={"shape": "sphere"},
        atmosphere={"profile": "none"},
        surface={"kind": "uniform", "temperature_k": 250.0},
    )
    frame = hv.render(scene, progress=False)
    radiance = np.asarray(next(iter(frame.radiance.values())), dtype=np.float64)
    camera, truth = frame.truth.camera_model, frame.truth
    roll, pitch = reading_of_edge(unproject(camera, edge_points(radiance / radiance.max())))
    module = horizon_sensor(np.array(truth.r_itrs), np.array(truth.q_cam_from_itrs), truth.ellipsoid_a_m)
    roll_off = abs(math.remainder(module.roll_error_rad - roll, math.tau))
    return {"px": max(roll_off, abs(module.pitch_error_rad - pitch)) * camera.fx}


def edge_points(share: FloatArray) -> FloatArray:
    """Return columns and rows, shape (n, 2), of the edge of a cover (H, W), by columns or by rows."""
    rows, columns = column_edges(share), column_edges(share.T)
    by_column = np.stack([np.arange(len(rows)), rows], axis=1)[np.isfinite(rows)]
    by_row = np.stack([columns, np.arange(len(columns))], axis=1)[np.isfinite(columns)]
    return by_column if len(by_column) >= len(by_row) else by_row


def reading_of_edge(los_cam: FloatArray) -> tuple[float, float]:
    """Return roll and pitch error [rad] from lines of sight (n, 3) to the horizon: a cone, its axis n and angle rho.

    With boresight f and right axis x: pitch error = angle(f, n) - rho, roll error = atan2(x . u, x . l), where l is
    n x f normalised and u = l x f.
    """
    cone = fit_cone(los_cam)
    forward, right = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])
    level = np.cross(cone.axis_cam, forward)
    level /= np.linalg.norm(level)
    roll = math.atan2(float(right @ np.cross(level, forward)), float(right @ level))
    rho = float(np.mean(off_axis_angle(los_cam, cone.axis_cam)))
    return roll, float(off_axis_angle(forward, cone.axis_cam)) - rho


def quick(cache: TaskCache) -> Values:
    """Return the figures that need no picture."""
    return _values(*_pose_figures(cache))


def reproduce(cache: TaskCache) -> Result:
    """Compare the module with curve, known poses and pictures."""
    random, known = _pose_figures(cache)
    items = {
        f"pitch {pitch:g}, roll {roll:g}, {km:g} km": {"pitch": pitch, "roll": roll, "altitude_km": km}
        for pitch, roll, km in PICTURES
    }
    pictures = cache.each("C: pictures", picture_figures, items)
    shares = Table(
        "The printed sentences under every choice of HR's axes",
        ("HR's forward", "HR's up", "HR's right", "roll holds", "pitch holds", "both hold"),
        tuple((*choice, *random["literal"][", ".join(choice)]) for choice in CHOICES),
        f"Share of {POSES} random poses in which the printed angle and sign equal the exact ones. Axes: the line to H "
        "and its opposite; away from the Earth in the plane of nadir and H, and down; right and left on the horizon.",
    )
    return Result(
        values={**_values(random, known), "picture": [one["px"] for one in pictures.values()]},
        tables=(shares,),
        settings={"radius_m": RADIUS_M, "poses": POSES, "altitude_km": [100, 100_000]},
    )


def _pose_figures(cache: TaskCache) -> tuple[JsonObject, JsonObject]:
    poses: JsonObject = {"poses": {"seed": cache.seed, "count": POSES}}
    random = cache.each("C: random poses", random_figures, poses)
    known = cache.each("C: known poses", known_figures, poses)
    return random["poses"], known["poses"]


def _values(random: JsonObject, known: JsonObject) -> Values:
    literal = np.array(list(random["literal"].values()))
    point, theta, roll, pitch = random["off"]
    return {
        "point": point,
        "theta": theta,
        "roll": float(literal[:, 0].max()),
        "pitch": float(literal[:, 1].max()),
        "one_matrix": float(literal[:, 2].max()),
        "module": [roll, pitch],
        "known": known["off"],
        "level": known["level"],
        "signs": float(known["wrong"]),
        "statuses": float(known["statuses"]),
    }


def _theta(r: FloatArray) -> float:
    return math.asin(RADIUS_M / float(np.linalg.norm(r)))
