"""What the altitude-free method is measured against: methods that know the altitude, and one with a second camera.

All take Canny's whole pixels of the same rendered frames. With lines of sight ``u``, the nadir ``n``, the Earth's
angular radius ``rho`` and the boresight ``f``:

- **altitude-free**: as published, n and rho together;
- **known altitude**: ``min sum (u . n - cos rho)^2`` over unit vectors n alone, rho from a right or a wrong altitude;
- **straight line**: the horizon is taken for a line in the image, fitted to its pixels. With the normal m of the plane
  through the eye and the line, and the line's direction nearest to the boresight ``h = f - (f . m) m``, normalised, the
  nadir is ``cos rho h + sin rho m``: roll from the line's slope, pitch from its distance. Needs the altitude;
- **two sensors**: the chord of each camera's arc (difference of the lines of sight to its two ends) is square to the
  nadir, so that the nadir is the cross product of the chords of two cameras. Needs no altitude, but a second camera,
  here the same one turned by 90 deg about the nadir.

Times are processor times of this machine, of the search for the pixels and of the fit that follows.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Refusal
from horizonval.estimation.limb.edges import find_canny_pixels
from horizonval.estimation.limb.picture import LimbPoints
from horizonval.estimation.methods import altitude_free_closed_form, altitude_free_published
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import CameraModel, camera_from_spec, unproject
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.spec.scene import SceneSpec
from horizonval.systems.a.bank import ARCSEC, camera_of, grid, radius_of, scene_of, set_ups
from horizonval.systems.a.rows import TEXT, rms
from horizonval.systems.result import Cell, ComparisonRow, Table

ALTITUDE_OFF = 0.01
"""Share by which the altitude that a method is given may be off."""
STEPS = 12
SMALL_RAD = 1e-12
REPEATS = 20
"""Repetitions of every timed call, the shortest of which counts."""
PIXELS, FIELD_DEG = 400, 60.0
"""Frames of the grid on which the methods are compared, in addition to the published set-ups."""


@dataclass(frozen=True)
class SeenPixels:
    """Whole pixels of one camera: lines of sight (n, 3) and places (n, 2), the camera, and the given angular radius."""

    los: FloatArray
    uv: FloatArray
    camera: CameraModel
    rho: float


def items(seed: int) -> dict[str, JsonObject]:
    """Return the published set-ups and the grid's frames of one camera, by name."""
    some = {k: v for k, v in grid(seed, (PIXELS,)).items() if v["fov_deg"] == FIELD_DEG}
    plain = {f"set-up, {name}": {**item, "picture": False} for name, item in set_ups(seed).items()}
    return plain | some


def compare(item: JsonObject) -> JsonObject:
    """Render an item's frame, and the one of the second camera; return errors [arcsec] and seconds of every method."""
    from horizonval.renderer.frame import render_frame

    camera, scene = camera_of(item), scene_of(item)
    frame = render_frame(scene, camera)
    image, model = frame.radiance["vis"].astype(np.float64), camera_from_spec(camera.camera)
    points = find_canny_pixels(image, model, None)
    if isinstance(points, Refusal):
        return {"refused": points.reason}
    nadir = np.array(frame.truth.nadir_geocentric_cam)
    turned = SceneSpec.model_validate(
        scene.model_dump(mode="json", exclude_none=True)
        | {"attitude": {"roll_deg": item["roll_deg"], "pitch_deg": item["pitch_deg"], "yaw_deg": 90.0}}
    )
    second = render_frame(turned, camera)
    beside = find_canny_pixels(second.radiance["vis"].astype(np.float64), model, None)
    seen = SeenPixels(points.los_cam, points.uv, model, radius_of(item["altitude_km"]))
    off = SeenPixels(points.los_cam, points.uv, model, radius_of(item["altitude_km"] * (1.0 + ALTITUDE_OFF)))
    observation = Observation(image=image, camera=model, full_scale=None)
    methods: dict[str, Callable[[], FloatArray | None]] = {
        "altitude_free": lambda: _published(points, observation),
        "known_altitude": lambda: known_altitude(seen),
        "known_altitude_off": lambda: known_altitude(off),
        "straight_line": lambda: straight_line(seen),
        "straight_line_off": lambda: straight_line(off),
    }
    if isinstance(beside, LimbPoints):
        to_second = Rotation.from_quat(second.truth.q_cam_from_itrs)
        mounting = Rotation.from_quat(frame.truth.q_cam_from_itrs) * to_second.inv()
        other = SeenPixels(mounting.apply(beside.los_cam), beside.uv, model, seen.rho)
        methods["two_sensors"] = lambda: two_sensors(seen, other)
    search_s = _seconds(lambda: find_canny_pixels(image, model, None), 3)
    result: JsonObject = {"search_s": search_s, "points": len(points.uv)}
    for name, method in methods.items():
        found = method()
        if found is not None:
            error = float(off_axis_angle(found, nadir)) * ARCSEC
            result[name] = {"arcsec": error, "seconds": _seconds(method, REPEATS)}
    return result


def known_altitude(seen: SeenPixels) -> FloatArray:
    """Return the nadir from an altitude that is known, by Gauss-Newton on the unit sphere from the closed form."""
    nadir = altitude_free_closed_form.solve(seen.los)[0]
    for _ in range(STEPS):
        basis = tangent_basis(nadir)
        step = np.linalg.lstsq(seen.los @ basis, np.cos(seen.rho) - seen.los @ nadir, rcond=None)[0]
        nadir = nadir + basis @ step
        nadir /= np.linalg.norm(nadir)
        if float(np.linalg.norm(step)) < SMALL_RAD:
            break
    return np.asarray(nadir)


def straight_line(seen: SeenPixels) -> FloatArray:
    """Return the nadir from a line through the pixels; which side the Earth is on the arc's bend says."""
    middle = seen.uv.mean(axis=0)
    along = np.linalg.svd(seen.uv - middle, full_matrices=False)[2][0]
    ends = unproject(seen.camera, middle + np.outer([-1.0, 1.0], along))
    normal = np.cross(*ends)
    normal /= np.linalg.norm(normal)
    if normal @ altitude_free_closed_form.solve(seen.los)[0] < 0.0:
        normal = -normal
    forward = np.array([0.0, 0.0, 1.0])
    horizon = forward - (forward @ normal) * normal
    horizon /= np.linalg.norm(horizon)
    return np.asarray(math.cos(seen.rho) * horizon + math.sin(seen.rho) * normal)


def two_sensors(first: SeenPixels, second: SeenPixels) -> FloatArray | None:
    """Return the nadir from the chords of two arcs; None where they are parallel."""
    nadir = np.cross(_chord(first), _chord(second))
    size = float(np.linalg.norm(nadir))
    if size < 1e-9:
        return None
    nadir /= size
    return np.asarray(nadir if float(np.mean(first.los @ nadir)) > 0.0 else -nadir)


def _chord(seen: SeenPixels) -> FloatArray:
    """Return the difference of the lines of sight to the two pixels of an arc that are farthest apart."""
    middle = seen.los.mean(axis=0)
    one = seen.los[np.argmax(np.linalg.norm(seen.los - middle, axis=1))]
    other = seen.los[np.argmax(np.linalg.norm(seen.los - one, axis=1))]
    return np.asarray(other - one)


def _published(points: LimbPoints, observation: Observation) -> FloatArray | None:
    fit = altitude_free_published.fit_pixels(points.los_cam, points.uv, observation)
    return fit.nadir_cam if isinstance(fit, Fit) else None


def _seconds(call: Callable[[], object], repeats: int) -> float:
    best = math.inf
    for _ in range(repeats):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best


NAMES = (
    "altitude_free",
    "known_altitude",
    "known_altitude_off",
    "straight_line",
    "straight_line_off",
    "two_sensors",
)


def errors(compared: Mapping[str, JsonObject], method: str) -> dict[str, float]:
    """Return a method's nadir errors [arcsec] by frame, of the frames that all methods answer."""
    common = {name: one for name, one in compared.items() if all(m in one for m in NAMES)}
    return {name: float(one[method]["arcsec"]) for name, one in common.items()}


def rate(compared: Mapping[str, JsonObject], method: str) -> float:
    """Return frames per second of a method with its search for pixels, median over the frames of 400 pixels."""
    cameras = 2 if method == "two_sensors" else 1
    timed = [one for name, one in compared.items() if method in one and f"{PIXELS} px" in name]
    return float(np.median([1.0 / (cameras * one["search_s"] + one[method]["seconds"]) for one in timed]))


def ratio(compared: Mapping[str, JsonObject], method: str) -> float:
    """Return the altitude-free error over a rival's, geometric mean over the frames."""
    free, other = (np.array(list(errors(compared, m).values())) for m in ("altitude_free", method))
    return float(np.exp(np.mean(np.log(free / other))))


def rival_rows(compared: Mapping[str, JsonObject]) -> list[ComparisonRow]:
    """Return the altitude-free error over that of every rival, on the same pixels."""
    free = np.array(list(errors(compared, "altitude_free").values()))
    rows = []
    for method in NAMES[1:]:
        other = np.array(list(errors(compared, method).values()))
        fields: dict[str, Any] = {"method": TEXT.phrase(method, off=ALTITUDE_OFF), "frames": len(other)}
        better = float(np.mean(free < other))
        rows.append(TEXT.row("rival", ratio(compared, method), better=better, rms=rms(other), **fields))
    return rows


def rival_table(compared: Mapping[str, JsonObject]) -> Table:
    """Return errors and frame rates of all methods."""
    lines: list[tuple[Cell, ...]] = []
    for method in NAMES:
        by_frame = errors(compared, method)
        found = np.array(list(by_frame.values()))
        published = rms(value for name, value in by_frame.items() if name.startswith("set-up"))
        spread = (rms(found), float(np.median(found)), float(found.max()), published)
        cells = (float(f"{value:.3g}") for value in spread)
        lines.append((TEXT.phrase(method, off=ALTITUDE_OFF), *cells, float(f"{rate(compared, method):.3g}")))
    return TEXT.table("rivals", lines, frames=len(errors(compared, NAMES[0])), pixels=PIXELS, field_deg=FIELD_DEG)
