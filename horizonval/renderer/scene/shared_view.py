"""Which frames share their tables of light: those of one place, one Sun and one air, seen through the same bands."""

from __future__ import annotations

import hashlib

from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

_OF_THE_FRAME = {"scene": True, "camera": True, "attitude": True, "clouds": True, "platform": {"heading_deg"}}
"""What of a scene no table hangs on: where the camera looks, and clouds, which only end rays."""


def shared_view(scene: SceneSpec, camera: CameraSpec) -> str:
    """Return a digest that is equal for frames which share their tables.

    It may differ for some that do all the same: it says what is best made one after another, and no result hangs on it.

    Parameters
    ----------
    scene, camera
        Resolved specifications.
    """
    place = scene.model_dump_json(exclude=_OF_THE_FRAME)
    bands = "".join(band.model_dump_json() for band in camera.band)
    return hashlib.sha256(f"{place}\n{bands}".encode()).hexdigest()
