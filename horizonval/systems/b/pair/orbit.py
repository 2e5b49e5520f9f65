"""Once round an orbit that passes through the Earth's shadow, with the visible pair and with an infrared one.

Places along a circular orbit at one instant (the Earth's turn during the hour and a half is left out: it moves nothing
that the limb depends on).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.estimation.methods import linear_heads
from horizonval.plugins.registry import run_safely
from horizonval.renderer.frame import render_frame
from horizonval.scoring.errors import score
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec
from horizonval.suites.observation import observation_of_heads
from horizonval.systems.b.pair.applicability import LIMIT_DEG, PUBLISHED, rms
from horizonval.systems.b.pair.frames import THERMAL, pair, scene, view
from horizonval.systems.published import page_text
from horizonval.systems.result import ComparisonRow, Table
from horizonval.systems.task_cache import TaskCache
from horizonval.systems.weather_viewpoints import place_on_orbit
from horizonval.truth.frame_truth import truth_of

POSITIONS = 24
INCLINATION_DEG = 97.4
NODE_LONGITUDE_DEG = 15.0
"""Longitude of the ascending node at 12:00 UTC: an hour past local noon, so that a third of the orbit is in shadow."""
EPOCH = "2026-03-20T12:00:00Z"
LARGEST_TILT_DEG = 4.0
"""Largest roll and pitch: the range of the published infrared sensor's heads, of 16 deg each."""
ALTITUDE_KM = 400.0
"""For which those heads are set."""
WIDTH_PX = 512
CAMERA, HOUSING_YAW_DEG = "ir-linear-160-four-heads", 90.0
"""The four linear heads of system D, and the turn of their housing."""
VISIBLE, COASTS = "visible pair, plain ground", "visible pair, coasts"
INFRARED, LINEAR = "infrared pair", "infrared, four linear heads"


@dataclass(frozen=True)
class Lap:
    """One orbit: argument of latitude [deg], each sensor's results, and the visible share ``lit`` of the Sun's disc."""

    argument_deg: list[float]
    lit: list[float]
    by_sensor: dict[str, list[JsonObject]]


def place(argument_deg: float) -> JsonObject:
    """Return the scene's platform table at one argument of latitude."""
    angles = (math.radians(angle) for angle in (argument_deg, INCLINATION_DEG, NODE_LONGITUDE_DEG))
    return {"epoch_utc": EPOCH, "altitude_km": ALTITUDE_KM, **place_on_orbit(*angles)}


def seen(item: JsonObject) -> JsonObject:
    """Return what one pair sees from one place, and how much of the Sun the satellite sees."""
    return {**view(item), "lit": _lit(item)}


def read_heads(item: JsonObject) -> JsonObject:
    """Return what the four linear heads make of one place: sub-pixel crossings and the cone through them."""
    camera = load_camera(CAMERA)
    frames = {}
    for head in camera.head:
        use = {"file": CAMERA, "head": head.name, "mount_yaw_deg": HOUSING_YAW_DEG}
        frames[head.name] = render_frame(SceneSpec.model_validate({**item["scene"], "camera": use}), camera)
    images = {name: observe(frame, camera, seed=item["seed"]) for name, frame in frames.items()}
    result = run_safely(linear_heads.ESTIMATOR, observation_of_heads(images, linear_heads.ESTIMATOR))
    scored = score(next(iter(images.values())).truth, linear_heads.ESTIMATOR, result)
    error = scored.nadir_error_arcsec
    return {
        "status": scored.status,
        "reason": scored.reason,
        "error_deg": {} if error is None else {"SIGHT": error / 3600.0},
    }


def _lit(item: JsonObject) -> float:
    camera = CameraSpec.model_validate(item["camera"])
    chosen = SceneSpec.model_validate({**item["scene"], "camera": {"file": "pair", "head": camera.head[0].name}})
    return truth_of(chosen, camera, infrared=False).sun_visible_fraction


def lap(cache: TaskCache) -> Lap:
    """Do the experiment: all sensors at the same places in the same attitudes."""
    arguments = [360.0 * k / POSITIONS for k in range(POSITIONS)]
    tilts = cache.rng("B", "orbit", "attitudes").uniform(-LARGEST_TILT_DEG, LARGEST_TILT_DEG, (POSITIONS, 2))
    turns = cache.rng("B", "orbit", "turns").uniform(-180.0, 180.0, POSITIONS)
    one_air, own_air = {"profile": "us_standard"}, {"profile": "by_latitude_month"}
    plain, coasts = {"kind": "uniform"}, {"kind": "earth"}
    sensors = {
        VISIBLE: (seen, pair(WIDTH_PX), one_air, plain),
        COASTS: (seen, pair(WIDTH_PX), one_air, coasts),
        INFRARED: (seen, pair(WIDTH_PX, tables=THERMAL), own_air, coasts),
        LINEAR: (read_heads, {}, own_air, coasts),
    }
    by_sensor: dict[str, list[JsonObject]] = {}
    for sensor, (work, camera, air, ground) in sensors.items():
        items = {}
        for argument, (pitch, roll), turn in zip(arguments, tilts, turns, strict=True):
            tables = {
                "platform": place(argument),
                "attitude": {"yaw_deg": float(turn), "pitch_deg": float(pitch), "roll_deg": float(roll)},
                "atmosphere": air,
                "surface": ground,
            }
            made = scene(f"orbit-{argument:g}", air=True, **tables)
            items[f"{argument:g}"] = {"camera": camera, "scene": made, "seed": cache.seed, "searched": True}
        by_sensor[sensor] = list(cache.each(f"B: orbit, {sensor}", work, items).values())
    return Lap(arguments, [one["lit"] for one in by_sensor[VISIBLE]], by_sensor)


def errors_deg(found: list[JsonObject], *, by_search: bool = False) -> FloatArray:
    """Return the nadir error of every position, NaN where there is no answer; or that of the search that asks."""
    kept = [one["searched"] if by_search else one for one in found]
    return np.array([one["error_deg"].get("SIGHT", np.nan) for one in kept])


TEXT = page_text("B")


def in_shadow(orbit: Lap) -> np.ndarray:
    """Return which positions lie in the Earth's shadow."""
    return np.array(orbit.lit) < 0.5


def orbit_rows(orbit: Lap) -> list[ComparisonRow]:
    """Return the rows of the shadowed segment and of the comparison with infrared."""
    dark = in_shadow(orbit)
    visible = errors_deg(orbit.by_sensor[VISIBLE])
    infrared = errors_deg(orbit.by_sensor[INFRARED])
    linear = errors_deg(orbit.by_sensor[LINEAR])
    asked = errors_deg(orbit.by_sensor[VISIBLE], by_search=True)
    both = np.isfinite(asked) & np.isfinite(infrared)
    claims = {key: figure.value for key, figure in PUBLISHED.figures.items()}
    return [
        TEXT.row(
            "shadow",
            float(np.mean(np.isnan(visible[dark]))),
            claims["shadow"],
            limit=1.0,
            at_least=True,
            dark=int(dark.sum()),
            positions=len(dark),
        ),
        TEXT.row("lit", _wrong(visible[~dark]), answered=_share(asked[~dark]), wrong=_wrong(asked[~dark])),
        TEXT.row(
            "visible",
            rms(asked),
            claims["infrared"],
            answered=int(np.isfinite(asked).sum()),
            positions=len(asked),
            infrared=rms(infrared[both]),
        ),
        TEXT.row("infrared", rms(infrared), answered=_share(infrared)),
        TEXT.row("linear", rms(linear), answered=_share(linear)),
    ]


def verdict(orbit: Lap) -> dict[str, float]:
    """Return what decides the claim that the visible vertical is as accurate as an infrared one.

    ``comparable``: whether the visible pair's rms with the limb search is within twice the infrared one's.
    """
    asked = errors_deg(orbit.by_sensor[VISIBLE], by_search=True)
    longest_edge = errors_deg(orbit.by_sensor[VISIBLE])
    infrared = errors_deg(orbit.by_sensor[INFRARED])
    return {
        "comparable": rms(asked) / rms(infrared) <= 2.0,
        "visible_deg": rms(asked),
        "infrared_deg": rms(infrared),
        "answered": _share(asked),
        "infrared_answered": _share(infrared),
        "claimed": _share(longest_edge),
        "wrong": _wrong(longest_edge),
    }


def orbit_table(orbit: Lap) -> Table:
    """Return the table of all sensors on the orbit."""
    dark = in_shadow(orbit)
    lines = []
    for sensor, found in orbit.by_sensor.items():
        for by_search in (False, True):
            if by_search and sensor == LINEAR:
                continue
            error = errors_deg(found, by_search=by_search)
            median = float(np.nanmedian(error)) if np.isfinite(error).any() else None
            lines.append(
                (
                    f"{sensor}{', search that asks' if by_search else ''}",
                    _share(error[~dark]),
                    _share(error[dark]),
                    median,
                    rms(error) if median is not None else None,
                    _wrong(error),
                )
            )
    return TEXT.table("orbit", lines, positions=len(dark))


def _share(error: np.ndarray) -> float:
    return float(np.mean(np.isfinite(error))) if len(error) else 0.0


def _wrong(error: np.ndarray) -> float:
    claimed = error[np.isfinite(error)]
    return float(np.mean(claimed > LIMIT_DEG)) if len(claimed) else 0.0
