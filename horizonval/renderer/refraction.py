"""Apparent-radius (Bouguer) coordinates: a change of height in which refracted light goes straight.

In air of index n(r) around a sphere Bouguer's law holds, ``n r sin(theta) = b``, theta the angle between ray and
vertical. With the apparent radius ``x = n(r) r`` this is the law of a straight line, ``x sin(theta) = b``, and::

    ds = (dr / dx) dt                                 path of the bent ray and of the straight one
    dpsi = g(x) sin(theta) dt,   g = -d ln n / dx     by how much the bent ray has turned downwards

so that the straight march in x with every coefficient multiplied by ``dr/dx = 1 / (n + r dn/dr)`` is exact for the bent
ray. The ground lies at ``x = n(0) R``: the **apparent planet** is larger by ``(n(0) - 1) R``, 1.77 km in visible light.
The local frame (vertical and ray) of the bent ray is that of the straight one, turned by psi in the plane of the ray;
instead of the frame the Sun is turned, by -psi.

**The Sun's light** arrives at apparent radius x with a true zenith angle Theta (of the Sun at infinity) and a local one
theta = Theta - psi. Tables give per height the cosine of the lowest Sun that still shines, and per height and
``cos(Theta)`` the lift ``cos(theta) - cos(Theta)`` and the spreading of the beam: the irradiance across the ray changes
by ``n^2 d cos(theta) / d cos(Theta)``. Radiance goes with n^2 as well, so that scattered light leaves the air without
any n^2, which is left out throughout (a camera inside the air would see 5e-4 more at the ground).

**One scale for all air.** Apparent radii are multiplied by ``s = (R + w) / (n(0) R)``, w whole kilometres (2 km for all
the Earth's air): lines stay straight, and the apparent planet and the top of the air are the same whatever the air, so
that all scenes share kernels. Cameras move by some 4e-5 of their distance; directions stay.

Approximations: one index for all wavelengths of a model, the mean of its nodes (1 % of the bending at either end of the
visible; 20 m at the ground, 5 m at 10 km); one radius of curvature, the mean (10 m at the ground in places, 3 m at
10 km); geodetic verticals turn with the ray as if the planet were a sphere (1e-4 rad). Light is bent as by the column
below the camera, whatever the air at the limb: no horizontal gradients, no scintillation.

A ray that grazes the ground turns by 1.1 deg between space and space, so that a setting Sun seen from space is lifted
and flattened.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Generic

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.column import OpticalModel
from horizonval.renderer.column_air import ColumnAir, DepthFactor
from horizonval.renderer.planet import GAUSS_LOW, AirPath, Planet, along, dot, find_path, warp
from horizonval.renderer.tables import (
    TAU_FLOOR,
    AltitudeGrid,
    SunShell,
    SunTable,
    interpolate,
    table_of,
    through_shells,
)
from horizonval.renderer.types import Real, Values, Vec, Vec3, constant, in_single, inverse_root

STEP_M = 100.0
"""Largest distance of the nodes of a model over apparent heights."""
_FINE = 10
WHOLE_M = 1000.0
"""In whole numbers of which the apparent planet is larger than the planet, in the scale that all air shares."""
LEAST_SLOPE = 0.05
"""Least ``dx/dr``: below 0 a level ray would be held by the air for ever."""


@dataclass(frozen=True)
class ApparentRadiusAir:
    """A model over apparent heights, in which light goes straight, for the march.

    ``model``: over apparent heights ``s (x - n(0) R)``, coefficients per metre of the straight line, on the apparent
    ``planet``. Per node (n,): ``bending_per_m``, the g of the module text; ``height_m``, the true height; ``dr_dx``,
    metres of the bent ray per metre of the straight one. ``altitude_m``, ``rise_m``: true heights, and the apparent
    radius less the radius. ``scale``: the s of the module text. ``true_model``, ``true_planet``: without refraction.
    """

    model: OpticalModel
    planet: Planet
    bending_per_m: FloatArray
    height_m: FloatArray
    dr_dx: FloatArray
    altitude_m: FloatArray
    rise_m: FloatArray
    scale: float
    true_model: OpticalModel
    true_planet: Planet

    def apparent_position(self, observer: Vec) -> Vec:
        """Return where observers stand among the straight rays: inside the air they are raised, and all are scaled."""
        height, normal = self.true_planet.height_and_normal(observer)
        rise = table_of(mi.Float64, np.interp(np.array(height), self.altitude_m, self.rise_m, right=0.0))
        scale = constant(self.scale)
        x, y, z = (scale * (observer[k] + rise * normal[k]) for k in range(3))
        return x, y, z


def apparent_planet(model: OpticalModel, planet: Planet) -> tuple[Planet, ApparentRadiusAir | None]:
    """Return the planet that straight rays see, and the air that makes them straight: none if nothing bends light."""
    if model.refractivity is None:
        return planet, None
    air = to_apparent_radius(model, planet)
    return air.planet, air


def to_apparent_radius(model: OpticalModel, planet: Planet) -> ApparentRadiusAir:
    """Return a model over apparent heights.

    ``UserError`` if refractivity falls so fast that a level ray follows the ground.
    """
    assert model.refractivity is not None
    z = model.altitude_m
    radius = planet.mean_radius_m
    excess = PchipInterpolator(z, model.refractivity - model.refractivity[-1])
    cells = np.maximum(1, np.ceil(np.diff(z) / STEP_M - 1e-9)).astype(int)
    nodes = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in zip(z, z[1:], cells, strict=False)])
    nodes = np.append(nodes, z[-1])

    rise_at_ground = float(excess(0.0)) * radius
    whole = WHOLE_M * round(rise_at_ground / WHOLE_M)
    scale = (radius + whole) / (radius + rise_at_ground)
    # at or above the top of the air, and the same for all air: what is left is empty
    top = float(z[-1]) - whole + (0.5 * WHOLE_M if whole else 0.0)

    def apparent(height: FloatArray) -> FloatArray:
        return scale * (height + excess(height) * (radius + height) - rise_at_ground)

    def slope(height: FloatArray) -> FloatArray:
        return 1.0 + excess(height) + (radius + height) * excess(height, 1)

    fine = np.interp(np.arange(_FINE * (len(nodes) - 1) + 1) / _FINE, np.arange(len(nodes)), nodes)
    steepest = int(np.argmin(slope(fine)))
    if slope(fine)[steepest] < LEAST_SLOPE:
        raise UserError(
            f"the air at {fine[steepest] / 1e3:.2f} km bends light as strongly as the ground curves",
            where="refractivity",
            expected="one that falls by less than 1.4e-7 per metre",
        )
    steps = np.diff(nodes)
    true_height = nodes
    if np.all(np.abs(steps - steps[0]) <= 1e-9 * z[-1]):
        # equal steps in apparent height, so that the march need not search
        apparent_height = np.linspace(0.0, top, len(nodes))
        true_height = np.interp(apparent_height, apparent(fine), fine)
    else:
        beyond = [top] if whole else []
        apparent_height = np.append(apparent(nodes), beyond)
        true_height = np.append(nodes, [z[-1]] * len(beyond))
    apparent_height[0] = 0.0
    air = apparent_height <= apparent(z[-1:])[0] * (1.0 + 1e-12)
    dr_dx = 1.0 / (scale * slope(true_height))

    def column(values: FloatArray) -> FloatArray:
        return np.interp(true_height, z, values)

    def per_metre(values: FloatArray) -> FloatArray:
        return np.where(air, column(values) * dr_dx, 0.0)

    def layer_columns(layers: FloatArray) -> FloatArray:
        return np.stack([column(values) * dr_dx for values in layers]) if len(layers) else layers

    columns = model.columns
    levels = apparent_height if columns is None else np.linspace(0.0, apparent_height[-1], len(columns.altitude_m))
    level_height = np.interp(levels, apparent_height, true_height)
    level_slope = np.interp(levels, apparent_height, np.where(air, dr_dx, 0.0))

    def more(values: FloatArray) -> FloatArray:
        if columns is None:
            return values
        return level_slope * np.stack([np.interp(level_height, columns.altitude_m, row) for row in values])

    straight = tuple(
        replace(
            node,
            extinction_per_m=per_metre(node.extinction_per_m),
            molecular_per_m=per_metre(node.molecular_per_m),
            particle_per_m=per_metre(node.particle_per_m),
            layer_per_m=layer_columns(node.layer_per_m),
            more_extinction_per_m=more(node.more_extinction_per_m),
            more_molecular_per_m=more(node.more_molecular_per_m),
            asymmetry=column(node.asymmetry),
        )
        for node in model.nodes
    )
    # the air that glows no longer bends
    glow = np.where(model.glow_altitude_m > 0.0, model.glow_altitude_m - whole, 0.0)
    return ApparentRadiusAir(
        model=replace(
            model,
            altitude_m=apparent_height,
            top_m=float(apparent_height[-1]),
            nodes=straight,
            refractivity=None,
            glow_altitude_m=glow,
            columns=None if columns is None else replace(columns, altitude_m=levels),
            layers=tuple((float(apparent(np.array(a))), float(apparent(np.array(b)))) for a, b in model.layers),
        ),
        planet=Planet(planet.a_m + whole, planet.b_m + whole),
        bending_per_m=-excess(true_height, 1) / (1.0 + excess(true_height)) * dr_dx,
        height_m=true_height,
        dr_dx=dr_dx,
        altitude_m=fine,
        rise_m=excess(fine) * (radius + fine),
        scale=scale,
        true_model=model,
        true_planet=planet,
    )


@dataclass(frozen=True)
class RefractedSunTable:
    """Where sunlight comes from: tables over apparent height ``top x_h^2`` and true solar zenith cosine::

        mu = mu_h(h) + (1 - mu_h(h)) x_mu^2

    ``grazing_bending``, (n_height,): bending angle [rad], up to there, of light that grazes the ground; mu_h is the
    cosine of the apparent horizon angle plus this. ``values``, (n_height * n_mu * 2,): lift of the cosine, spreading of
    the beam. ``field``: of the air.
    """

    field: BendingField
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
    """Where the light of a node batch comes from, besides its columns over apparent height.

    ``depth``: ``ln(tau + tau_0)`` towards the Sun on the nodes of ``sun``, (n_height * n_mu * width,), layers of thin
    cloud left out. ``shells``: these layers, over apparent heights.
    """

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
    """A straight ray in apparent-radius coordinates with the Sun as seen from the bent ray.

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
        up = across(vertical, d)
        return cls(tables, d, up, dot(d, sun), dot(up, sun), sun)

    def rate(self, point: Vec) -> mi.Float64:
        """Return how fast the bent ray turns at points of the straight one [rad/m]."""
        return self.tables.sun.field.look(point, self.up).rate

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
    ray: BentRay, o: Vec, d: Vec, t0: mi.Float64, t1: mi.Float64, bending: mi.Float64
) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
    """Return the bending angle at the two Gauss points of a step and at its end; ``bending`` at its beginning."""
    h = t1 - t0
    a, b = (ray.rate(along(o, d, t0 + share * h)) for share in (GAUSS_LOW, 1.0 - GAUSS_LOW))
    # the integral of the line through both points
    at_a = bending + h * (0.25 * a + (GAUSS_LOW - 0.25) * b)
    at_b = bending + h * ((0.75 - GAUSS_LOW) * a + 0.25 * b)
    return at_a, at_b, bending + 0.5 * h * (a + b)


def refracted_umbra(path: AirPath, o: Vec, d: Vec, ray: BentRay, count: int) -> tuple[mi.Float64, mi.Float64]:
    """Return ``y`` where a ray enters and leaves the umbra under refraction; its ends where it does not.

    That shadow has no closed form: its edges are interpolated between ``count`` evaluations along the ray, 0 for rays
    that are lit from end to end.
    """

    def evaluate(y: mi.Float64) -> tuple[mi.Float64, mi.Float64, mi.Float64, Vec]:
        t = warp(path, y)
        point = ray.tables.sun.field.look(along(o, d, t), ray.up)
        return t, point.rate, point.height_m, point.normal

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


BENDING_NODES = 128
GRID_STEP_M = 25.0
"""Largest step of the tables over heights, even so that no place needs a search: true heights within centimetres."""
LEAST_RISE = 1e-9
"""Of the table's coordinate from one direction to the next: above rounding, far below its thousandths between nodes."""


@dataclass(frozen=True)
class BentPoint(Generic[Real]):
    """A point of rays among the apparent heights.

    ``height_m``, ``normal``: there; ``true_m``: above the true planet; ``rate``: of bending [rad/m].
    """

    height_m: Real
    normal: Vec3[Real]
    true_m: Real
    rate: Real


@dataclass(frozen=True)
class BendingField:
    """The apparent planet and the rate of bending above it.

    ``per_m`` [rad/m] and ``true_m``, the height above ``true_planet``, on ``grid``; ``single``: in single precision.
    """

    planet: Planet
    true_planet: Planet
    top_m: float
    grid: AltitudeGrid
    per_m: mi.Float64
    true_m: mi.Float64
    single: tuple[mi.Float32, mi.Float32]

    @classmethod
    def of(cls, air: ApparentRadiusAir) -> BendingField:
        """Build from air in apparent-radius coordinates."""
        apparent = air.model.altitude_m
        height = np.linspace(0.0, apparent[-1], math.ceil(apparent[-1] / GRID_STEP_M) + 1)
        columns = [np.interp(height, apparent, values) for values in (air.bending_per_m, air.height_m)]
        per_m, true_m = (table_of(mi.Float64, column) for column in columns)
        one, two = (table_of(mi.Float32, column) for column in columns)
        top_m = air.model.top_m
        return cls(air.planet, air.true_planet, top_m, AltitudeGrid.of(height), per_m, true_m, (one, two))

    def up(self, o: Vec, d: Vec) -> Vec:
        """Return the unit vector across a ray in its vertical plane."""
        mid, half, _ = self.planet.chord(o, d)
        return across(self.planet.height_and_normal(along(o, d, mid - half))[1], d)

    def look(self, point: Vec3[Real], up: Vec3[Real]) -> BentPoint[Real]:
        """Return what is at points of rays; ``up``: :meth:`up`. In single precision heights are good to a metre."""
        height, normal = self.planet.height_and_normal(point)
        i, w, inside = self.grid.locate(height)
        single = dr.type_v(height) == dr.VarType.Float32
        tables: Any = self.single if single else (self.per_m, self.true_m)
        rate = dr.select(inside, interpolate(tables[0], i, w, 1)[0] * dot(normal, up), 0.0)
        return BentPoint(height, normal, interpolate(tables[1], i, w, 1)[0], rate)

    def true_height(self, apparent_m: Real) -> Real:
        """Return true heights at apparent ones."""
        i, w, _ = self.grid.locate(apparent_m)
        single = dr.type_v(apparent_m) == dr.VarType.Float32
        table: Any = self.single[1] if single else self.true_m
        return interpolate(table, i, w, 1)[0]

    def turned(self, o: Vec, d: Vec, angle: mi.Float64) -> Vec:
        """Return the direction of bent rays that are seen in direction ``d`` where they have turned by an angle."""
        sine, cosine = dr.sincos(angle)
        up = self.up(o, d)
        return d[0] * cosine - up[0] * sine, d[1] * cosine - up[1] * sine, d[2] * cosine - up[2] * sine

    def place(self, o: Vec, d: Vec, t: mi.Float64, angle: mi.Float64) -> tuple[mi.Float64, Vec]:
        """Return height and vertical over the true planet where rays have turned by an angle at ``t``, in the air.

        By Bouguer's law a bent ray makes the angle with the vertical that the straight one makes at the same apparent
        height; as it has turned downwards, its vertical is turned forwards.
        """
        apparent, normal = self.planet.height_and_normal(along(o, d, t))
        return self.true_height(apparent), vertical_of(normal, d, angle)

    def angle(
        self, o: Vec, d: Vec, nodes: int = BENDING_NODES, end: mi.Float64 | None = None, *, single: bool = False
    ) -> mi.Float64:
        """Return the bending angle [rad] of light that is seen in direction ``d``, on its way through all the air.

        Rays that meet the ground are followed through it, in air like that at the ground, so that the answer is smooth
        across the limb. ``end``: where rays end before they have left the air. ``single``: find heights in single
        precision.
        """
        path = find_path(self.planet, self.top_m, o, d, mi.Bool(False), None if end is None else (mi.Bool(True), end))
        up = self.up(o, d)
        count = nodes // 2
        offset = 0.5 / math.sqrt(3.0)

        def rate(t: mi.Float64) -> mi.Float64:
            point = along(o, d, t)
            return mi.Float64(self.look(in_single(point), in_single(up)).rate) if single else self.look(point, up).rate

        zero = dr.zeros(mi.Float64, dr.width(path.t_low))
        step = (path.y1 - path.y0) / count

        def body(i: mi.UInt32, t0: mi.Float64, total: mi.Float64) -> tuple[mi.UInt32, mi.Float64, mi.Float64]:
            t1 = warp(path, path.y0 + step * (mi.Float64(i) + 1.0))
            mid, h = 0.5 * (t0 + t1), t1 - t0
            return i + 1, t1, total + 0.5 * h * (rate(mid - offset * h) + rate(mid + offset * h))

        start = warp(path, path.y0 + zero)
        return dr.while_loop((mi.UInt32(0), start, zero + 0.0), lambda i, *_: i < count, body, label="bending")[2]

    def largest_angle(self) -> float:
        """Return the bending angle [rad] of light that grazes the ground, between space and space."""
        zero, radius = mi.Float64(0.0), self.planet.mean_radius_m
        o = (mi.Float64(-2.0 * radius), zero, mi.Float64(radius))
        sphere = replace(self, planet=Planet(radius, radius))
        return float(sphere.angle(o, (mi.Float64(1.0), zero, zero))[0])


def across(vertical: Vec, d: Vec) -> Vec:
    """Return the unit vector across rays in the plane of a vertical, 0 where they are vertical."""
    slope = dot(vertical, d)
    x, y, z = (vertical[k] - slope * d[k] for k in range(3))
    scale = inverse_root(dr.maximum(x * x + y * y + z * z, 1e-12))
    return x * scale, y * scale, z * scale


def vertical_of(normal: Vec3[Real], d: Vec3[Real], angle: Real) -> Vec3[Real]:
    """Return the verticals where rays have turned by an angle, from the normals where they would be straight."""
    slope = dot(normal, d)
    forward = (d[0] - slope * normal[0], d[1] - slope * normal[1], d[2] - slope * normal[2])
    sine, cosine = small_sincos(angle)
    sine = sine * inverse_root(dr.maximum(dot(forward, forward), 1e-12))
    x, y, z = (dr.fma(cosine, normal[k], sine * forward[k]) for k in range(3))
    return x, y, z


def turn_between(before: Real, after: Real) -> Real:
    """Return the mean of how fast rays turn between two points, by what they do there: within 1 % where it changes
    exponentially by up to a factor of ten, as over two scale heights.
    """
    return (2.0 * dr.sqrt(dr.maximum(before * after, 0.0)) + 0.5 * (before + after)) * (1.0 / 3.0)


def true_direction(field: BendingField, o: Vec, d: Vec) -> Vec:
    """Return the direction at infinity of what is seen in unit direction ``d`` from the apparent position ``o``."""
    return field.turned(o, d, field.angle(o, d))


def refracted_sun_table(
    field: BendingField, n_height: int, n_mu: int, nodes: int
) -> tuple[RefractedSunTable, FloatArray, FloatArray]:
    """Return the table of where sunlight comes from, with heights (n_height,) and local cosines (n_height, n_mu).

    Bending is integrated on a first set of local directions; splines invert it to the local directions of the table's
    true ones. Where air grows so much warmer upwards that lower local directions come from higher true ones, there is
    more than one image of the Sun. The lowest local direction is taken and the light of the others neglected: such
    inversions are some hundred metres deep, and shine on that air alone, with the Sun on its horizon.
    """
    radius = field.planet.mean_radius_m
    sphere = replace(field, planet=Planet(radius, radius))
    height, cosine = SunTable.nodes(n_height, n_mu, radius, field.top_m)
    zero = mi.Float64(0.0)
    o = (zero, zero, table_of(mi.Float64, np.repeat(height, n_mu) + radius))
    mu = table_of(mi.Float64, cosine)
    angle = np.array(sphere.angle(o, (dr.sqrt(dr.maximum(1.0 - mu * mu, 0.0)), zero, mu), nodes)).reshape(cosine.shape)
    true = cosine * np.cos(angle) - np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) * np.sin(angle)
    lowest, lowest_local = true[:, :1], cosine[:, :1]
    x = np.linspace(0.0, 1.0, n_mu)
    x_true = np.sqrt(np.maximum(true - lowest, 0.0) / (1.0 - lowest))
    local = np.empty_like(true)
    spreading = np.empty_like(true)
    for row in range(n_height):
        risen = np.maximum.accumulate(x_true[row])
        rises = np.concatenate([[True], np.diff(risen) > LEAST_RISE])
        # Where single places are left out a cubic spline would swing.
        spline = (CubicSpline if rises.all() else PchipInterpolator)(x_true[row][rises], x[rises])
        x_local, slope = spline(x), spline(x, 1)
        scale = (1.0 - lowest_local[row]) / (1.0 - lowest[row])
        local[row] = lowest_local[row] + (1.0 - lowest_local[row]) * x_local**2
        # d(local) / d(true); both squares vanish at the lowest Sun
        spreading[row] = scale * slope * np.append(slope[:1], x_local[1:] / x[1:])
    cosine_true = lowest + (1.0 - lowest) * x**2
    values = np.stack([local - cosine_true, spreading], axis=-1)
    grazing_bending = table_of(mi.Float64, angle[:, 0])
    table = RefractedSunTable(field, grazing_bending, table_of(mi.Float64, values), n_height, n_mu, radius, field.top_m)
    return table, height, np.clip(local, lowest_local, 1.0)


END_BENDING_NODES = 32
"""Along a ray to its end. Against ten times as many the angle is within 1e-5 rad, 60 m on the ground."""


@dataclass(frozen=True)
class RayEnd:
    """The end of rays. ``height_m``: geodetic; ``vertical``, ``direction``: unit vectors; ``point``.

    Planet-centred [m].

    ``bending``: angle by which the ray has turned [rad]; None without refraction.
    """

    height_m: mi.Float64
    vertical: Vec
    direction: Vec
    point: Vec
    bending: mi.Float64 | None


def ray_end(
    planet: Planet, bending: BendingField | None, o: Vec, d: Vec, t: mi.Float64, angle: mi.Float64 | None = None
) -> RayEnd:
    """Return where rays ``o + t d`` end, straight among those of ``planet``; ``bending`` None without refraction.

    ``t``: inside the air; ``angle``: bending angle there [rad], where it is known.
    """
    if bending is None:
        point = along(o, d, t)
        height, vertical = planet.height_and_normal(point)
        return RayEnd(height, vertical, d, point, None)
    if angle is None:
        angle = bending.angle(o, d, END_BENDING_NODES, t)
    height, vertical = bending.place(o, d, t, angle)
    point = bending.true_planet.point(height, vertical)
    return RayEnd(height, vertical, bending.turned(o, d, angle), point, angle)
