"""Every shipped camera, on fewer pixels, sees the limb of a bare Earth: bright ground below, dark space above."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from horizonval.frame import Hit
from horizonval.renderer.frame import render_frame
from horizonval.sensor.observe import observe
from horizonval.spec.camera import CameraSpec
from horizonval.spec.files import shipped_names
from horizonval.spec.load import load_camera
from horizonval.spec.scene import SceneSpec

MOST_PX = 32


def fewer_pixels(name: str) -> CameraSpec:
    """Return the camera with its field on at most 32 x 32 pixels; a line of detectors keeps its own."""
    spec = load_camera(name)
    tables = spec.model_dump(mode="json")
    geometry = tables["camera"]
    if spec.camera.height > 1:
        step = max(1.0, max(spec.camera.width, spec.camera.height) / MOST_PX)
        width, height = round(spec.camera.width / step), round(spec.camera.height / step)
        fx = spec.camera.focal_px / step
        geometry |= {"width": width, "height": height, "fx": fx, "fov_deg": None, "focal_length_mm": None}
        geometry["fy"] = None if spec.camera.fy is None else spec.camera.fy / step
    return CameraSpec.model_validate(tables)


def scene_of(name: str, spec: CameraSpec) -> SceneSpec:
    """A limb by day: from the geostationary ring for the full disc, else from 400 km."""
    camera: dict[str, Any] = {"file": name, "head": spec.head[0].name if spec.head else None}
    altitude_km = 400.0
    if "geo" in name:
        altitude_km = 35786.0
    elif spec.camera.projection != "fisheye" and (not spec.head or spec.head[0].name == "right"):
        # A head to the right looks where the housing is mounted; others have mountings of their own.
        camera["mount_roll_deg"] = 70.0
    return SceneSpec.model_validate(
        {
            "camera": camera,
            "platform": {"altitude_km": altitude_km},
            "atmosphere": {"profile": "none"},
            "sun": {"zenith_deg": 20.0},
            "render": {"orders": "single"},
        }
    )


@pytest.mark.parametrize("name", shipped_names("camera"))
def test_limb_of_a_bare_earth(name: str) -> None:
    spec = fewer_pixels(name)
    frame = render_frame(scene_of(name, spec), spec)
    ground, space = frame.maps["hit"] == Hit.SURFACE, frame.maps["hit"] == Hit.SPACE
    assert ground.any()
    assert space.any()
    for band in spec.band:
        image = observe(frame, spec, band.name, seed=1)
        bright, dark = np.median(image.dn[ground]), np.median(image.dn[space])
        assert dark < 0.1 * image.full_scale
        # A bare ground of albedo 0.3 is darker than a limb with its air; 300 K is little of a range up to 573 K.
        if band.kind == "solar":
            least = 0.1 * image.full_scale
        else:
            least = 10 * image.observation["sigma_radiance"] / image.observation["radiance_per_dn"]
        assert bright - dark > least
