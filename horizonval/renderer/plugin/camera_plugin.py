"""``horizon_camera``: the camera as a Mitsuba sensor plugin.

The limb integrator takes the intrinsics from here and makes its own Float64 rays; :meth:`HorizonCamera.sample_ray`
serves stock integrators (single precision, same projection).
"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.geometry.camera import CameraModel
from horizonval.renderer.kernel.rays import RayCamera

PLUGIN = "horizon_camera"


def camera_properties(
    camera: CameraModel, r_itrs: NDArray[np.float64], itrs_from_cam: NDArray[np.float64]
) -> dict[str, Any]:
    """Return the plugin's properties. JSON carries float64 exactly; Mitsuba's own vectors would not."""
    pose = {"r_itrs_m": [float(v) for v in r_itrs], "itrs_from_cam": [float(v) for v in itrs_from_cam.ravel()]}
    return {
        "type": PLUGIN,
        "camera": json.dumps(asdict(camera)),
        "pose": json.dumps(pose),
        "film": {
            "type": "hdrfilm",
            "width": camera.width,
            "height": camera.height,
            "pixel_format": "luminance",
            "rfilter": {"type": "box"},
        },
    }


def make_plugin() -> type:
    """Return the sensor class for the active variant (its base class depends on the variant)."""

    class HorizonCamera(mi.Sensor):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            intrinsics = json.loads(props.get("camera"))
            intrinsics["distortion"] = tuple(intrinsics["distortion"])
            pose = json.loads(props.get("pose"))
            self.camera = CameraModel(**intrinsics)
            self.r_itrs = np.array(pose["r_itrs_m"])
            self.itrs_from_cam = np.array(pose["itrs_from_cam"]).reshape(3, 3)
            self.rays = RayCamera.of(self.camera, self.itrs_from_cam)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = False

        def sample_ray(self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True) -> Any:
            u = mi.Float64(sample2.x) * self.camera.width - 0.5
            v = mi.Float64(sample2.y) * self.camera.height - 0.5
            origin = mi.Point3f([float(c) for c in self.r_itrs])
            ray = mi.Ray3f(origin, mi.Vector3f([mi.Float(c) for c in self.rays.direction(u, v)]))
            ray.time = time
            if self.rays.circle is None:
                return ray, mi.Spectrum(1.0)
            # by the pixel's centre, as the limb integrator has it
            lit = self.rays.sees(dr.floor(u + 0.5), dr.floor(v + 0.5))
            return ray, mi.Spectrum(dr.select(lit, mi.Float(1.0), mi.Float(0.0)))

        def sample_ray_differential(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> Any:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> Any:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(*self.r_itrs))

        def to_string(self) -> str:
            return f"HorizonCamera[{self.camera}]"

    return HorizonCamera
