r"""The plane of a view table: rays from one camera position by x from 0 to 1 and azimuth, kinks on borders of patches.

For rays to the ground, and for those past it from inside the air, x is the place on the axis of
:mod:`horizonval.renderer.kernel.ray_coordinates`, over its length. For rays past the ground seen from above the air the
light has kinks along rows: where rays just touch the top of the air or the edge of a layer at a height h, their ways
below it begin as :math:`\sqrt{2 R (h - h_{low})}`. These heights are borders there, and whole patches lie between two,
in which x is even on that axis; but in the patch below a border, s of the way up, x goes with

    1 - sqrt(1 - s)

in which light is smooth. Borders in v, the height of the lowest point in the stretched space, differ a little from h
and with azimuth, by 0.3 % from pole to equator: a ray over the ellipsoid, seen from the point o, touches that raised
by h where its nadir angle theta solves

    |U|^2 tau^2 - 2 (p.U) tau + |p|^2 - |U x p|^2 |o|^2 / (a + h)^2 = 0,      tau = cot(theta)

with up U and the horizontal p of the ray, both stretched until the raised ellipsoid is a sphere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.ray_coordinates import RayAxis, RayCoordinates
from horizonval.renderer.types import Number, Vec, constant, inverse_root
from horizonval.renderer.view_table.patch_table import ROW_PATCHES


@dataclass(frozen=True)
class _Raised:
    """The ellipsoid raised by a height as a camera sees it: the numbers of the module text.

    ``up2`` is :math:`|U|^2`, ``tilt`` the share of the squared z that stretching adds, ``reach2``
    :math:`(|o|/(a+h))^2`.
    """

    up2: float
    tilt: float
    reach2: float

    @classmethod
    def of(cls, coordinates: RayCoordinates, height_m: float) -> _Raised:
        planet = coordinates.planet
        a, b = planet.a_m, planet.b_m
        tilt = ((a + height_m) * b / ((b + height_m) * a)) ** 2 - 1.0
        up_z = float(coordinates.axes[2, 2])
        return cls(1.0 + tilt * up_z * up_z, tilt, (coordinates.distance_m / (a + height_m)) ** 2)


@dataclass(frozen=True)
class RayPlane:
    """The plane of the rays to the ground or of those past it.

    ``heights_m`` of the borders, rising, the last at the top of the air; ``patches``: of rows between two. Empty where
    there are no borders.
    """

    coordinates: RayCoordinates
    to_ground: bool
    heights_m: tuple[float, ...]
    patches: tuple[int, ...]

    @classmethod
    def of(cls, coordinates: RayCoordinates, to_ground: bool, edges_m: Iterable[float], top_m: float) -> RayPlane:
        """Build with borders at the edges of layers, those below the top of the air."""
        if to_ground or coordinates.inside:
            return cls(coordinates, to_ground, (), ())
        edges = sorted({edge for edge in edges_m if 0.0 < edge < top_m})
        # the highest ones only if there are more than patches
        heights = (*edges[max(len(edges) + 1 - ROW_PATCHES, 0) :], top_m)
        return cls(coordinates, to_ground, heights, _shared_out(coordinates.limb, heights))

    @property
    def axis(self) -> RayAxis:
        """The axis."""
        return self.coordinates.ground if self.to_ground else self.coordinates.limb

    def directions(self, x: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return unit directions at places, each of shape (n,); shape (n, 3)."""
        return self.coordinates.directions(self.axis.value(self._on_axis(x, azimuth)), azimuth, self.to_ground)

    def place(self, o: Vec, d: Vec) -> tuple[mi.Float64, mi.Float64]:
        """Return ``(x, azimuth)`` of kernel directions; ``o`` is the camera."""
        steps, azimuth = self.coordinates.place(o, d, self.to_ground)
        x = steps * (1.0 / (self.axis.count - 1))
        if not self.heights_m:
            return x, azimuth
        sine, cosine = dr.sincos(azimuth)
        north, west = (constant(v) for v in self.coordinates.axes[:2, 2])
        z, up_z = cosine * north + sine * west, constant(self.coordinates.axes[2, 2])
        low, place = mi.Float64(0.0), mi.Float64(0.0)
        for height, count in zip(self.heights_m, self.patches, strict=True):
            raised = _Raised.of(self.coordinates, height)
            up2, tilt, reach2 = (constant(v) for v in (raised.up2, raised.tilt, raised.reach2))
            cotangent = _cotangent(up2, tilt, reach2, z, up_z, dr.sqrt)
            nadir_sine = inverse_root(dr.fma(cotangent, cotangent, 1.0))
            v = nadir_sine * constant(self.coordinates.distance_m) - self.coordinates.planet.a_m
            high = self.axis.place(v) * (1.0 / (self.axis.count - 1))
            patches = constant(float(count))
            share = dr.clip((x - low) / (high - low), 0.0, 1.0) * patches
            last = share - (patches - 1.0)
            place += dr.select(last > 0.0, patches - dr.sqrt(dr.maximum(1.0 - last, 0.0)), share)
            low = high
        return place * (1.0 / ROW_PATCHES), azimuth

    def _on_axis(self, x: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return the places on the axis, over its length."""
        if not self.heights_m:
            return x
        place, first = x * ROW_PATCHES, 0
        low, on_axis = np.zeros_like(x), np.zeros_like(x)
        for height, count in zip(self.heights_m, self.patches, strict=True):
            high = self._border(height, azimuth)
            share = np.clip(place - first, 0.0, count)
            above = np.maximum(count - share, 0.0)
            share = np.where(above < 1.0, count - above * above, share) / count
            on_axis = np.where(place >= first, low + (high - low) * share, on_axis)
            low, first = high, first + count
        return on_axis

    def _border(self, height_m: float, azimuth: FloatArray) -> FloatArray:
        """Return the border at a height, on the axis over its length."""
        c = self.coordinates
        z = np.cos(azimuth) * c.axes[0, 2] + np.sin(azimuth) * c.axes[1, 2]
        raised = _Raised.of(c, height_m)
        up2, tilt, reach2, up_z = (np.asarray(v) for v in (raised.up2, raised.tilt, raised.reach2, c.axes[2, 2]))
        cotangent = _cotangent(up2, tilt, reach2, z, up_z, np.sqrt)
        v = c.distance_m / np.sqrt(1.0 + cotangent**2) - c.planet.a_m
        return np.asarray(np.arcsinh(v / self.axis.dense) / math.asinh(self.axis.most / self.axis.dense))


def _cotangent(
    up2: Number, tilt: Number, reach2: Number, z: Number, up_z: Number, root: Callable[[Number], Number]
) -> Number:
    """Return tau of the module text; ``z``, ``up_z``: of the horizontal and of up, before they are stretched."""
    product, horizontal2 = tilt * z * up_z, 1.0 + tilt * z * z
    aside2 = up2 * horizontal2 - product * product
    return (product + root(product * product - up2 * (horizontal2 - aside2 * reach2))) / up2


def _shared_out(axis: RayAxis, heights_m: Sequence[float]) -> tuple[int, ...]:
    """Return how many patches lie between borders: one at least, and more where the axis is longer."""
    ends = [0.0, *(math.asinh(height / axis.dense) for height in heights_m)]
    lengths = [high - low for low, high in pairwise(ends)]
    counts = [1] * len(lengths)
    for _ in range(ROW_PATCHES - len(lengths)):
        widest = max(range(len(lengths)), key=lambda k: lengths[k] / counts[k])
        counts[widest] += 1
    return tuple(counts)
