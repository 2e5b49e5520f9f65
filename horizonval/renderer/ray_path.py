"""Where steps go along rays: the stretch of a ray inside the air, its parameter, and how steps are shared out.

A ray is cut at its lowest point into a descending and an ascending piece. With ``y`` from -1 (entry) over 0 (lowest
point) to 1 (exit) the distance from the lowest point is ``l (c |y| + (1 - c) |y|^3)``: dense where the air is dense.
One step holds two Gauss points.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.planet import Planet, along
from horizonval.renderer.types import Vec, constant

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


def warp(path: AirPath, y: mi.Float64, c: float) -> mi.Float64:
    """Return the ray parameter [m] of ``y``; ``c`` as in the module text."""
    reach = dr.abs(y)
    reach = reach * dr.fma(reach * reach, 1.0 - c, c)
    return path.t_low + dr.select(y < 0.0, -path.length_before, path.length_after) * reach


def unwarp(path: AirPath, t: mi.Float64, c: float) -> mi.Float64:
    """Return ``y`` of a ray parameter: the real root of ``c y + (1 - c) y^3 = x``, by the hyperbolic solution."""
    s = t - path.t_low
    length = dr.select(s < 0.0, path.length_before, path.length_after)
    x = dr.minimum(dr.abs(s) / dr.maximum(length, 1e-3), 1.0)
    p = c / (1.0 - c)
    q = x / (1.0 - c)
    scale = 2.0 * math.sqrt(p / 3.0)
    arg = 3.0 * q / (p * scale)
    growth = dr.exp(dr.log(arg + dr.sqrt(arg * arg + 1.0)) / 3.0)
    y = 0.5 * scale * (growth - 1.0 / growth)
    return dr.select(s < 0.0, -dr.minimum(y, 1.0), dr.minimum(y, 1.0))


@dataclass(frozen=True)
class Steps:
    """How the steps are shared out: step index boundaries ``n1 <= n2`` at the parameters ``y1 <= y2``."""

    n1: mi.Float64
    n2: mi.Float64
    y1: mi.Float64
    y2: mi.Float64

    def boundary(self, path: AirPath, i: mi.Float64, count: mi.Float64) -> mi.Float64:
        """Return ``y`` at step boundary ``i``: linear between the shared-out boundaries."""
        first = path.y0 + (self.y1 - path.y0) * (i / dr.maximum(self.n1, 1.0))
        middle = self.y1 + (self.y2 - self.y1) * ((i - self.n1) / dr.maximum(self.n2 - self.n1, 1.0))
        last = self.y2 + (path.y1 - self.y2) * ((i - self.n2) / dr.maximum(count - self.n2, 1.0))
        return dr.select(i < self.n1, first, dr.select(i < self.n2, middle, last))


def umbra_edges(planet: Planet, o: Vec, d: Vec, sun: Vec) -> tuple[mi.Float64, mi.Bool, mi.Float64, mi.Bool]:
    """Return the ray parameters where lines enter and leave the umbra, each with whether they do."""
    t1, t2, crosses = planet.shadow_crossings(o, d, sun)
    # a crossing counts only on the side away from the Sun: look a metre into the cylinder
    enters = crosses & planet.in_umbra(along(o, d, t1 + 1.0), sun)
    leaves = crosses & planet.in_umbra(along(o, d, t2 - 1.0), sun)
    return t1, enters, t2, leaves


def umbra(planet: Planet, path: AirPath, o: Vec, d: Vec, sun: Vec, c: float) -> tuple[mi.Float64, mi.Float64]:
    """Return ``y`` where the ray enters and leaves the umbra; its ends where it does not."""
    t1, real1, t2, real2 = umbra_edges(planet, o, d, sun)
    y1 = dr.select(real1, dr.clip(unwarp(path, t1, c), path.y0, path.y1), path.y0)
    y2 = dr.select(real2, dr.clip(unwarp(path, t2, c), path.y0, path.y1), path.y1)
    return y1, y2


def lit_steps(path: AirPath, y1: mi.Float64, y2: mi.Float64, count: int, steady: bool = False) -> Steps:
    """Share ``count`` steps out among the pieces before, in and behind the umbra, by their lengths in ``y``.

    ``steady``: a third to each piece, however short it is. Whole numbers of steps jump where lengths change gently, and
    with them, by the error of the quadrature, the radiance; tables are to be smooth.
    """
    if steady:
        crossed = (y1 > path.y0) | (y2 < path.y1)
        n1 = dr.select(crossed, constant(round(count / 3)), 0.0)
        n2 = dr.select(crossed, constant(round(2 * count / 3)), constant(count))
        return Steps(n1, n2, dr.select(crossed, y1, path.y0), dr.select(crossed, dr.maximum(y2, y1), path.y1))
    span = dr.maximum(path.y1 - path.y0, 1e-9)
    tiny = 1e-6 * span
    y1 = dr.select(y1 - path.y0 < tiny, path.y0, y1)
    y2 = dr.select(path.y1 - y2 < tiny, path.y1, dr.maximum(y2, y1))
    n1 = dr.round(count * (y1 - path.y0) / span)
    n2 = dr.round(count * (y2 - path.y0) / span)
    n1 = dr.clip(n1, dr.select(y1 > path.y0, mi.Float64(1.0), 0.0), count - 2.0)
    n2 = dr.clip(
        n2, n1 + dr.select(y2 > y1, mi.Float64(1.0), 0.0), count - dr.select(y2 < path.y1, mi.Float64(1.0), 0.0)
    )
    return Steps(n1, n2, y1, y2)


def even_steps(path: AirPath, count: int) -> Steps:
    """Return steps that are even in ``y``."""
    return Steps(mi.Float64(0.0), mi.Float64(count), path.y0, path.y1)


def glow_steps(planet: Planet, path: AirPath, o: Vec, d: Vec, layer_m: float, count: int, c: float) -> Steps:
    """Give each passage through what lies above ``layer_m`` two fifths of the steps."""
    mid, half, meets = planet.chord(o, d, layer_m)
    y1 = dr.select(meets, dr.clip(unwarp(path, mid - half, c), path.y0, path.y1), path.y0)
    y2 = dr.select(meets, dr.clip(unwarp(path, mid + half, c), path.y0, path.y1), path.y1)
    tiny = 1e-9 * dr.maximum(path.y1 - path.y0, 1e-9)
    layer_steps = float(round(0.4 * count))
    n1 = dr.select(y1 > path.y0 + tiny, mi.Float64(layer_steps), 0.0)
    n2 = dr.select(y2 < path.y1 - tiny, mi.Float64(count - layer_steps), float(count))
    return Steps(n1, n2, dr.select(n1 > 0.0, y1, path.y0), dr.select(n2 < count, y2, path.y1))


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
