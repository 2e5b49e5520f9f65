"""The plugins' settings as text properties of Mitsuba, for scene files."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from horizonval.geometry.camera import CameraModel
from horizonval.renderer.plugin.settings import CameraSettings, LimbSettings
from horizonval.renderer.scene.description import describe
from horizonval.renderer.types import PluginDict
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

INTEGRATOR, SENSOR = "horizon_limb", "horizon_camera"


def limb_properties(scene: SceneSpec, camera: CameraSpec) -> PluginDict:
    """Return the integrator's properties for a file: the scene as its specification."""
    text = {k: v.model_dump(mode="json", exclude_unset=True) for k, v in (("scene", scene), ("camera", camera))}
    return {"type": INTEGRATOR, "scene": json.dumps(text, sort_keys=True)}


def limb_settings(properties: Any) -> LimbSettings:
    """Return the settings of :func:`limb_properties`; ``properties`` is Mitsuba's object."""
    text = json.loads(properties.get("scene"))
    return describe(SceneSpec.model_validate(text["scene"]), CameraSpec.model_validate(text["camera"])).limb


def camera_properties(camera: CameraSettings) -> PluginDict:
    """Return the sensor's properties. JSON carries float64 exactly; Mitsuba's own vectors would not."""
    pose = {
        "r_itrs_m": [float(v) for v in camera.r_itrs],
        "itrs_from_cam": [float(v) for v in camera.itrs_from_cam.ravel()],
    }
    return {
        "type": SENSOR,
        "camera": json.dumps(asdict(camera.camera)),
        "pose": json.dumps(pose),
        "film": film_properties(camera.camera),
    }


def film_properties(camera: CameraModel) -> PluginDict:
    """Return the stock film behind a camera."""
    return {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "pixel_format": "luminance",
        "rfilter": {"type": "box"},
    }


def camera_settings(properties: Any) -> CameraSettings:
    """Return the settings written by :func:`camera_properties`; ``properties`` is Mitsuba's object."""
    pose = json.loads(properties.get("pose"))
    camera = CameraModel(**_with_tuples(json.loads(properties.get("camera"))))
    return CameraSettings(camera, np.array(pose["r_itrs_m"]), np.array(pose["itrs_from_cam"]).reshape(3, 3))


def _with_tuples(data: dict[str, Any]) -> dict[str, Any]:
    """Return the same with tuples for JSON's lists."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}
