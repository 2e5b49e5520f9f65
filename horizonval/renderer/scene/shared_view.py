"""Which frames share their tables of light: those of one place, one Sun and one air, seen through the same bands."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec


def shared_view(scene: SceneSpec, camera: CameraSpec) -> str:
    """Return a digest that is equal for frames which share their tables.

    It may differ for some that do all the same: it says what is best made one after another, and no result hangs on it.

    No table hangs on where the camera looks, nor on clouds, which only end rays.

    Parameters
    ----------
    scene, camera
        Resolved specifications.
    """
    place = _place(scene)
    del place["clouds"]
    return _digest(place, [band.model_dump_json() for band in camera.band])


def viewpoint_key(scene: SceneSpec, camera: CameraSpec) -> str:
    """Return a digest that differs for frames which differ in more than attitude, mounting and head.

    Equal ones can be had from one :class:`horizonval.renderer.scene.viewpoint.Viewpoint`.
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
