"""Rays over a chequered ground: where they start and go, and their radiance as frames have it.

The platform is 500 km above a sphere. A frame here has pixels of a thousandth of a degree, so that a pixel is a ray.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from reference_rays import OBSERVER_KM, RADIUS_KM
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.earth.optical import optical_model
from horizonval.geometry.camera import camera_from_spec, pixel_grid, unproject
from horizonval.geometry.sun_and_moon import AU_M, sun_itrs
from horizonval.renderer.frame import render_frame
from horizonval.spec.camera import CameraSpec
from horizonval.spec.scene import SceneSpec

DATA = Path(__file__).parents[1] / "data"
SUN_AZIMUTH_DEG = 40.0
BRIGHT, DARK = 0.6, 0.05
"""Albedos of the squares: about a cloud and the sea."""
CAMERA = CameraSpec.model_validate(
    {
        "camera": {"width": 5, "height": 5, "fov_deg": 0.005},
        "band": [{"name": "550nm", "kind": "solar", "lo_um": 0.545, "hi_um": 0.555, "nodes": 1}],
    }
)


def nadir_angle_deg(height_km: float) -> float:
    """Return the angle from the nadir at which a ray's lowest point has a height."""
    return math.degrees(math.asin((RADIUS_KM + height_km) / (RADIUS_KM + OBSERVER_KM)))


def vectors_of(row: dict[str, Any]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return observer [km], direction and Sun of a row of the table, planet-centred."""
    latitude, longitude, nadir, azimuth, zenith = (
        math.radians(float(row[f"{name}_deg"])) for name in ("latitude", "longitude", "nadir", "azimuth", "sza")
    )
    c, s = math.cos(latitude), math.sin(latitude)
    up = np.array([c * math.cos(longitude), c * math.sin(longitude), s])
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    north = np.cross(up, east)

    def aside(a: float) -> FloatArray:
        return math.cos(a) * north + math.sin(a) * east

    direction = math.sin(nadir) * aside(azimuth) - math.cos(nadir) * up
    sun = math.cos(zenith) * up + math.sin(zenith) * aside(math.radians(SUN_AZIMUTH_DEG))
    return (RADIUS_KM + OBSERVER_KM) * up, direction, sun


def frame_radiance(row: dict[str, Any], method: str = "table") -> float:
    """Return the radiance of a row's ray as a frame has it [1/sr]; the frame's own geometry must be the row's."""
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test"},
            "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
            "platform": {
                "altitude_km": OBSERVER_KM,
                "latitude_deg": float(row["latitude_deg"]),
                "longitude_deg": float(row["longitude_deg"]),
            },
            "attitude": {"yaw_deg": float(row["azimuth_deg"]), "pitch_deg": float(row["nadir_deg"])},
            "sun": {"zenith_deg": float(row["sza_deg"]), "azimuth_deg": SUN_AZIMUTH_DEG},
            "atmosphere": {"file": str(DATA / "atm_rayleigh.json")},
            "surface": {
                "kind": "chequered",
                "square_km": float(row["square_km"]),
                "albedo": BRIGHT,
                "albedo_other": DARK,
            },
            "render": {"subsamples": 1, "method": method},
        }
    )
    frame = render_frame(scene, CAMERA)
    truth, model = frame.truth, camera_from_spec(CAMERA.camera)
    los = unproject(model, pixel_grid(model))[2, 2]
    observer, direction, sun = vectors_of(row)
    np.testing.assert_allclose(np.array(truth.r_itrs) / 1e3, observer, atol=1e-3)
    np.testing.assert_allclose(Rotation.from_quat(truth.q_cam_from_itrs).inv().apply(los), direction, atol=1e-7)
    np.testing.assert_allclose(truth.sun_itrs, sun, atol=1e-7)
    (node,) = optical_model(scene, CAMERA, sun_distance_au=sun_itrs(scene.platform.epoch_utc)[1] / AU_M).nodes
    return float(frame.radiance["550nm"][2, 2]) / (node.weight * node.solar_irradiance)
