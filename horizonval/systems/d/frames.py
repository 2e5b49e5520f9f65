"""Frames of the four linear heads: scenes, the pipeline, and the results stored for an attitude.

The housing is turned by 90 deg about the vertical, so that the published azimuths and signs are those of the body (see
:mod:`horizonval.estimation.methods.linear_heads`). The published order of the angles, "roll, pitch, yaw", is taken as
that of the matrices, ``Rx(roll) Ry(pitch) Rz(yaw)``: the only one under which the published table of yaw angles is
constant.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Refusal
from horizonval.estimation.limb.crossing import published_crossing, sub_pixel_crossing
from horizonval.estimation.methods import linear_heads
from horizonval.estimation.observation import Fit, Observation
from horizonval.frame import FrameTruth, RadianceFrame
from horizonval.geometry.camera import camera_from_spec
from horizonval.geometry.horizon import horizon_columns
from horizonval.geometry.rotation import angle_between
from horizonval.geometry.sun_and_moon import sun_itrs
from horizonval.scoring.errors import score
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.suites.observation import observation_of_heads
from horizonval.systems.d.steps import PUBLISHED
from horizonval.systems.weather_viewpoints import place_on_orbit
from horizonval.truth.frame_truth import truth_of

CAMERA = "ir-linear-160-four-heads"
HOUSING_YAW_DEG = 90.0
RADIUS_KM = PUBLISHED.number("earth_radius")
ALTITUDE_KM = PUBLISHED.number("altitude")
INCLINATION_DEG = PUBLISHED.number("inclination")
EPOCH = "2016-03-20T12:00:00+00:00"

HARD = {
    "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
    "atmosphere": {"profile": "none"},
    "surface": {"kind": "uniform", "temperature_k": 250.0},
}
"""A warm ball without air: the published pictures' hard limb. 250 K is what the whole Earth radiates at."""
SOFT = {
    "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
    "atmosphere": {"profile": "us_standard"},
}
"""Scene with the uniform limb of carbon dioxide, above the default haze."""
OBLATE = {**HARD, "earth": {"shape": "wgs84"}}
AIR = {
    "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
    "atmosphere": {"profile": "by_latitude_month"},
}
"""Scene with the air of every latitude and of the month."""
REAL = {**AIR, "earth": {"shape": "wgs84"}}


def orbit_place(argument_deg: float, epoch_utc: str) -> dict[str, Any]:
    """Return the platform on the published orbit: 97 deg, descending node at 12:00 local solar time.

    ``argument_deg``: argument of latitude from the ascending node; ``epoch_utc``: gives the Sun, hence the node's
    longitude.
    """
    epoch = datetime.fromisoformat(epoch_utc).astimezone(UTC)
    sun, _ = sun_itrs(epoch)
    node = math.atan2(sun[1], sun[0]) + math.pi
    place = place_on_orbit(math.radians(argument_deg), math.radians(INCLINATION_DEG), node)
    return {"epoch_utc": epoch, **place}


def head_camera(item: JsonObject) -> CameraSpec:
    """Return the shipped camera with an item's changes.

    ``rows``: 160 for published pictures; ``aim_deg``: nadir angle of the heads; ``optic``: keys of the lens;
    ``projection``.
    """
    camera = load_camera(CAMERA)
    changed = {"height": item.get("rows", 1), "projection": item.get("projection", camera.camera.projection)}
    geometry = camera.camera.model_copy(update=changed)
    lens = camera.optics.model_copy(update=item.get("optic", {}))
    heads = camera.head
    if "aim_deg" in item:
        heads = [head.model_copy(update={"mount_pitch_deg": item["aim_deg"]}) for head in heads]
    return camera.model_copy(update={"camera": geometry, "optics": lens, "head": heads})


def head_scene(item: JsonObject, head: str) -> SceneSpec:
    """Return the scene of one head at an item's attitude and place."""
    platform: dict[str, Any] = {"altitude_km": item.get("altitude_km", ALTITUDE_KM)}
    platform |= orbit_place(item.get("argument_deg", 180.0), item.get("epoch_utc", EPOCH))
    return SceneSpec.model_validate(
        {
            "scene": {"name": "linear-heads", "seed": item.get("seed", 0)},
            "camera": {"file": CAMERA, "head": head, "mount_yaw_deg": HOUSING_YAW_DEG},
            "platform": platform,
            "attitude": {f"{axis}_deg": item.get(axis, 0.0) for axis in ("yaw", "pitch", "roll")},
            **item["planet"],
        }
    )


def head_frames(item: JsonObject, camera: CameraSpec, heads: tuple[str, ...] = ()) -> dict[str, RadianceFrame]:
    """Return the frames of some heads, or of all, at one attitude, by the heads' names."""
    from horizonval.renderer.frame import render_frame

    names = heads or tuple(head.name for head in camera.head)
    return {name: render_frame(head_scene(item, name), camera) for name in names}


def heads_observation(frames: dict[str, RadianceFrame], camera: CameraSpec, seed: int | None) -> Observation:
    """Return what the estimators get: digital numbers of all heads; without noise for no seed."""
    from horizonval.sensor.observe import observe

    images = {name: observe(frame, camera, seed=seed or 0, noise=seed is not None) for name, frame in frames.items()}
    return observation_of_heads(images, linear_heads.ESTIMATOR)


def read_heads(item: JsonObject) -> JsonObject:
    """Render the four heads at one attitude and return both methods' results.

    ``planet``: tables of the scene. Optional: ``roll``, ``pitch``, ``yaw`` [deg], ``altitude_km``, ``argument_deg``,
    ``epoch_utc``, keys of :func:`head_camera`, and ``noise``: number of noisy readings, by the scene's ``seed``.
    """
    camera = head_camera(item)
    frames = head_frames(item, camera)
    quiet = heads_observation(frames, camera, None)
    result = _reading(quiet, frames) | {
        "exact_px": exact_crossings(frames, camera),
        "roll": item.get("roll", 0.0),
        "pitch": item.get("pitch", 0.0),
    }
    draws = [_reading(heads_observation(frames, camera, n), frames) for n in range(item.get("noise", 0))]
    if draws:
        result["noisy"] = draws
    return result


def exact_crossings(frames: dict[str, RadianceFrame], camera: CameraSpec) -> list[float | None]:
    """Return the columns [pixels] at which the exact hard horizon crosses the heads' rows; None where it does not."""
    columns = []
    for frame in frames.values():
        truth = frame.truth
        shape = truth.ellipsoid
        row = float(camera.camera.height // 2)
        geometry = camera_from_spec(camera.camera)
        found = horizon_columns(geometry, truth.q_cam_from_itrs, truth.r_itrs, [row], shape)[0, 0]
        columns.append(float(found) if math.isfinite(found) else None)
    return columns


def _reading(observation: Observation, frames: dict[str, RadianceFrame]) -> JsonObject:
    """Return crossings and angles [deg] of both methods, with the scores against the frames' truth."""
    rows = linear_heads.head_rows(observation)
    assert isinstance(rows, list)
    located = [sub_pixel_crossing(r.row) for r in rows]
    truth = next(iter(frames.values())).truth
    result: JsonObject = {
        "published_px": [published_crossing(r.row).fine for r in rows],
        "sub_pixel_px": [None if isinstance(c, Refusal) else c.column for c in located],
        "kind": ["none" if isinstance(c, Refusal) else c.kind for c in located],
        "sigma_px": [None if isinstance(c, Refusal) else c.sigma_px for c in located],
    }
    for key, estimator in (("published", linear_heads.PUBLISHED), ("sub_pixel", linear_heads.ESTIMATOR)):
        fit = estimator.run(observation)
        scored = score(truth, estimator, fit)
        result[key] = {
            "status": str(fit.status),
            "roll": math.degrees(fit.roll_rad) if isinstance(fit, Fit) else None,
            "pitch": math.degrees(fit.pitch_rad) if isinstance(fit, Fit) else None,
            "nadir_error": None if scored.nadir_error_arcsec is None else scored.nadir_error_arcsec / 3600.0,
            "nees": scored.nees_nadir,
            "geodetic_error": None if not isinstance(fit, Fit) else _geodetic_error(truth, fit),
        }
    return result


def _geodetic_error(truth: FrameTruth, fit: Fit) -> float:
    """Return the angle [deg] between the claimed nadir and the geodetic one."""
    return math.degrees(angle_between(np.array(truth.nadir_geodetic_cam), fit.nadir_cam))


def infrared_aim(item: JsonObject) -> JsonObject:
    """Return where the half plateau of the infrared horizon is at an item's place: nadir angle [deg], height [km]."""
    camera = head_camera(item)
    horizon = truth_of(head_scene(item, camera.head[0].name), camera).infrared_horizon[camera.band[0].name]
    return {
        "aim_deg": math.degrees(float(np.mean(horizon["half_plateau_angle_rad"]))),
        "height_km": float(np.mean(horizon["half_plateau_height_m"])) / 1e3,
    }


def picture(item: JsonObject) -> JsonObject:
    """Return the digital numbers of all heads as pictures, and where both locators see the limb in their middle row."""
    camera = head_camera(item)
    observation = heads_observation(head_frames(item, camera), camera, None)
    return {
        name: {
            "dn": np.asarray(head.image, dtype=int).tolist(),
            "published_px": published_crossing(head.image[len(head.image) // 2]).fine,
        }
        for name, head in observation.heads.items()
    }


def widest_tilt(item: JsonObject) -> JsonObject:
    """Return the largest t [deg] at which, with pitch -t and roll t, both heads along the tilt see a limb.

    Bisected on frames to ``step``; ``None`` where they see none even level.
    """
    camera = head_camera(item)

    def seen(tilt: float) -> bool:
        return _both_see({**item, "pitch": -tilt, "roll": tilt}, camera)

    if not seen(0.0):
        return {"tilt_deg": None}
    return {"tilt_deg": _bisected(seen, 0.0, 10.0, item["step"])}


def altitude_end(item: JsonObject) -> JsonObject:
    """Return the last altitude [km] on the way from 400 km to ``towards_km`` at which a level sensor sees the limb."""
    camera = head_camera(item)

    def seen(altitude: float) -> bool:
        return _both_see({**item, "altitude_km": altitude}, camera)

    return {"altitude_km": _bisected(seen, ALTITUDE_KM, item["towards_km"], item["step"])}


TILTED_HEADS = ("az135", "az315")
"""Opposite heads whose crossings move by sqrt(2) t when pitch is -t and roll t, one inwards, one outwards."""


def _both_see(item: JsonObject, camera: CameraSpec) -> bool:
    observation = heads_observation(head_frames(item, camera, TILTED_HEADS), camera, None)
    rows = [head.image[len(head.image) // 2] for head in observation.heads.values()]
    return all(not isinstance(sub_pixel_crossing(row), Refusal) for row in rows)


def _bisected(holds: Callable[[float], bool], good: float, bad: float, step: float) -> float:
    while abs(bad - good) > step:
        middle = 0.5 * (good + bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return good
