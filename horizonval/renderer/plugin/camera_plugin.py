"""``horizon_camera``: the camera as a Mitsuba sensor plugin.

The limb integrator takes the intrinsics from here and makes its own Float64 rays; :meth:`HorizonCamera.sample_ray`
serves stock integrators (single precision, same projection).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.rays import RayCamera
from horizonval.renderer.plugin.settings import CameraSettings


def make_plugin() -> type:
    """Return the sensor class for the active variant (its base class depends on the variant).

    What Mitsuba calls takes its arguments as Mitsuba passes them, whichever type the stub of ``mi.Sensor`` gives them.
    """

    class HorizonCamera(mi.Sensor):
        def __init__(self, props: mi.Properties, settings: CameraSettings) -> None:
            super().__init__(props)
            self.camera = settings.camera
            self.r_itrs = settings.r_itrs
            self.rays = RayCamera.of(settings.camera, settings.itrs_from_cam)
            self.m_needs_sample_2 = True
            self.m_needs_sample_3 = False

        def sample_ray(
            self, time: Any, sample1: Any, sample2: Any, sample3: Any, active: Any = True
        ) -> tuple[mi.Ray3f, mi.Spectrum]:
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
        ) -> tuple[mi.RayDifferential3f, mi.Spectrum]:
            ray, weight = self.sample_ray(time, sample1, sample2, sample3, active)
            return mi.RayDifferential3f(ray), weight

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(*self.r_itrs))

        def to_string(self) -> str:
            return f"HorizonCamera[{self.camera}]"

    return HorizonCamera
