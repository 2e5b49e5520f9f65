r"""The Sun as bent rays see it: sunlight that arrives through refracting air, and the umbra's edge under refraction.

Notation and approximations: :mod:`horizonval.renderer.refraction.apparent_radius`.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.column_air import ColumnAir, DepthFactor
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.ray_path import GAUSS_LOW, AirPath, warp
from horizonval.renderer.tables import TAU_FLOOR, AltitudeGrid, SunShell, interpolate, through_shells
from horizonval.renderer.types import Real, Values, Vec, inverse_root


@dataclass(frozen=True)
class RefractedSunTable:
    """Where sunlight comes from: tables over apparent height ``top x_h^2`` and true solar zenith cosine::

        mu = mu_h(h) + (1 - mu_h(h)) x_mu^2

    Attributes
    ----------
    grazing_bending : Float64, shape (n_height,)
        Bending angle [rad], so far, of light that grazes the ground; mu_h is the cosine of the apparent horizon
        angle plus this.
    values : Float64, shape (n_height * n_mu * 2,)
        Lift of the cosine, and spreading of the beam.
    """

    grazing_bending: mi.Float64
    values: mi.Float64
    n_height: int
    n_mu: int
    radius_m: float
    top_m: float

    def cell(self, height_m: mi.Float64) -> tuple[mi.UInt32, mi.Float64, mi.Float64]:
        """Return the lower row of a height, the weight of the upper one, and the lowest Sun's true cosine."""
        h = dr.clip(height_m, 0.0, self.top_m)
        x = dr.sqrt(h * (1.0 / self.top_m)) * (self.n_height - 1)
        i = dr.minimum(mi.UInt32(x), self.n_height - 2)
        w = x - mi.Float64(i)
        sine, cosine = small_sincos(interpolate(self.grazing_bending, i, w, 1)[0])
        r = self.radius_m + h
        return i, w, -(dr.sqrt(h * (2.0 * self.radius_m + h)) * cosine + self.radius_m * sine) / r


def small_sincos(angle: Real) -> tuple[Real, Real]:
    """Return sine and cosine of an angle of at most 0.1 rad, good to 1e-9."""
    a2 = angle * angle
    return angle * (1.0 - a2 * (1.0 / 6.0 - a2 * (1.0 / 120.0))), 1.0 - a2 * (0.5 - a2 * (1.0 / 24.0))


@dataclass(frozen=True)
class RefractionTables:
    """What a node batch needs beside its columns over apparent height to know where the light comes from.

    Attributes
    ----------
    bending_per_m, height : Float64, shape (n_altitude,)
        g and the true height on the batch's grid.
    sun : RefractedSunTable
    depth : Float64, shape (n_height * n_mu * width,)
        ``ln(tau + tau_0)`` towards the Sun on the nodes of ``sun``, layers of thin cloud left out.
    shells : tuple of SunShell
        These layers, over apparent heights.
    """

    bending_per_m: mi.Float64
    height: mi.Float64
    sun: RefractedSunTable
    depth: mi.Float64
    shells: tuple[SunShell, ...] = ()

    def sunlight(
        self, height_m: mi.Float64, mu: mi.Float64, width: int, factor: DepthFactor | None
    ) -> tuple[Values, mi.Bool, mi.Float64]:
        """Return ``(share of the Sun's irradiance across the ray, whether it shines, local cosine)``.

        ``mu`` is the true cosine. The share is transmittance times spreading. ``factor``: of the optical depth at the
        places, by the local cosine, layers of thin cloud left out.
        """
        sun = self.sun
        i, wx, lowest = sun.cell(height_m)
        y = dr.sqrt(dr.clip((mu - lowest) / (1.0 - lowest), 0.0, 1.0)) * (sun.n_mu - 1)
        j = dr.minimum(mi.UInt32(y), sun.n_mu - 2)
        wy = y - mi.Float64(j)
        row = i * sun.n_mu + j

        def look(table: mi.Float64, n: int) -> Values:
            near, far = interpolate(table, row, wy, n), interpolate(table, row + sun.n_mu, wy, n)
            return [dr.fma(b - a, wx, a) for a, b in zip(near, far, strict=True)]

        lift, spread = look(sun.values, 2)
        local = dr.minimum(mu + lift, 1.0)
        less = [TAU_FLOOR - dr.exp(v) for v in look(self.depth, width)]
        if factor is not None:
            less = [v * f for v, f in zip(less, factor(local), strict=True)]
        share = [spread * dr.exp(v) for v in less]
        share = through_shells(share, self.shells, dr.maximum(height_m, 0.0), local, sun.radius_m)
        return share, mu > lowest, local


@dataclass(frozen=True)
class BentRay:
    """A straight ray in apparent-radius coordinates that knows how the bent one turns: the Sun as seen from it.

    ``along_sun``, ``up_sun``: components of the Sun's direction along the ray and along ``up``.
    ``up``: unit vector across the ray in its vertical plane, 0 for vertical rays; they do not turn.
    """

    tables: RefractionTables
    direction: Vec
    up: Vec
    along_sun: mi.Float64
    up_sun: mi.Float64
    sun: Vec

    @classmethod
    def of(cls, tables: RefractionTables, d: Vec, sun: Vec, vertical: Vec) -> BentRay:
        """Build from the vertical at the ray's lowest point."""
        slope = dot(vertical, d)
        up = (vertical[0] - slope * d[0], vertical[1] - slope * d[1], vertical[2] - slope * d[2])
        scale = inverse_root(dr.maximum(dot(up, up), 1e-12))
        up = (up[0] * scale, up[1] * scale, up[2] * scale)
        return cls(tables, d, up, dot(d, sun), dot(up, sun), sun)

    def bending_per_m(self, i: mi.UInt32, w: mi.Float64, inside: mi.Bool, normal: Vec) -> mi.Float64:
        """Return how fast the bent ray turns at a place of the batch's grid."""
        return dr.select(inside, interpolate(self.tables.bending_per_m, i, w, 1)[0] * dot(normal, self.up), 0.0)

    def true_height(self, i: mi.UInt32, w: mi.Float64) -> mi.Float64:
        """Return the height of a place of the batch's grid above the planet as it is."""
        return interpolate(self.tables.height, i, w, 1)[0]

    def sun_at(self, bending: mi.Float64) -> Vec:
        """Return the true Sun as the straight ray's own frame sees it at a bending angle of the bent ray."""
        sine, cosine = small_sincos(bending)
        less = cosine - 1.0
        along = less * self.along_sun - sine * self.up_sun
        up = sine * self.along_sun + less * self.up_sun
        s, d, u = self.sun, self.direction, self.up
        x, y, z = (dr.fma(d[k], along, dr.fma(u[k], up, s[k])) for k in range(3))
        return x, y, z

    def sunlight(
        self, height_m: mi.Float64, normal: Vec, bending: mi.Float64, width: int, columns: ColumnAir | None
    ) -> tuple[Values, mi.Bool, mi.Float64, mi.Float64]:
        """Return ``(share of irradiance, whether the Sun shines, local cosine, cosine of the scattering angle)``.

        ``columns``: how the air differs from place to place.
        """
        sun = self.sun_at(bending)
        mu, along, slope = dot(normal, sun), dot(self.direction, sun), dot(normal, self.direction)
        factor = None if columns is None else columns.depth_factor(height_m, normal)
        share, lit, local = self.tables.sunlight(height_m, mu, width, factor)
        ratio = dr.sqrt(dr.maximum(1.0 - local * local, 0.0) / dr.maximum(1.0 - mu * mu, 1e-12))
        return share, lit, local, dr.select(mu < 0.999999, ratio * (along - slope * mu) + slope * local, along)

    def sun_above_lowest(self, height_m: mi.Float64, normal: Vec, bending: mi.Float64) -> mi.Float64:
        """Return by how much (true cosine) the Sun stands above the lowest that shines."""
        return dot(normal, self.sun_at(bending)) - self.tables.sun.cell(height_m)[2]


def bending_over_step(
    planet: Planet,
    ray: BentRay,
    grid: AltitudeGrid,
    o: Vec,
    d: Vec,
    t0: mi.Float64,
    t1: mi.Float64,
    bending: mi.Float64,
) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
    """Return the bending angle at the two Gauss points of a step and at its end; ``bending`` at its beginning."""
    h = t1 - t0
    rates = []
    for share in (GAUSS_LOW, 1.0 - GAUSS_LOW):
        height, normal = planet.height_and_normal(along(o, d, t0 + share * h))
        rates.append(ray.bending_per_m(*grid.locate(height), normal))
    a, b = rates
    # the integral of the line through both points
    at_a = bending + h * (0.25 * a + (GAUSS_LOW - 0.25) * b)
    at_b = bending + h * ((0.75 - GAUSS_LOW) * a + 0.25 * b)
    return at_a, at_b, bending + 0.5 * h * (a + b)


def refracted_umbra(
    planet: Planet, path: AirPath, o: Vec, d: Vec, ray: BentRay, grid: AltitudeGrid, count: int, c: float
) -> tuple[mi.Float64, mi.Float64]:
    """Return ``y`` where a ray enters and leaves the umbra under refraction; its ends where it does not.

    That shadow has no closed form: its edges are interpolated between ``count`` evaluations along the ray. Rays that
    are known to be lit from end to end need 0.
    """

    def evaluate(y: mi.Float64) -> tuple[mi.Float64, mi.Float64, mi.Float64, Vec]:
        t = warp(path, y, c)
        height, normal = planet.height_and_normal(along(o, d, t))
        return t, ray.bending_per_m(*grid.locate(height), normal), height, normal

    # as data: marches of more and fewer points share a kernel
    number = dr.opaque(mi.UInt32, count, 1)
    span = (path.y1 - path.y0) / dr.maximum(mi.Float64(number), 1.0)
    zero = dr.zeros(mi.Float64, dr.width(path.t_low))
    t, rate, height, normal = evaluate(path.y0 + zero)
    above = ray.sun_above_lowest(height, normal, zero)

    def body(
        i: mi.UInt32,
        t0: mi.Float64,
        rate0: mi.Float64,
        bending: mi.Float64,
        above0: mi.Float64,
        y1: mi.Float64,
        y2: mi.Float64,
    ) -> tuple[mi.UInt32, mi.Float64, mi.Float64, mi.Float64, mi.Float64, mi.Float64, mi.Float64]:
        y = path.y0 + span * (mi.Float64(i) + 1.0)
        t, rate, height, normal = evaluate(y)
        bending = bending + 0.5 * (rate0 + rate) * (t - t0)
        above = ray.sun_above_lowest(height, normal, bending)
        edge = y - span * above / dr.select(above == above0, 1.0, above - above0)
        y1 = dr.select((above0 >= 0.0) & (above < 0.0), edge, y1)
        y2 = dr.select((above0 < 0.0) & (above >= 0.0), edge, y2)
        return i + 1, t, rate, bending, above, y1, y2

    state = (mi.UInt32(0), t, rate, zero + 0.0, above, path.y0 + zero, path.y1 + zero)
    *_, y1, y2 = dr.while_loop(state, lambda i, *_: i < number, body, label="refracted umbra")
    return y1, y2
