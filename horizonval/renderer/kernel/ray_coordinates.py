r"""All rays from one camera as two numbers each: where a table of what they meet is smooth.

In the stretched space (see :mod:`horizonval.renderer.planet`) the ellipsoid is a sphere of radius a. A ray has an
azimuth :math:`\alpha` about the direction to the sphere's centre, 0 towards the north, and a nadir angle
:math:`\theta`. Seen from o' its miss distance is ``|o'| sin(theta)``: a on the hard limb, exactly. The second number
depends on what the ray meets:

- ground: the elevation e at which it arrives there, ``|o'| sin(theta) = a cos(e)``. What lies between is smooth in e
  up to grazing rays, where the distance from the limb has a square root;
- limb, seen from outside the air: the height ``m = |o'| sin(theta) - a`` of its lowest point;
- limb and sky, seen from inside the air: the angle ``theta - theta_limb``, up to the zenith.

Each is mapped to ``x = asinh(v / w) / asinh(v_max / w)``: dense within w of the limb.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import perpendicular
from horizonval.renderer.planet import Planet, cross_squared, dot
from horizonval.renderer.types import Vec, constant, constant_vector, inverse_root

GROUND_DENSE_RAD, LIMB_DENSE_M, SKY_DENSE_RAD = 0.1, 25e3, 0.02
GROUND_NODES, LIMB_NODES, SKY_NODES = 96, 512, 512
"""Nodes along the axes. Seen from a balloon at 30 km the limb at the tropopause, where absorption bends, has 150 m
between two: a window's radiance there is within 0.06 % of the march (0.14 % with 400 nodes)."""


@dataclass(frozen=True)
class RayAxis:
    """The mapping from x in [0, 1] to a coordinate v in [0, most]; ``count`` nodes, even in x."""

    dense: float
    most: float
    count: int

    def nodes(self) -> FloatArray:
        """Return v at the nodes."""
        return self.dense * np.sinh(np.linspace(0.0, 1.0, self.count) * math.asinh(self.most / self.dense))

    def value(self, x: FloatArray) -> FloatArray:
        """Return v at x."""
        return np.asarray(self.dense * np.sinh(x * math.asinh(self.most / self.dense)))

    def place(self, v: mi.Float64) -> mi.Float64:
        """Return the place of kernel values in steps from the first node, within the axis."""
        u = dr.clip(v, 0.0, constant(self.most)) * constant(1.0 / self.dense)
        x = dr.log(u + dr.sqrt(dr.fma(u, u, 1.0))) * constant((self.count - 1) / math.asinh(self.most / self.dense))
        return dr.minimum(x, self.count - 1.0)


@dataclass(frozen=True)
class RayCoordinates:
    """The rays of one camera position.

    Attributes
    ----------
    planet : Planet
    origin : ndarray, shape (3,)
        Camera [m].
    distance_m : float
        From the centre, in the stretched space.
    axes : ndarray, shape (3, 3)
        Rows: north, west, and up, in the stretched space.
    ground, limb : RayAxis
    inside : bool
        Whether the camera is inside the air: what ``limb`` measures.
    """

    planet: Planet
    origin: FloatArray
    distance_m: float
    axes: FloatArray
    ground: RayAxis
    limb: RayAxis
    inside: bool

    @classmethod
    def of(cls, planet: Planet, origin: FloatArray, top_m: float) -> RayCoordinates:
        """Build for a camera at ``origin``; nothing is above ``top_m``."""
        stretched = origin * np.array([1.0, 1.0, planet.a_m / planet.b_m])
        r = max(float(np.linalg.norm(stretched)), planet.a_m * (1.0 + 1e-12))
        up = stretched / np.linalg.norm(stretched)
        north = np.array([0.0, 0.0, 1.0]) - up[2] * up
        length = float(np.linalg.norm(north))
        north = north / length if length > 1e-9 else perpendicular(up)
        axes = np.stack([north, np.cross(up, north), up])
        ground = RayAxis(GROUND_DENSE_RAD, 0.5 * math.pi, GROUND_NODES)
        # heights grow by the stretching: a ray that misses even so meets nothing
        most_m = top_m * planet.a_m / planet.b_m * 1.01
        inside = r < planet.a_m + most_m
        if inside:
            limb = RayAxis(SKY_DENSE_RAD, math.pi - math.asin(planet.a_m / r), SKY_NODES)
        else:
            limb = RayAxis(LIMB_DENSE_M, most_m, LIMB_NODES)
        return cls(planet, origin, r, axes, ground, limb, inside)

    def directions(self, v: FloatArray, azimuth: FloatArray, to_ground: bool) -> FloatArray:
        """Return unit directions at coordinates ``v`` of an axis under azimuths; they broadcast, shape (..., 3)."""
        a, r = self.planet.a_m, self.distance_m
        if to_ground:
            sine = a / r * np.cos(v)
            cosine = np.sqrt(np.maximum((1.0 - sine) * (1.0 + sine), 0.0))
        elif self.inside:
            theta = math.asin(a / r) + v
            sine, cosine = np.sin(theta), np.cos(theta)
        else:
            sine = np.minimum((a + v) / r, 1.0)
            cosine = np.sqrt((1.0 - sine) * (1.0 + sine))
        along = [sine * np.cos(azimuth), sine * np.sin(azimuth), -cosine]
        # no product of matrices: it rounds by how many rays there are
        d = sum(c[..., None] * axis for c, axis in zip(np.broadcast_arrays(*along), self.axes, strict=True))
        d = d * np.array([1.0, 1.0, self.planet.b_m / a])
        return np.asarray(d / np.linalg.norm(d, axis=-1, keepdims=True))

    def place(self, o: Vec, d: Vec, to_ground: bool) -> tuple[mi.Float64, mi.Float64]:
        """Return ``(place on the axis [steps], azimuth [rad])`` of kernel directions; ``o`` is the camera."""
        a = self.planet.a_m
        o1, d1 = self.planet.stretch(o), self.planet.stretch(d)
        length2 = dot(d1, d1)
        miss = dr.sqrt(cross_squared(o1, d1) / length2)
        x, y = (dot(d1, constant_vector(axis)) for axis in self.axes[:2])
        azimuth = dr.atan2(y, x)
        if to_ground:
            rise = dr.sqrt(dr.maximum((a - miss) * (a + miss), 0.0))
            return self.ground.place(dr.atan2(rise, miss)), azimuth
        if self.inside:
            theta = dr.atan2(miss, -dot(o1, d1) * inverse_root(length2))
            return self.limb.place(theta - constant(math.asin(a / self.distance_m))), azimuth
        # away from the Earth nothing is met: as above the air
        return self.limb.place(dr.select(dot(o1, d1) < 0.0, miss - a, constant(self.limb.most))), azimuth
