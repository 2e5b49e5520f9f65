"""Both plugins in Mitsuba: registered by name for scene files, and made from settings for scenes in this process."""

from __future__ import annotations

from typing import Any

import mitsuba as mi

from horizonval.renderer.plugin import camera_plugin, integrator
from horizonval.renderer.plugin.scene_text import (
    INTEGRATOR,
    SENSOR,
    camera_settings,
    film_properties,
    limb_settings,
)
from horizonval.renderer.plugin.settings import CameraSettings, LimbSettings

_classes: dict[str | None, tuple[type, type]] = {}
"""Integrator and sensor, by variant."""


def register_plugins() -> None:
    """Register integrator and camera with the active variant."""
    limb, camera = _classes[mi.variant()] = integrator.make_plugin(), camera_plugin.make_plugin()
    mi.register_integrator(INTEGRATOR, lambda props: limb(props, limb_settings(props)))
    mi.register_sensor(SENSOR, lambda props: camera(props, camera_settings(props)))


def mitsuba_scene(limb: LimbSettings, camera: CameraSettings) -> Any:
    """Return a Mitsuba scene of both plugins, made from the settings themselves: nothing is written as text."""
    limb_class, _ = _classes[mi.variant()]
    film = mi.load_dict(film_properties(camera.camera))
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": limb_class(mi.Properties(INTEGRATOR), limb),
            "sensor": mitsuba_sensor(camera, film),
        }
    )


def mitsuba_sensor(camera: CameraSettings, film: Any) -> Any:
    """Return the camera's plugin before a film; cameras of one size may share it."""
    _, camera_class = _classes[mi.variant()]
    props = mi.Properties(SENSOR)
    props["film"] = film
    return camera_class(props, camera)
