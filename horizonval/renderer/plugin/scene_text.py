"""The plugins' settings as text properties of Mitsuba, for scene files; exact to the last bit."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from horizonval.earth.clouds.relief import CloudField
from horizonval.earth.surface.surface import GroundModel
from horizonval.geometry.camera import CameraModel
from horizonval.renderer.planet import Planet
from horizonval.renderer.plugin.model_text import dump_model, load_model
from horizonval.renderer.plugin.settings import CameraSettings, LimbSettings, MoonSettings
from horizonval.renderer.types import PluginDict

INTEGRATOR, SENSOR = "horizon_limb", "horizon_camera"


def scene_properties(limb: LimbSettings, camera: CameraSettings) -> PluginDict:
    """Return a scene of both plugins as a dictionary of text, fit for a file."""
    return {"type": "scene", "integrator": limb_properties(limb), "sensor": camera_properties(camera)}


def limb_properties(limb: LimbSettings) -> PluginDict:
    """Return the integrator's properties."""
    sun = {"direction_itrs": list(limb.sun_itrs), "angular_radius_rad": limb.sun_angular_radius_rad}
    return {
        **({} if limb.ground is None else {"ground": json.dumps(asdict(limb.ground), sort_keys=True)}),
        "type": INTEGRATOR,
        "planet": json.dumps(asdict(limb.planet)),
        "model": dump_model(limb.model),
        "sun": json.dumps(sun),
        "moon": json.dumps(None if limb.moon is None else asdict(limb.moon)),
        "sunless": limb.sunless,
        "subsamples": limb.subsamples,
        "nodes": limb.nodes,
        "orders": limb.orders,
        "method": limb.method,
    }


def limb_settings(properties: Any) -> LimbSettings:
    """Return the settings written by :func:`limb_properties`; ``properties`` is Mitsuba's object."""
    sun = json.loads(properties.get("sun"))
    moon = json.loads(properties.get("moon", "null"))
    return LimbSettings(
        load_model(properties.get("model")),
        Planet(**json.loads(properties.get("planet"))),
        tuple(sun["direction_itrs"]),
        float(sun["angular_radius_rad"]),
        int(properties.get("subsamples", 2)),
        int(properties.get("nodes", 64)),
        str(properties.get("orders", "all")),
        _load_ground(properties.get("ground")) if "ground" in properties else None,
        None if moon is None else MoonSettings(**_with_tuples(moon)),
        bool(properties.get("sunless", False)),
        str(properties.get("method", "table")),
    )


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


def _load_ground(text: str) -> GroundModel:
    data = json.loads(text)
    clouds = data.pop("clouds")
    return GroundModel(**data, clouds=CloudField(**clouds) if clouds else None)


def _with_tuples(data: dict[str, Any]) -> dict[str, Any]:
    """Return the same with tuples for JSON's lists."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in data.items()}
