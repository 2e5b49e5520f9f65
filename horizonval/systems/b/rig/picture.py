"""The picture on the panel: the Earth's limb as a camera in orbit would see it, at the panel's own resolution.

From the distance ``D`` a panel of pixel pitch ``p`` shows angles rightly if the picture's focal length is ``D / p``
pixels. The picture is a frame of our own renderer through such a pinhole: a level satellite at 500 km, boresight
horizontal along the pitch axis, the Sun high. It is scaled so that its brightest pixel is white; the eight-bit levels
undo the panel's gamma.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec
from horizonval.systems.b.rig.scene import Panel

ALTITUDE_KM = 500.0
_DEEP = 65535


@dataclass(frozen=True)
class Shown:
    """What the panel is asked to show: share of white, shape (H, W), in steps of 1/65535."""

    share: FloatArray


def scene_shown() -> SceneSpec:
    """Return the scene on the panel."""
    return SceneSpec.model_validate(
        {
            "scene": {"name": "panel"},
            "camera": {"file": "panel", "mount_roll_deg": 90.0},
            "platform": {"altitude_km": ALTITUDE_KM},
            "earth": {"shape": "sphere"},
            "sun": {"zenith_deg": 20.0, "azimuth_deg": 270.0},
            "render": {"subsamples": 1, "nodes": 64},
        }
    )


def camera_shown(panel: Panel, distance_mm: float, camera: CameraSpec) -> CameraSpec:
    """Return the pinhole whose image the panel shows rightly from a distance, in the band of the bench's camera."""
    return CameraSpec.model_validate(
        {
            "camera": {
                "name": "panel",
                "width": panel.width,
                "height": panel.height,
                "fx": distance_mm / panel.pitch_mm,
            },
            "band": [band.model_dump() for band in camera.band],
        }
    )


def picture(panel: Panel, distance_mm: float, camera: CameraSpec) -> Shown:
    """Render what the panel shows."""
    frame = render_frame(scene_shown(), camera_shown(panel, distance_mm, camera))
    radiance = np.asarray(frame.radiance[camera.band[0].name], dtype=np.float64)
    return Shown(np.rint(radiance / radiance.max() * _DEEP) / _DEEP)


def packed(shown: Shown) -> str:
    """Return the picture as base64 of a 16-bit PNG; lossless."""
    done, data = cv2.imencode(".png", np.rint(shown.share * _DEEP).astype(np.uint16))
    if not done:
        raise RuntimeError("the picture could not be packed")
    return base64.b64encode(data.tobytes()).decode("ascii")


@lru_cache(maxsize=2)
def unpacked(text: str) -> Shown:
    """Return the picture that :func:`packed` made."""
    data = np.frombuffer(base64.b64decode(text), dtype=np.uint8)
    return Shown(np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), dtype=np.float64) / _DEEP)
