"""The Sun as a Mitsuba emitter: a disc at infinity of unit irradiance, which smooth surfaces mirror as a disc.

Stock Mitsuba has no such emitter: ``directional`` is a point, which no mirror shows; a far sphere loses 0.2 % in single
precision; a map of the sky cannot hold half a degree. Directions are drawn evenly over the disc, in ``1 - cos``, whose
small values are worked out in double precision.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import drjit as dr
import mitsuba as mi

from horizonval.core.arrays import FloatArray


def sun_emitter(direction: FloatArray, angular_radius_rad: float) -> Any:
    """Return the emitter; ``direction``: unit vector towards the Sun's centre in the scene's axes, shape (3,)."""
    return _plugin(mi.variant())(mi.Properties("part_sun"), direction, angular_radius_rad)


@cache
def _plugin(variant: str) -> type:
    """Return the class for a variant (its base class depends on it)."""

    class PartSun(mi.Emitter):
        def __init__(self, props: mi.Properties, direction: FloatArray, angular_radius_rad: float) -> None:
            super().__init__(props)
            self.m_flags = +mi.EmitterFlags.Infinite
            versine = 2.0 * math.sin(0.5 * angular_radius_rad) ** 2
            x, y, z = (float(c) for c in direction)
            # data, not constants: frames share compiled kernels
            self.centre = mi.Vector3f(*(dr.opaque(mi.Float, c, 1) for c in (x, y, z)))
            self.versine = dr.opaque(mi.Float, versine, 1)
            self.radiance = dr.opaque(mi.Float, 1.0 / (math.pi * math.sin(angular_radius_rad) ** 2), 1)
            self.density = dr.opaque(mi.Float, 1.0 / (2.0 * math.pi * versine), 1)

        def _inside(self, d: Any) -> Any:
            return dr.squared_norm(d - self.centre) <= 2.0 * self.versine

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
            drop = self.versine * sample.x
            sine = dr.sqrt(drop * (2.0 - drop))
            sin_turn, cos_turn = dr.sincos(2.0 * math.pi * sample.y)
            frame = mi.Frame3f(self.centre)
            d = dr.normalize(frame.to_world(mi.Vector3f(sine * cos_turn, sine * sin_turn, 1.0 - drop)))
            ds: Any = dr.zeros(mi.DirectionSample3f)
            ds.dist = mi.Float(1e4)
            ds.p = it.p + d * ds.dist
            ds.n = -d
            ds.d = d
            ds.time = it.time
            ds.delta = mi.Bool(False)
            ds.pdf = self.density
            ds.emitter = mi.EmitterPtr(self)
            return ds, mi.Spectrum(self.radiance / self.density) & active

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return dr.select(self._inside(ds.d), self.density, 0.0)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return mi.Spectrum(dr.select(self._inside(ds.d), self.radiance, 0.0)) & active

        def eval(self, si: Any, active: Any = True) -> Any:
            return mi.Spectrum(dr.select(self._inside(-si.wi), self.radiance, 0.0)) & active

        def set_scene(self, scene: Any) -> None:
            pass

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

        def to_string(self) -> str:
            return "PartSun[]"

    return PartSun
