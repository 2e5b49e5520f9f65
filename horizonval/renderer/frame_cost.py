"""How much memory a frame takes, estimated before it is rendered, and which frames share their tables of light.

Frames of one position, one Sun and one air, seen through the same bands, share their tables.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

from horizonval.core import memory
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

PROCESS_BYTES, BYTES_PER_VALUE, BYTES_PER_POINT = 250e6, 16.0, 3.2e6
"""Of a process that renders, of each pixel of a band, and of each g point of air that changes with latitude."""
BYTES_PER_PIXEL, BYTES_PER_CELL = 150.0, 50.0
"""Of each pixel of a frame, and of each cell of it where only those with an edge in them are cut."""
BYTES_PER_MARCHED_CELL, BYTES_PER_CLOUDED_CELL = 130.0, 180.0
"""Of each cell where all pixels are cut: for the march along all of them, and under clouds beside the tables."""


def frame_bytes(scene: SceneSpec, camera: CameraSpec, thermal_points: int = 0) -> float:
    """Return the peak memory of a process that makes a frame and its images [bytes].

    ``thermal_points``: g points of all thermal bands, where the air changes with latitude.
    """
    return PROCESS_BYTES + BYTES_PER_POINT * thermal_points + _pixels_bytes(scene, camera)


def refuse_too_large(scene: SceneSpec, camera: CameraSpec) -> None:
    """Raise ``UserError`` for a frame that memory does not hold, with the size of one that it does."""
    geometry = camera.camera
    what = f"a frame of {geometry.width} x {geometry.height} pixels"
    if scene.render.subsamples > 1:
        what += f", each of {scene.render.subsamples} x {scene.render.subsamples} cells,"
    room = memory.available_bytes() - PROCESS_BYTES
    scale = math.sqrt(max(room, 0.0) / _pixels_bytes(scene, camera))
    width, height = (int(scale * side) for side in (geometry.width, geometry.height))
    memory.refuse_beyond(
        frame_bytes(scene, camera),
        what,
        where="camera.width, camera.height, render.subsamples",
        fix=f"{width} x {height} pixels would fit" if min(width, height) > 0 else "",
    )


def _pixels_bytes(scene: SceneSpec, camera: CameraSpec) -> float:
    pixels, cells = camera.camera.width * camera.camera.height, scene.render.subsamples**2
    each = BYTES_PER_PIXEL + BYTES_PER_CELL * cells
    if scene.render.method == "march":
        each = BYTES_PER_MARCHED_CELL * cells
    elif scene.clouds is not None:
        each = BYTES_PER_CLOUDED_CELL * cells
    return pixels * (each + BYTES_PER_VALUE * len(camera.band))


def shared_view(scene: SceneSpec, camera: CameraSpec) -> str:
    """Return a digest that is equal for frames which share their tables.

    It may differ for some that share them: it decides only which frames are rendered one after another. Tables depend
    neither on where the camera looks nor on clouds, which only end rays.
    """
    place = _place(scene)
    del place["clouds"]
    return _digest(place, [band.model_dump_json() for band in camera.band])


def viewpoint_key(scene: SceneSpec, camera: CameraSpec) -> str:
    """Return a digest that is equal for frames of one :class:`Viewpoint`.

    They differ in attitude, mounting or head only.
    """
    drawn_by_name = scene.clouds is not None and scene.clouds.seed is None
    name = scene.scene.model_dump(mode="json") if drawn_by_name else None
    return _digest(_place(scene), name, camera.model_dump_json())


def _place(scene: SceneSpec) -> dict[str, Any]:
    """Return what a scene says but for its name and where the camera looks."""
    place = scene.model_dump(mode="json", exclude={"scene", "camera", "attitude", "prior", "calibration"})
    del place["platform"]["heading_deg"]
    return place


def _digest(*parts: Any) -> str:
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
