"""Primary rays in Float64: pixel coordinates to directions, inside the kernel.

Written apart from ``geometry.camera`` so that the rendered edge and the analytic horizon share no projection code.
Pixel ``(0, 0)`` is the centre of the upper left pixel.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.geometry.camera import Camera
from horizonval.render.planet import Vec

UNDISTORT_STEPS = 8


@dataclass(frozen=True)
class RayCamera:
    """A camera and its attitude as kernel data.

    ``values``: fx, fy, cx, cy, k1, k2, p1, p2, k3; ``rows``: the nine entries of the rotation from camera axes to
    Earth-fixed axes. All are size-1 arrays, so that frames share one compiled kernel.
    """

    values: list[Any]
    rows: list[Any]
    distorted: bool
    equal_angle: bool

    @classmethod
    def of(cls, camera: Camera, itrs_from_cam: NDArray[np.float64]) -> RayCamera:
        """Build from intrinsics and a rotation matrix, shape (3, 3)."""
        numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion]
        return cls(
            [dr.opaque(mi.Float64, float(v), 1) for v in numbers],
            [dr.opaque(mi.Float64, float(v), 1) for v in itrs_from_cam.ravel()],
            any(camera.distortion),
            camera.projection == "equal_angle",
        )

    def direction(self, u: Any, v: Any) -> Vec:
        """Return unit directions in Earth-fixed axes through pixel coordinates (column, row)."""
        fx, fy, cx, cy = self.values[:4]
        x, y = (u - cx) / fx, (v - cy) / fy
        if self.equal_angle:
            sin_y, cos_y = dr.sincos(y)
            sin_x, cos_x = dr.sincos(x)
            return self._rotate(cos_y * sin_x, sin_y, cos_y * cos_x)
        if self.distorted:
            x, y = self._undistort(x, y)
        s = dr.rsqrt(dr.fma(x, x, dr.fma(y, y, 1.0)))
        return self._rotate(x * s, y * s, s)

    def _undistort(self, xd: Any, yd: Any) -> tuple[Any, Any]:
        """Invert Brown-Conrady by Newton's method; quadratic from the distorted point for every sane lens."""
        k1, k2, p1, p2, k3 = self.values[4:]
        x, y = xd, yd
        for _ in range(UNDISTORT_STEPS):
            r2 = x * x + y * y
            radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
            slope = 2.0 * (k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
            fx = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) - xd
            fy = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y - yd
            jxx = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
            jxy = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
            jyy = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
            det = jxx * jyy - jxy * jxy
            x, y = x - (jyy * fx - jxy * fy) / det, y - (jxx * fy - jxy * fx) / det
        return x, y

    def _rotate(self, x: Any, y: Any, z: Any) -> Vec:
        m = self.rows
        return (
            m[0] * x + m[1] * y + m[2] * z,
            m[3] * x + m[4] * y + m[5] * z,
            m[6] * x + m[7] * y + m[8] * z,
        )
