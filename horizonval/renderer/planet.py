"""The ellipsoid inside the renderer: Float64 Dr.Jit, independent of ``geometry`` so that each can check the other.

With ``z`` stretched by ``a/b`` the ellipsoid becomes a sphere of radius ``a`` and lines
stay lines with the same parameter. With primed vectors in the stretched space a line ``o + t d`` meets the ellipsoid if
``m = |o' x d'| / |d'| <= a``, and it is nearest to it at ``t = -(o'.d') / |d'|^2``. The form ``a^2 - m^2`` is used
instead of the textbook discriminant ``b^2 - ac``, which cancels at planetary distances.

**Steps along rays.** A ray is cut at its lowest point into a descending and an ascending piece. With ``y`` from -1
(entry) over 0 (lowest point) to 1 (exit) the distance from the lowest point is ``l (c |y| + (1 - c) |y|^3)``: dense
where the air is dense. One step holds two Gauss points.

**Layers of thin cloud**: no step straddles a layer's edge. A ray is cut where it enters and leaves each layer's
heights, on its way down and on its way up. Every piece has a fixed number of steps, so that neighbouring rays
differ smoothly: :data:`LAYER_STEPS` in a layer, more of them in one with gaps (:data:`STEPS_PER_SCALE`), half the
march's outside the highest and below the lowest one, a quarter between two. A piece without length, of a ray that
passes above, has no steps: as a piece shrinks so does its contribution, and nothing jumps. Within a
piece steps are even in the ray parameter; where the umbra's edge crosses the ray, a third of them lies before, in and
behind it: as a part shrinks, its share of the steps stays, so that nothing jumps either.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from horizonval.renderer.types import Real, Vec, Vec3, constant, inverse_root


def dot(p: Vec3[Real], q: Vec3[Real]) -> Real:
    """Return the scalar product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def along(o: Vec3[Real], d: Vec3[Real], t: Real | float) -> Vec3[Real]:
    """Return the point ``o + t d``."""
    return dr.fma(d[0], t, o[0]), dr.fma(d[1], t, o[1]), dr.fma(d[2], t, o[2])


def distance_squared(p: Vec, q: Vec) -> mi.Float64:
    """Return ``|p - q|^2``."""
    x, y, z = p[0] - q[0], p[1] - q[1], p[2] - q[2]
    return x * x + y * y + z * z


def cross_squared(p: Vec, q: Vec) -> mi.Float64:
    """Return ``|p x q|^2``."""
    x = p[1] * q[2] - p[2] * q[1]
    y = p[2] * q[0] - p[0] * q[2]
    z = p[0] * q[1] - p[1] * q[0]
    return x * x + y * y + z * z


@dataclass(frozen=True)
class Planet:
    """Reference ellipsoid with semi-axes in metres. Plain floats, because they are constants of the compiled kernel."""

    a_m: float
    b_m: float

    @property
    def mean_radius_m(self) -> float:
        """Radius of the sphere that replaces the ellipsoid where only curvature counts.

        Optical depths near the horizon go with the square root of the radius: 0.17 % between equator and pole.
        """
        return (2.0 * self.a_m + self.b_m) / 3.0

    def stretch(self, p: Vec, height_m: float | mi.Float64 = 0.0) -> Vec:
        """Return ``p`` with z scaled so that the ellipsoid with axes ``a + h, b + h`` is a sphere."""
        return p[0], p[1], p[2] * ((self.a_m + height_m) / (self.b_m + height_m))

    def miss_distance(self, o: Vec, d: Vec, height_m: float | mi.Float64 = 0.0) -> mi.Float64:
        """Return ``m / (a + h)``: below 1 for lines that meet the ellipsoid raised by ``height_m``."""
        o1, d1 = self.stretch(o, height_m), self.stretch(d, height_m)
        return dr.sqrt(cross_squared(o1, d1) / dot(d1, d1)) / (self.a_m + height_m)

    def chord(self, o: Vec, d: Vec, height_m: float | mi.Float64 = 0.0) -> tuple[mi.Float64, mi.Float64, mi.Bool]:
        """Return ``(t_mid, t_half, meets)`` of the chord cut out by the ellipsoid raised by ``height_m``.

        ``t_mid`` is the parameter of the point nearest to the surface; the crossings are ``t_mid -+ t_half``.
        ``t_half`` is 0 where the line misses.
        """
        o1, d1 = self.stretch(o, height_m), self.stretch(d, height_m)
        dd = dot(d1, d1)
        gap = (self.a_m + height_m) ** 2 - cross_squared(o1, d1) / dd
        return -dot(o1, d1) / dd, dr.sqrt(dr.maximum(gap, 0.0) / dd), gap > 0.0

    def height_and_normal(self, p: Vec3[Real]) -> tuple[Real, Vec3[Real]]:
        """Return geodetic height [m] and outward normal of the ellipsoid below ``p``.

        One step of Bowring's iteration (1976) from his improved start; the height error is below 1 mm from the surface
        to 2000 km, because the height depends on the latitude error to second order only.
        """
        if self.a_m == self.b_m:
            r = dr.sqrt(dot(p, p))
            s = 1.0 / r
            return r - self.a_m, (p[0] * s, p[1] * s, p[2] * s)
        a, b = self.a_m, self.b_m
        e2 = 1.0 - (b / a) ** 2
        ep2 = (a / b) ** 2 - 1.0
        rho2 = p[0] * p[0] + p[1] * p[1]
        rho = dr.sqrt(rho2)
        r = dr.sqrt(rho2 + p[2] * p[2])
        # reduced latitude beta as a vector, so that the poles need no special case
        cb, sb = a * rho, b * p[2] * (1.0 + ep2 * b / r)
        scale = 1.0 / dr.sqrt(cb * cb + sb * sb)
        cb, sb = cb * scale, sb * scale
        cp, sp = rho - e2 * a * cb * cb * cb, p[2] + ep2 * b * sb * sb * sb
        scale = 1.0 / dr.sqrt(cp * cp + sp * sp)
        cp, sp = cp * scale, sp * scale
        height = rho * cp + p[2] * sp - a * dr.sqrt(1.0 - e2 * sp * sp)
        per_rho = cp / dr.maximum(rho, 1e-9)
        return height, (p[0] * per_rho, p[1] * per_rho, sp)

    def point(self, height_m: mi.Float64, normal: Vec) -> Vec:
        """Return the point at a geodetic height above where the ellipsoid has a unit normal."""
        a2, b2 = self.a_m**2, self.b_m**2
        x, y, z = normal
        scale = inverse_root(a2 * (x * x + y * y) + b2 * z * z)
        return x * dr.fma(a2, scale, height_m), y * dr.fma(a2, scale, height_m), z * dr.fma(b2, scale, height_m)

    def shadow_crossings(self, o: Vec, d: Vec, sun: Vec) -> tuple[mi.Float64, mi.Float64, mi.Bool]:
        """Return ``(t1, t2, crosses)``: where a line enters and leaves the umbra of a Sun at infinity.

        In the stretched space the umbra is the half cylinder of radius ``a`` behind the planet:
        ``|p' - (p'.s') s'| < a`` and ``p'.s' < 0``. Crossings on the sunward half are returned as such and must be
        rejected with :meth:`in_umbra` at points beside them.
        """
        o1, d1, s1 = self.stretch(o), self.stretch(d), self._unit(self.stretch(sun))
        os, ds = dot(o1, s1), dot(d1, s1)
        q2 = dot(d1, d1) - ds * ds
        q1 = dot(o1, d1) - os * ds
        q0 = dot(o1, o1) - os * os - self.a_m**2
        disc = q1 * q1 - q2 * q0
        crosses = (disc > 0.0) & (q2 > 1e-12)
        root = dr.sqrt(dr.maximum(disc, 0.0))
        q2 = dr.maximum(q2, 1e-12)
        return (-q1 - root) / q2, (-q1 + root) / q2, crosses

    def in_umbra(self, p: Vec, sun: Vec) -> mi.Bool:
        """Return whether the Sun's centre is hidden by the ellipsoid from ``p`` (no refraction)."""
        p1, s1 = self.stretch(p), self._unit(self.stretch(sun))
        ps = dot(p1, s1)
        return (dot(p1, p1) - ps * ps < self.a_m**2) & (ps < 0.0)

    @staticmethod
    def _unit(v: Vec) -> Vec:
        s = inverse_root(dot(v, v))
        return v[0] * s, v[1] * s, v[2] * s


SOLAR_CONCENTRATION = 0.15
THERMAL_CONCENTRATION = 0.5
"""The c of the module text for scattered sunlight and for emission."""

GAUSS_LOW = 0.5 - math.sqrt(3.0) / 6.0
"""First Gauss point of a step of length 1; the second is as far from the other end."""


@dataclass(frozen=True)
class AirPath:
    """The stretch of a ray inside the atmosphere and in front of the ground, ready to be marched.

    ``t_low`` is the lowest point; ``y0``, ``y1`` bound the ray parameter; ``length_*`` are the pieces' lengths [m].
    """

    t_low: mi.Float64
    length_before: mi.Float64
    length_after: mi.Float64
    y0: mi.Float64
    y1: mi.Float64


def find_path(
    planet: Planet, top_m: float, o: Vec, d: Vec, to_ground: mi.Bool, cloud: tuple[mi.Bool, mi.Float64] | None = None
) -> AirPath:
    """Return the marched stretch of rays with unit directions; zero length for rays above the atmosphere.

    ``to_ground``: march up to the ground (the ray must hit it) instead of past the lowest point. ``cloud``:
    whether and where clouds end a ray before either.
    """
    mid, half, meets = planet.chord(o, d, top_m)
    ground_mid, ground_half, _ = planet.chord(o, d)
    t_in = dr.maximum(mid - half, 0.0)
    t_out = dr.select(to_ground, ground_mid - ground_half, mid + half)
    if cloud is not None:
        t_out = dr.select(cloud[0], cloud[1], t_out)
    t_out = dr.select(meets, dr.maximum(t_out, t_in), t_in)
    # at the ground the path may end before the lowest point of the line
    t_low = dr.clip(dr.select(to_ground, t_out, mid), t_in, t_out)
    before, after = t_low - t_in, t_out - t_low
    return AirPath(
        t_low,
        before,
        after,
        dr.select(before > 0.0, mi.Float64(-1.0), 0.0),
        dr.select(after > 0.0, mi.Float64(1.0), 0.0),
    )


def warp(path: AirPath, y: mi.Float64, c: float | mi.Float64 = SOLAR_CONCENTRATION) -> mi.Float64:
    """Return the ray parameter [m] of ``y``; ``c`` as in the module text."""
    reach = dr.abs(y)
    reach = reach * dr.fma(reach * reach, 1.0 - c, c)
    return path.t_low + dr.select(y < 0.0, -path.length_before, path.length_after) * reach


def unwarp(path: AirPath, t: mi.Float64, c: float | mi.Float64 = SOLAR_CONCENTRATION) -> mi.Float64:
    """Return ``y`` of a ray parameter: the real root of ``c y + (1 - c) y^3 = x``, by the hyperbolic solution."""
    s = t - path.t_low
    length = dr.select(s < 0.0, path.length_before, path.length_after)
    x = dr.minimum(dr.abs(s) / dr.maximum(length, 1e-3), 1.0)
    p = c / (1.0 - c)
    q = x / (1.0 - c)
    scale = 2.0 * dr.sqrt(p / 3.0)
    arg = 3.0 * q / (p * scale)
    growth = dr.exp(dr.log(arg + dr.sqrt(arg * arg + 1.0)) / 3.0)
    y = 0.5 * scale * (growth - 1.0 / growth)
    return dr.select(s < 0.0, -dr.minimum(y, 1.0), dr.minimum(y, 1.0))


def umbra(planet: Planet, path: AirPath, o: Vec, d: Vec, sun: Vec) -> tuple[mi.Float64, mi.Float64]:
    """Return ``y`` where rays enter and leave the umbra; their ends where they do not."""
    t1, t2, crosses = planet.shadow_crossings(o, d, sun)
    # a crossing counts only on the side away from the Sun: look a metre into the cylinder
    enters = crosses & planet.in_umbra(along(o, d, t1 + 1.0), sun)
    leaves = crosses & planet.in_umbra(along(o, d, t2 - 1.0), sun)
    y1 = dr.select(enters, dr.clip(unwarp(path, t1), path.y0, path.y1), path.y0)
    y2 = dr.select(leaves, dr.clip(unwarp(path, t2), path.y0, path.y1), path.y1)
    return y1, y2


def way_through(
    planet: Planet, o: Vec, d: Vec, layer_m: float | mi.Float64, to_ground: bool
) -> tuple[mi.Float64, mi.Float64]:
    """Return the ray parameters between which rays are below a height, in front of the ground if they meet it."""
    mid, half, _ = planet.chord(o, d, layer_m)
    start, end = dr.maximum(mid - half, 0.0), dr.maximum(mid + half, 0.0)
    if to_ground:
        ground_mid, ground_half, _ = planet.chord(o, d)
        end = ground_mid - ground_half
    return start, dr.maximum(end, start)


LAYER_STEPS = 36
SPARE_OUTER = 3.0 / 8.0
"""Share of the march's steps outside the highest layer, instead of half, for tables under a light without a shadow."""
STEPS_PER_SCALE, MOST_STEPS = 12, 240
"""In a layer with gaps: steps per scale of the gaps on the longest passage (four per softened edge), and at most."""
_RADIUS_M = 6.371e6


class LayerBand(NamedTuple):
    """Heights [m] of a layer, and steps of each passage through it."""

    base_m: float
    top_m: float
    steps: int = LAYER_STEPS


Bands = Sequence[LayerBand]
"""From the lowest on, without overlaps."""


def layer_bands(heights: Sequence[tuple[float, float]], gaps: Sequence[tuple[float, float, float]]) -> Bands:
    """Return heights (base, top) with their numbers of steps; ``gaps``: base, top and scale of layers with gaps [m]."""
    bands = []
    for base, top in heights:
        # down from the layer's top to its base, level there
        longest, steps = math.sqrt(2.0 * _RADIUS_M * (top - base)), LAYER_STEPS
        for low, high, scale in gaps:
            if low < top and high > base:
                steps = max(steps, min(_twelve(STEPS_PER_SCALE * longest / scale), MOST_STEPS))
        bands.append(LayerBand(base, top, steps))
    return tuple(bands)


@dataclass(frozen=True)
class LayeredSteps:
    """Pieces of rays: ``cuts`` in y, and ``starts``, the number of the step at each; ``umbra``: y of its edges."""

    cuts: tuple[mi.Float64, ...]
    starts: tuple[mi.Float64, ...]
    umbra: tuple[mi.Float64, mi.Float64] | None
    crossed: mi.Bool

    @property
    def count(self) -> mi.UInt32:
        """Steps of a ray."""
        return mi.UInt32(self.starts[-1])

    def boundary(self, i: mi.Float64) -> mi.Float64:
        """Return ``y`` at step boundary ``i``."""
        low, high, first, last = self.cuts[0], self.cuts[1], self.starts[0], self.starts[1]
        for k in range(1, len(self.cuts) - 1):
            past = i >= self.starts[k]
            low, high = dr.select(past, self.cuts[k], low), dr.select(past, self.cuts[k + 1], high)
            first, last = dr.select(past, self.starts[k], first), dr.select(past, self.starts[k + 1], last)
        share = (i - first) / dr.maximum(last - first, 1.0)
        if self.umbra is None:
            return dr.fma(high - low, share, low)
        a, b = (dr.clip(edge, low, high) for edge in self.umbra)
        third = dr.minimum(dr.floor(3.0 * share + 1e-9), 2.0)
        within = 3.0 * share - third
        begin = dr.select(third < 0.5, low, dr.select(third < 1.5, a, b))
        end = dr.select(third < 0.5, a, dr.select(third < 1.5, b, high))
        return dr.select(self.crossed, dr.fma(end - begin, within, begin), dr.fma(high - low, share, low))


def layered_steps(
    planet: Planet,
    path: AirPath,
    o: Vec,
    d: Vec,
    bands: Bands,
    count: int,
    concentration: float | mi.Float64 = SOLAR_CONCENTRATION,
    umbra: tuple[mi.Float64, mi.Float64] | None = None,
    *,
    spare: bool = False,
    twice: bool = False,
) -> LayeredSteps:
    """Return the steps of rays, cut at the edges of layers.

    ``bands``: heights between which layers lie; ``count``: steps of the march without layers; ``umbra``: ``y`` where
    rays enter and leave the umbra, their ends where they do not; ``spare``: fewer steps above the layers
    (:data:`SPARE_OUTER`); ``twice``: as many steps where the umbra's edge crosses a ray.
    """
    crossed, ends, times = mi.Bool(False), None, mi.Float64(1.0)
    if umbra is not None:
        crossed = (umbra[0] > path.y0) | (umbra[1] < path.y1)
        ends = umbra[0], dr.maximum(umbra[1], umbra[0])
        times = dr.select(crossed, constant(2.0 if twice else 1.0), 1.0)
    begin, end = path.t_low - path.length_before, path.t_low + path.length_after
    down: list[mi.Float64] = []
    up: list[mi.Float64] = []
    steps_down: list[int] = []
    below, inner = _twelve(count / 2 if bands else count), _twelve(count / 4)
    outer = _twelve(count * SPARE_OUTER) if spare else below
    for n, band in enumerate(reversed(bands)):
        steps_down += [outer if n == 0 else inner, band.steps]
        for height in (band.top_m, band.base_m):
            mid, half, _ = planet.chord(o, d, constant(height))
            down.append(mid - half)
            up.insert(0, mid + half)
    cuts = [begin]
    for t in [*down, *up]:
        cuts.append(dr.maximum(dr.clip(t, begin, end), cuts[-1]))
    cuts.append(end)
    starts = [constant(0.0)]
    for k, steps in enumerate([*steps_down, below, *reversed(steps_down)]):
        starts.append(starts[-1] + dr.select(cuts[k + 1] > cuts[k], times * constant(float(steps)), 0.0))
    y = [path.y0, *(dr.clip(unwarp(path, t, concentration), path.y0, path.y1) for t in cuts[1:-1]), path.y1]
    return LayeredSteps(tuple(y), tuple(starts), ends, crossed)


def _twelve(steps: float) -> int:
    """Return a number of steps as a multiple of twelve: for rounds of four steps, and thirds of pieces."""
    return 12 * max(1, round(steps / 12.0))
