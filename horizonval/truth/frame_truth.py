"""The exact truth of a frame, from its specification alone, and what parts of the spacecraft hide.

Everything is float64 and closed form, without the renderer.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import horizon_rise_m
from horizonval.earth.optical import OpticalModel, optical_model
from horizonval.earth.spectral.thermal_absorption import thermal_accuracy
from horizonval.frame import FRAME_SCHEMA, FrameTruth
from horizonval.geometry.camera import CameraModel, camera_from_spec, check_invertible, project
from horizonval.geometry.ellipsoid import Ellipsoid, geocentric_nadir, geodetic_nadir
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import angular_radius, horizon_cam
from horizonval.geometry.part import Outline, all_triangles_cam, blocked, outline_of
from horizonval.geometry.pose import Pose, direction_from_horizontal, place_from_spec, pose_from_spec
from horizonval.geometry.rotation import tangent_basis
from horizonval.geometry.sun_and_moon import (
    AU_M,
    MOON_RADIUS_M,
    moon_itrs,
    phase_angle,
    sun_angular_radius,
    sun_itrs,
    sun_visible_fraction,
)
from horizonval.spec.camera import Band, CameraSpec
from horizonval.spec.scene import SceneSpec, SpacecraftPart
from horizonval.truth.infrared_horizon import infrared_horizon

LIMB_SAMPLES = 3600
_RINGS, _TURNS = 4, 16


def parts_truth(scene: SceneSpec, camera: CameraSpec, pose: Pose, sun_itrs: ArrayLike) -> dict[str, Any]:
    """Return :attr:`horizonval.frame.FrameTruth.parts` of a scene with parts; the Sun is a unit vector.

    Errors as :func:`horizonval.geometry.part.triangles_cam` and :func:`horizonval.geometry.part.outline_of`.
    """
    model = camera_from_spec(camera.camera)
    triangles = part_triangles(scene.part, pose.q_cam_from_body)
    outline = _outline(_key(scene.part), tuple(float(c) for c in pose.q_cam_from_body), model)
    sun = rotate(pose.q_cam_from_itrs, sun_itrs)
    return {
        "names": [part.name for part in scene.part],
        "outline": outline.to_dict(),
        "hidden_limb": _hidden_limb(outline, model, pose),
        "hidden_sun": float(blocked(np.concatenate(triangles), _disc(sun, float(sun_angular_radius(AU_M)))).mean()),
    }


def part_triangles(parts: Sequence[SpacecraftPart], q_cam_from_body: ArrayLike) -> list[FloatArray]:
    """Return the triangles of parts in camera axes [m], shape (n, 3, 3) each; those of the last mountings stay."""
    return _triangles(_key(parts), tuple(float(c) for c in np.asarray(q_cam_from_body)))


def _key(parts: Sequence[SpacecraftPart]) -> str:
    """Return what a part's shape depends on; of files also when they were changed."""
    changed = [_stamp(part.file) for part in parts if part.file is not None]
    return json.dumps([[part.model_dump(mode="json") for part in parts], changed])


def _stamp(file: str) -> list[int]:
    try:
        status = Path(file).stat()
    except OSError:
        return []
    return [status.st_size, status.st_mtime_ns]


@lru_cache(maxsize=16)
def _triangles(key: str, q_cam_from_body: tuple[float, ...]) -> list[FloatArray]:
    parts = [SpacecraftPart.model_validate(data) for data in json.loads(key)[0]]
    return all_triangles_cam(parts, q_cam_from_body)


@lru_cache(maxsize=16)
def _outline(key: str, q_cam_from_body: tuple[float, ...], camera: CameraModel) -> Outline:
    return outline_of(_triangles(key, q_cam_from_body), camera)


def _hidden_limb(outline: Outline, camera: CameraModel, pose: Pose) -> float | None:
    limb = horizon_cam(pose.r_itrs, pose.q_cam_from_itrs, pose.ellipsoid, LIMB_SAMPLES)
    uv, _ = project(camera, limb)
    # comparisons with NaN, the mark of a direction without an image, are False
    inside = (
        np.abs(uv - [(camera.width - 1) / 2, (camera.height - 1) / 2]) <= [camera.width / 2, camera.height / 2]
    ).all(axis=-1)
    return float(outline.covers(limb[inside]).mean()) if inside.any() else None


def _disc(centre: FloatArray, radius_rad: float) -> FloatArray:
    """Return directions over a disc, each for the same solid angle."""
    radius = radius_rad * np.sqrt((np.arange(_RINGS) + 0.5) / _RINGS)
    turn = math.tau * (np.arange(_TURNS) + 0.5) / _TURNS
    x, y = np.outer(radius, np.cos(turn)).ravel(), np.outer(radius, np.sin(turn)).ravel()
    return np.asarray(centre + np.column_stack([x, y]) @ tangent_basis(centre).T)


BESIDE = ("prior", "calibration")
"""Tables of a scene that change neither frame nor noise."""


def scene_id(scene: dict[str, Any], camera: dict[str, Any]) -> str:
    """Return the sha256 hex digest of resolved scene, camera and frame schema, as JSON with sorted keys.

    Priors and calibration are left out: they do not change the image or its noise.
    """
    seen = {key: table for key, table in scene.items() if key not in BESIDE}
    document = {"camera": camera, "frame_schema": FRAME_SCHEMA, "scene": seen}
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def moon_place(scene: SceneSpec) -> Any:
    """Return the Moon's centre in Earth-fixed axes [m], seen from the geocentre, shape (3,), or None for no Moon.

    Placed by hand it is seen under that direction from the camera, at its distance of that instant.
    """
    return _moon_place(scene, *place_from_spec(scene))


def _moon_place(scene: SceneSpec, ellipsoid: Ellipsoid, r_itrs: Any) -> Any:
    if not scene.moon.enabled or (scene.sun is not None and scene.moon.zenith_deg is None):
        return None
    place = moon_itrs(scene.platform.epoch_utc)
    if scene.moon.zenith_deg is None:
        return place
    direction = direction_from_horizontal(
        math.radians(scene.moon.zenith_deg), math.radians(scene.moon.azimuth_deg), r_itrs, ellipsoid
    )
    return np.asarray(r_itrs) + direction * np.linalg.norm(place - r_itrs)


def truth_of(scene: SceneSpec, camera: CameraSpec, *, infrared: bool = True) -> FrameTruth:
    """Return the truth of the frame that a resolved scene and camera describe; both are stored as plain data.

    The Sun comes from the epoch (apparent, geocentric), or from ``[sun]`` as a direction at infinity seen from the
    geodetic sub-satellite point; its angular radius comes from the epoch in both cases. The share of the disc in view
    is exact for that direction and the ellipsoid, refraction left out. The Moon is seen from the camera; see
    :func:`moon_place`. ``infrared`` False leaves the infrared horizon empty (up to 2 s for every thermal band, once for
    every position and air); :func:`with_infrared_horizon` adds it.

    Raises
    ------
    UserError
        The camera is not above the surface, its distortion folds inside the image, the scene does not choose one of its
        heads, a part of the spacecraft is impossible, or the epoch is outside 1960 to 2099; with the infrared horizon
        also as :func:`horizonval.earth.optical.optical_model`.
    """
    check_invertible(camera_from_spec(camera.camera))
    pose = pose_from_spec(scene, camera)
    direction, distance_m = sun_itrs(scene.platform.epoch_utc)
    if scene.sun is not None:
        direction = direction_from_horizontal(
            math.radians(scene.sun.zenith_deg), math.radians(scene.sun.azimuth_deg), pose.r_itrs, pose.ellipsoid
        )
    radius = float(sun_angular_radius(distance_m))
    rise = horizon_rise_m(scene, camera, pose.altitude_m, pose.ellipsoid.mean_radius_m)
    moon: dict[str, Any] = {}
    to_moon = None
    place = _moon_place(scene, pose.ellipsoid, pose.r_itrs)
    if place is not None:
        line = place - pose.r_itrs
        distance = float(np.linalg.norm(line))
        to_moon = line / distance
        moon_radius = math.asin(MOON_RADIUS_M / distance)
        moon = {
            "moon_itrs": _components(to_moon),
            "moon_angular_radius_rad": moon_radius,
            "moon_visible_fraction": float(sun_visible_fraction(pose.r_itrs, to_moon, moon_radius, pose.ellipsoid)),
            "moon_phase_angle_rad": phase_angle(direction * distance_m - place, -line),
        }
    truth = FrameTruth(
        epoch_utc=scene.platform.epoch_utc.isoformat(),
        ellipsoid_a_m=pose.ellipsoid.a_m,
        ellipsoid_b_m=pose.ellipsoid.b_m,
        r_itrs=_components(pose.r_itrs),
        altitude_m=pose.altitude_m,
        sun_itrs=_components(direction),
        sun_angular_radius_rad=radius,
        sun_visible_fraction=float(sun_visible_fraction(pose.r_itrs, direction, radius, pose.ellipsoid)),
        angular_radius_rad=angular_radius(pose.r_itrs, pose.ellipsoid),
        horizon_rise_m=rise,
        refracted_angular_radius_rad=angular_radius(pose.r_itrs, pose.ellipsoid.raised(rise)),
        **moon,
        **_attitude_fields(scene, camera, pose, direction, to_moon),
    )
    thermal = [band for band in camera.band if band.kind == "thermal"]
    if not (infrared and thermal):
        return truth
    return with_infrared_horizon(truth, optical_model(scene, camera.model_copy(update={"band": thermal})))


def truth_turned(truth: FrameTruth, scene: SceneSpec, camera: CameraSpec) -> FrameTruth:
    """Return the truth of a scene that differs from a truth's own in attitude and mounting alone.

    Everything else is copied, the infrared horizon too: bit by bit what :func:`truth_of` returns.
    """
    fields = _attitude_fields(scene, camera, pose_from_spec(scene, camera), truth.sun_itrs, truth.moon_itrs)
    # A copy of its own; plain data outlives JSON bit by bit, and quicker than element by element.
    horizon = json.loads(json.dumps(truth.infrared_horizon))
    return replace(truth, **fields, infrared_horizon=horizon)


def _attitude_fields(
    scene: SceneSpec, camera: CameraSpec, pose: Pose, to_sun: ArrayLike, to_moon: ArrayLike | None
) -> dict[str, Any]:
    """Return the fields of a truth that change with the attitude; directions in Earth-fixed axes."""
    scene_data, camera_data = scene.model_dump(mode="json"), camera.model_dump(mode="json")
    if scene.earth.shape == "wgs84":
        # A radius beside WGS84 is refused when a scene is read, and this scene must be readable again.
        del scene_data["earth"]["radius_km"]
    if scene.surface.kind == "earth":
        del scene_data["surface"]["albedo"], scene_data["surface"]["emissivity"]
    q = pose.q_cam_from_itrs
    parts: dict[str, Any] = {}
    if scene.part:
        parts = {"parts": parts_truth(scene, camera, pose, to_sun)}
    return parts | {
        "scene": scene_data,
        "camera": camera_data,
        "scene_id": scene_id(scene_data, camera_data),
        "q_cam_from_itrs": _components(q),
        "q_cam_from_body": _components(pose.q_cam_from_body),
        "q_body_from_lvlh": _components(pose.q_body_from_lvlh),
        "yaw_rad": pose.yaw_rad,
        "pitch_rad": pose.pitch_rad,
        "roll_rad": pose.roll_rad,
        "sun_cam": _components(rotate(q, to_sun)),
        "moon_cam": None if to_moon is None else _components(rotate(q, to_moon)),
        "nadir_geocentric_cam": _components(rotate(q, geocentric_nadir(pose.r_itrs))),
        "nadir_geodetic_cam": _components(rotate(q, geodetic_nadir(pose.r_itrs, pose.ellipsoid))),
    }


def _components(v: ArrayLike) -> Any:
    # + 0.0 turns -0.0 into 0.0: equal truths then have equal text.
    return tuple(float(x) + 0.0 for x in np.asarray(v))


def with_infrared_horizon(truth: FrameTruth, model: OpticalModel) -> FrameTruth:
    """Return a truth with the infrared horizon of the optical model of its scene and camera.

    Every band also has ``accuracy``, that of :func:`horizonval.earth.spectral.thermal_absorption.thermal_accuracy`, or
    None where the absorption comes from an atmosphere file.
    """
    ellipsoid = truth.ellipsoid
    horizon_by_band = infrared_horizon(model, truth.r_itrs, ellipsoid, sun_itrs=truth.sun_itrs)
    from_file = truth.scene.get("atmosphere", {}).get("file") is not None
    bands = {band.name: band for band in truth.camera_spec.band}
    for name, horizon in horizon_by_band.items():
        horizon["accuracy"] = None if from_file else _plain_accuracy(bands[name])
    return replace(truth, infrared_horizon=horizon_by_band)


def _plain_accuracy(band: Band) -> dict[str, Any]:
    """Return the stated accuracy of a band as plain data; None for the open ends of its heights."""
    stated = thermal_accuracy(band)
    return {
        "interval": stated.interval,
        "heights_km": [[x if math.isfinite(x) else None for x in pair] for pair in stated.ranges_km],
        "relative": list(stated.relative),
        "half_height_km": stated.half_height_km,
        "nadir_k": stated.nadir_k,
        "sentences": list(stated.sentences),
    }
