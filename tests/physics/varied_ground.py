"""Single rays over a ground that varies: as frames have them, and by the Monte Carlo.

A frame here is a few pixels wide and a thousandth of a degree fine, so that a pixel is a ray; frames of one place share
their tables.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import monte_carlo
import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.earth.optical import optical_model
from horizonval.geometry.camera import camera_from_spec, pixel_grid, unproject
from horizonval.geometry.ephemeris import AU_M, sun_itrs
from horizonval.renderer.scene.frame import render_frame
from horizonval.spec.scene import SceneSpec
from horizonval.spec.sensor.camera import CameraSpec

DATA = Path(__file__).parents[1] / "data"
RADIUS_KM = 6371.0
ALTITUDE_KM = 500.0
CAMERA = CameraSpec.model_validate(
    {
        "camera": {"width": 5, "height": 5, "fov_deg": 0.005},
        "band": [{"name": "550nm", "kind": "solar", "lo_um": 0.545, "hi_um": 0.555, "nodes": 1}],
    }
)


@dataclass(frozen=True)
class Ray:
    """A ray of a frame: observer [km], direction and Sun, planet-centred, and its radiance [1/sr]."""

    observer_km: np.ndarray
    direction: np.ndarray
    sun: np.ndarray
    radiance: float


def nadir_angle_deg(height_km: float) -> float:
    """Return the angle from the nadir at which a ray's lowest point has a height."""
    return math.degrees(math.asin((RADIUS_KM + height_km) / (RADIUS_KM + ALTITUDE_KM)))


def frame_ray(
    surface: dict[str, Any],
    sun_zenith_deg: float,
    nadir_deg: float,
    azimuth_deg: float,
    *,
    latitude_deg: float = 3.0,
    longitude_deg: float = 5.0,
    method: str = "table",
) -> Ray:
    """Return the middle pixel of a frame."""
    scene = SceneSpec.model_validate(
        {
            "camera": {"file": "test"},
            "earth": {"shape": "sphere", "radius_km": RADIUS_KM},
            "platform": {"altitude_km": ALTITUDE_KM, "latitude_deg": latitude_deg, "longitude_deg": longitude_deg},
            "attitude": {"yaw_deg": azimuth_deg, "pitch_deg": nadir_deg},
            "sun": {"zenith_deg": sun_zenith_deg, "azimuth_deg": 40.0},
            "atmosphere": {"file": str(DATA / "atm_rayleigh.json")},
            "surface": surface,
            "render": {"subsamples": 1, "method": method},
        }
    )
    frame = render_frame(scene, CAMERA)
    truth, model = frame.truth, camera_from_spec(CAMERA.camera)
    los = unproject(model, pixel_grid(model))[2, 2]
    direction = Rotation.from_quat(truth.q_cam_from_itrs).inv().apply(los)
    (node,) = optical_model(scene, CAMERA, sun_distance_au=sun_itrs(scene.platform.epoch_utc)[1] / AU_M).nodes
    irradiance = float(frame.radiance["550nm"][2, 2]) / (node.weight * node.solar_irradiance)
    return Ray(np.array(truth.r_itrs) / 1e3, direction, np.array(truth.sun_itrs), irradiance)


def judged(ray: Ray, ground: monte_carlo.Ground, paths: int, *seed: object) -> tuple[float, float]:
    """Return the Monte Carlo's radiance of a ray, and its standard error."""
    air = monte_carlo.read_air(DATA / "atm_rayleigh.json", "550nm")._replace(ground=ground)
    identity = monte_carlo.seed_of("varied ground", ray.observer_km, ray.direction, ray.sun, *seed)
    answer = monte_carlo.radiance(air, ray.observer_km, ray.direction, ray.sun, paths, identity)
    return answer.total, answer.multiple_se
