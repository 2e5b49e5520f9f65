"""Bending angles: directions behind the air, places along bent rays, and where sunlight comes from.

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
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.ray_path import SOLAR_CONCENTRATION, find_path, warp
from horizonval.renderer.refraction.apparent_radius import ApparentRadiusAir
from horizonval.renderer.refraction.bent_ray import RefractedSunTable, small_sincos
from horizonval.renderer.tables import AltitudeGrid, SunTable, interpolate, table_of
from horizonval.renderer.types import Real, Vec, Vec3, constant, in_single, inverse_root

BENDING_NODES = 128
GRID_STEP_M = 25.0
"""Of the tables over heights, at most: even, so that no place needs a search. Their linear pieces are a model's own, as
the tables have nodes a tenth as far apart; between them true heights are off by centimetres."""
ENTERING_NODES = 257
LEAST_RISE = 1e-9
"""Of the table's coordinate from one direction to the next: above rounding, far below its thousandths between nodes."""


@dataclass(frozen=True)
class BentPoint(Generic[Real]):
    """A point of rays among the apparent heights.

    ``height_m``, ``normal``: there; ``true_m``: above the planet as it is; ``rate``: how fast rays turn [rad/m].
    """

    height_m: Real
    normal: Vec3[Real]
    true_m: Real
    rate: Real


@dataclass(frozen=True)
class BendingField:
    """The apparent planet and how fast light bends above it.

    ``per_m`` [rad/m] and ``true_m``, the height above ``true_planet``, on ``grid``; ``apparent_m`` on ``true_grid``.
    ``single``: the three in single precision.
    """

    planet: Planet
    true_planet: Planet
    top_m: float
    grid: AltitudeGrid
    per_m: mi.Float64
    true_m: mi.Float64
    true_grid: AltitudeGrid
    apparent_m: mi.Float64
    single: tuple[mi.Float32, mi.Float32, mi.Float32]

    @classmethod
    def of(cls, air: ApparentRadiusAir) -> BendingField:
        """Build from air in apparent-radius coordinates."""
        apparent = air.model.altitude_m
        height, true_height = (_even(column[-1]) for column in (apparent, air.height_m))
        columns = (
            np.interp(height, apparent, air.bending_per_m),
            np.interp(height, apparent, air.height_m),
            np.interp(true_height, air.height_m, apparent),
        )
        per_m, true_m, apparent_m = (table_of(mi.Float64, column) for column in columns)
        one, two, three = (table_of(mi.Float32, column) for column in columns)
        grids = AltitudeGrid.of(height), AltitudeGrid.of(true_height)
        top_m = air.model.top_m
        return cls(air.planet, air.true_planet, top_m, grids[0], per_m, true_m, grids[1], apparent_m, (one, two, three))

    def apparent(self, true_m: mi.Float32) -> mi.Float32:
        """Return the apparent heights of true ones."""
        i, w, _ = self.true_grid.locate(true_m)
        return interpolate(self.single[2], i, w, 1)[0]

    def up(self, o: Vec, d: Vec) -> Vec:
        """Return the unit vector across a ray in its vertical plane."""
        mid, half, _ = self.planet.chord(o, d)
        _, normal = self.planet.height_and_normal(along(o, d, mid - half))
        slope = dot(normal, d)
        up = (normal[0] - slope * d[0], normal[1] - slope * d[1], normal[2] - slope * d[2])
        scale = inverse_root(dr.maximum(dot(up, up), 1e-12))
        return up[0] * scale, up[1] * scale, up[2] * scale

    def look(self, point: Vec3[Real], up: Vec3[Real]) -> BentPoint[Real]:
        """Return what is at points of rays; ``up``: :meth:`up`. In single precision heights are good to a metre."""
        height, normal = self.planet.height_and_normal(point)
        i, w, inside = self.grid.locate(height)
        single = dr.type_v(height) == dr.VarType.Float32
        tables: Any = self.single if single else (self.per_m, self.true_m)
        rate = dr.select(inside, interpolate(tables[0], i, w, 1)[0] * dot(normal, up), 0.0)
        return BentPoint(height, normal, interpolate(tables[1], i, w, 1)[0], rate)

    def turned(self, o: Vec, d: Vec, angle: mi.Float64) -> Vec:
        """Return the direction of bent rays that are seen in direction ``d`` where they have turned by an angle."""
        sine, cosine = dr.sincos(angle)
        up = self.up(o, d)
        return d[0] * cosine - up[0] * sine, d[1] * cosine - up[1] * sine, d[2] * cosine - up[2] * sine

    def place(self, o: Vec, d: Vec, t: mi.Float64, angle: mi.Float64) -> tuple[mi.Float64, Vec]:
        """Return height and vertical, on the planet as it is, where rays have turned by an angle at ``t``, in the air.

        By Bouguer's law a bent ray makes the angle with the vertical that the straight one makes at the same apparent
        height; as it has turned downwards, its vertical is turned forwards.
        """
        apparent, normal = self.planet.height_and_normal(along(o, d, t))
        i, w, _ = self.grid.locate(apparent)
        return interpolate(self.true_m, i, w, 1)[0], vertical_of(normal, d, angle)

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
            t1 = warp(path, path.y0 + step * (mi.Float64(i) + 1.0), SOLAR_CONCENTRATION)
            mid, h = 0.5 * (t0 + t1), t1 - t0
            return i + 1, t1, total + 0.5 * h * (rate(mid - offset * h) + rate(mid + offset * h))

        start = warp(path, path.y0 + zero, SOLAR_CONCENTRATION)
        return dr.while_loop((mi.UInt32(0), start, zero + 0.0), lambda i, *_: i < count, body, label="bending")[2]

    def largest_angle(self) -> float:
        """Return the bending angle [rad] of light that grazes the ground, between space and space."""
        zero, radius = mi.Float64(0.0), self.planet.mean_radius_m
        o = (mi.Float64(-2.0 * radius), zero, mi.Float64(radius))
        sphere = replace(self, planet=Planet(radius, radius))
        return float(sphere.angle(o, (mi.Float64(1.0), zero, zero))[0])


@dataclass(frozen=True)
class EnteringAngles:
    """By how much light from space has turned where it comes down to a height, by the cosine of its angle there.

    ``values``: [rad], at cosines ``(k / (n - 1))^2``.
    """

    values: mi.Float32

    @classmethod
    def of(cls, field: BendingField, height_m: float) -> EnteringAngles:
        """Build for a height above the apparent planet. That is a sphere in here: 3e-6 rad."""
        radius = field.planet.mean_radius_m
        sphere, zero = replace(field, planet=Planet(radius, radius)), mi.Float64(0.0)
        mu = table_of(mi.Float64, np.linspace(0.0, 1.0, ENTERING_NODES) ** 2)
        o = (zero, zero, constant(radius + height_m))
        # upwards, as light is the same both ways
        values = mi.Float32(sphere.angle(o, (dr.sqrt(1.0 - mu * mu), zero, mu)))
        dr.eval(values)
        return cls(values)

    def at(self, mu: mi.Float32) -> mi.Float32:
        """Return the angles at cosines."""
        x = dr.sqrt(dr.clip(mu, 0.0, 1.0)) * (ENTERING_NODES - 1.0)
        i = dr.minimum(mi.UInt32(x), ENTERING_NODES - 2)
        return interpolate(self.values, i, x - mi.Float32(i), 1)[0]


def _even(top_m: float) -> FloatArray:
    """Return even heights from the ground to a top."""
    return np.linspace(0.0, top_m, math.ceil(top_m / GRID_STEP_M) + 1)


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
    """Return the direction behind the air, at infinity, of what is seen in unit direction ``d`` from ``o``.

    ``o`` stands among the straight rays: :meth:`ApparentRadiusAir.apparent_position`.
    """
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
    table = RefractedSunTable(grazing_bending, table_of(mi.Float64, values), n_height, n_mu, radius, field.top_m)
    return table, height, np.clip(local, lowest_local, 1.0)
