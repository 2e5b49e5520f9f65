"""What parts of the spacecraft hide from the camera: their outline, and how much of limb and Sun lies behind it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, camera_from_spec, project
from horizonval.geometry.directions import tangent_basis
from horizonval.geometry.ephemeris import AU_M, sun_angular_radius
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import horizon_cam
from horizonval.geometry.part.outline import Outline, outline_of
from horizonval.geometry.part.placed import all_triangles_cam, blocked
from horizonval.geometry.pose import Pose
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec, SpacecraftPart

LIMB_SAMPLES = 3600
_RINGS, _TURNS = 4, 16


def parts_truth(scene: SceneSpec, camera: CameraSpec, pose: Pose, sun_itrs: ArrayLike) -> dict[str, Any]:
    """Return :attr:`horizonval.frame.FrameTruth.parts` of a scene that has parts.

    Parameters
    ----------
    scene, camera
        Resolved specifications.
    pose : Pose
    sun_itrs : array_like, shape (3,)
        Unit vector towards the Sun.

    Raises
    ------
    UserError
        As :func:`horizonval.geometry.part.placed.triangles_cam` and
        :func:`horizonval.geometry.part.outline.outline_of`.
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
