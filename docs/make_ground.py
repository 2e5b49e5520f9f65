"""The picture on docs/explanation/ground.md: python docs/make_ground.py docs/_static/ground.png

Four discs from a geostationary height without clouds and particles, in 680, 551 and 443 nm, the reflectance 0 to 0.7 by
a power of 1/2.2.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from horizonval.earth.optical import optical_model
from horizonval.renderer.backend import activate
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

PIXELS, WHITE = 300, 0.7
BANDS = (("red", 0.67, 0.69), ("green", 0.541, 0.561), ("blue", 0.433, 0.453))
VIEWS = (
    (0.0, 20.0, "2026-03-20T10:40:00Z", {"zenith_deg": 15.0, "azimuth_deg": 120.0}),
    (30.0, -110.0, "2026-06-13T19:20:00Z", {"zenith_deg": 12.0, "azimuth_deg": 140.0}),
    (-75.0, 100.0, "2026-12-15T05:00:00Z", {"zenith_deg": 52.0, "azimuth_deg": 30.0}),
    (35.0, 90.0, "2026-01-15T06:00:00Z", {"zenith_deg": 56.0, "azimuth_deg": 180.0}),
)


def disc(latitude_deg: float, longitude_deg: float, epoch: str, sun: dict[str, float]) -> np.ndarray:
    """Return the reflectance of the Earth in three bands, shape (PIXELS, PIXELS, 3)."""
    from horizonval.renderer.frame import render_frame

    place = {"altitude_km": 35786.0, "latitude_deg": latitude_deg, "longitude_deg": longitude_deg, "epoch_utc": epoch}
    tables = {"platform": place, "sun": sun, "surface": {"kind": "earth"}, "atmosphere": {"aerosol": "none"}}
    scene = SceneSpec.model_validate({"camera": {"file": "here"}, **tables})
    geometry = {"width": PIXELS, "height": PIXELS, "fov_deg": 18.0, "projection": "equal_angle"}
    bands = [{"name": name, "kind": "solar", "lo_um": lo, "hi_um": hi, "nodes": 1} for name, lo, hi in BANDS]
    camera = CameraSpec.model_validate({"camera": geometry, "band": bands})
    frame = render_frame(scene, camera)
    nodes = {node.band: node.weight * node.solar_irradiance for node in optical_model(scene, camera, 1.0).nodes}
    return np.stack([np.pi * frame.radiance[name] / nodes[name] for name, _, _ in BANDS], axis=-1)


if __name__ == "__main__":
    activate()
    row = np.hstack([disc(*view) for view in VIEWS])
    levels = np.round(255.0 * np.clip(row / WHITE, 0.0, 1.0) ** (1.0 / 2.2)).astype(np.uint8)
    cv2.imwrite(str(Path(sys.argv[1])), levels[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
