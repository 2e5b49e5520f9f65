"""Which frames share their tables of light: those of one place, one Sun and one air, seen through the same bands."""

from __future__ import annotations

import hashlib
import json

from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec


def shared_view(scene: SceneSpec, camera: CameraSpec) -> str:
    """Return a digest that is equal for frames which share their tables.

    It may differ for some that do all the same: it says what is best made one after another, and no result hangs on it.

    No table hangs on where the camera looks, nor on clouds, which only end rays.

    Parameters
    ----------
    scene, camera
        Resolved specifications.
    """
    tables = scene.model_dump(mode="json", exclude={"scene", "camera", "attitude", "clouds"})
    del tables["platform"]["heading_deg"]
    place = json.dumps(tables, sort_keys=True)
    bands = "".join(band.model_dump_json() for band in camera.band)
    return hashlib.sha256(f"{place}\n{bands}".encode()).hexdigest()
