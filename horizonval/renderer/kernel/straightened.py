r"""Refraction without bent rays: a change of height in which light goes straight.

In air of index n(r) around a sphere Bouguer's law holds, ``n r sin(theta) = b``, theta the angle between ray and
vertical. With the apparent radius ``x = n(r) r`` this is the law of a straight line, ``x sin(theta) = b``, and::

    ds = (dr / dx) dt                                 path of the bent ray and of the straight one
    dpsi = g(x) sin(theta) dt,   g = -d ln n / dx     by how much the bent ray has turned downwards

so that the straight march in x with every coefficient multiplied by ``dr/dx = 1 / (n + r dn/dr)`` is exact for the bent
ray. The ground lies at ``x = n(0) R``: the **apparent planet** is larger by ``(n(0) - 1) R``, 1.77 km in visible light,
and whatever asks where an outline is asks it of that planet. The local frame (vertical and ray) of the bent ray is that
of the straight one, turned by psi in the plane of the ray; instead of the frame the Sun is turned, by -psi.

**The Sun's light** arrives at apparent radius x with a true zenith angle Theta (of the Sun at infinity) and a local one
theta = Theta - psi: tables give per height the cosine of the lowest Sun that still shines, and per height and
``cos(Theta)`` the lift ``cos(theta) - cos(Theta)`` and the spreading of the beam. With the annuli of a parallel beam,
``b db / (r^2 sin(Theta) dTheta cos(theta))``, the irradiance across the ray changes by::

    n^2 d cos(theta) / d cos(Theta)

Radiance goes with n^2 as well, so that scattered light leaves the air without any n^2; it is left out throughout (a
camera inside the air would see 5e-4 more at the ground).

Approximations: one index for all wavelengths of a model, the mean of its nodes (1 % of the bending at either end of the
visible; 20 m at the ground, 5 m at 10 km); one radius of curvature, the mean (N dR: 10 m at the ground in places of the
Earth's ellipsoid, 3 m at 10 km, less above); geodetic verticals turn with the ray as if the planet were a sphere
(1e-4 rad). Air is in layers: no horizontal gradients, no scintillation. The index starts from 1 at the highest node.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.column import OpticalModel
from horizonval.renderer.planet import Planet, Vec, dot
from horizonval.renderer.tables import TAU_FLOOR, interpolate

STEP_M = 100.0
"""Largest distance of the nodes of a straightened model."""
_FINE = 10
LEAST_SLOPE = 0.05
"""Least ``dx/dr``: below 0 a level ray would be held by the air for ever."""


def mean_radius(planet: Planet) -> float:
    """Return the radius [m] of the sphere that stands in for the ellipsoid where only curvature counts.

    Tables see local height and solar zenith: optical depths near the horizon go with the square root of the radius,
    0.17 % between equator and pole.
    """
    return (2.0 * planet.a_m + planet.b_m) / 3.0


@dataclass(frozen=True)
class StraightAir:
    """A model in which light goes straight, for the march.

    Attributes
    ----------
    model : OpticalModel
        Over apparent heights ``x - n(0) R``, coefficients per metre of the straight line.
    planet : Planet
        The apparent planet.
    turn_per_m : ndarray, shape (n,)
        g of the module text.
    height_m : ndarray, shape (n,)
        True heights of the model's nodes.
    shrink : ndarray, shape (n,)
        ``dr/dx``: metres of the bent ray per metre of the straight one, by which the coefficients are multiplied.
    altitude_m, rise_m : ndarray
        True heights, and by how much the apparent radius is larger than the radius.
    unbent : OpticalModel
        The model as it was.
    ground : Planet
        The planet as it is.
    """

    model: OpticalModel
    planet: Planet
    turn_per_m: FloatArray
    height_m: FloatArray
    shrink: FloatArray
    altitude_m: FloatArray
    rise_m: FloatArray
    unbent: OpticalModel
    ground: Planet

    def raised(self, observer: Vec) -> Vec:
        """Return where observers stand among the straight rays: inside the air they are raised, outside they stay."""
        height, normal = self.ground.height_and_normal(observer)
        rise = mi.Float64(np.interp(np.array(height), self.altitude_m, self.rise_m, right=0.0))
        return observer[0] + rise * normal[0], observer[1] + rise * normal[1], observer[2] + rise * normal[2]


def straighten(model: OpticalModel, planet: Planet) -> StraightAir:
    """Return the straightened model.

    Raises
    ------
    UserError
        The refractivity falls so fast somewhere that a level ray follows the ground.
    """
    assert model.refractivity is not None
    z = model.altitude_m
    radius = mean_radius(planet)
    excess = PchipInterpolator(z, model.refractivity - model.refractivity[-1])
    cells = np.maximum(1, np.ceil(np.diff(z) / STEP_M - 1e-9)).astype(int)
    nodes = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in zip(z, z[1:], cells, strict=False)])
    nodes = np.append(nodes, z[-1])

    def apparent(height: FloatArray) -> FloatArray:
        return height + excess(height) * (radius + height) - excess(0.0) * radius

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
    at = nodes
    if np.all(np.abs(steps - steps[0]) <= 1e-9 * z[-1]):
        # equal steps in apparent height, so that the march need not search
        wanted = np.linspace(0.0, float(apparent(z[-1:])[0]), len(nodes))
        at = np.interp(wanted, apparent(fine), fine)
        at[-1] = z[-1]
    else:
        wanted = apparent(nodes)
    wanted[0], wanted[-1] = 0.0, round(float(wanted[-1]), 6)
    shrink = 1.0 / slope(at)

    def column(values: FloatArray) -> FloatArray:
        return np.interp(at, z, values)

    straight = tuple(
        replace(
            node,
            extinction_per_m=column(node.extinction_per_m) * shrink,
            molecular_per_m=column(node.molecular_per_m) * shrink,
            particle_per_m=column(node.particle_per_m) * shrink,
            asymmetry=column(node.asymmetry),
            source=column(node.source),
        )
        for node in model.nodes
    )
    # Whole micrometres: lengths are constants of the kernels, their last bits would make every frame compile its own.
    larger = round(float(excess(0.0)) * radius, 6)
    # above the top the air goes on shining but no longer bends
    glow = np.minimum(model.glow_altitude_m, z[-1])
    glow = np.round(np.where(glow > 0.0, apparent(glow), 0.0) + model.glow_altitude_m - glow, 6)
    return StraightAir(
        model=replace(
            model,
            altitude_m=wanted,
            top_m=float(wanted[-1]),
            nodes=straight,
            refractivity=None,
            glow_altitude_m=glow,
        ),
        planet=Planet(planet.a_m + larger, planet.b_m + larger),
        turn_per_m=-excess(at, 1) / (1.0 + excess(at)) * shrink,
        height_m=at,
        shrink=shrink,
        altitude_m=fine,
        rise_m=excess(fine) * (radius + fine),
        unbent=model,
        ground=planet,
    )


@dataclass(frozen=True)
class SunAim:
    """Where the Sun's light comes from: tables over apparent height ``top x_h^2`` and true solar zenith cosine::

        mu = mu_h(h) + (1 - mu_h(h)) x_mu^2

    Attributes
    ----------
    turned : Float64, shape (n_height,)
        By how much light that grazes the ground has turned when it arrives; mu_h is the cosine of the apparent planet's
        horizon angle plus this.
    values : Float64, shape (n_height * n_mu * 2,)
        Lift of the cosine, and spreading of the beam.
    """

    turned: Any
    values: Any
    n_height: int
    n_mu: int
    radius_m: float
    top_m: float

    def cell(self, height_m: Any) -> tuple[Any, Any, Any]:
        """Return the lower row of a height, the weight of the upper one, and the lowest Sun's true cosine."""
        h = dr.clip(height_m, 0.0, self.top_m)
        x = dr.sqrt(h * (1.0 / self.top_m)) * (self.n_height - 1)
        i = dr.minimum(mi.UInt32(x), self.n_height - 2)
        w = x - mi.Float64(i)
        sine, cosine = _small_sincos(interpolate(self.turned, i, w, 1)[0])
        r = self.radius_m + h
        return i, w, -(dr.sqrt(h * (2.0 * self.radius_m + h)) * cosine + self.radius_m * sine) / r


def _small_sincos(angle: Any) -> tuple[Any, Any]:
    """Return sine and cosine of an angle of at most 0.1 rad, good to 1e-9."""
    a2 = angle * angle
    return angle * (1.0 - a2 * (1.0 / 6.0 - a2 * (1.0 / 120.0))), 1.0 - a2 * (0.5 - a2 * (1.0 / 24.0))


@dataclass(frozen=True)
class Bending:
    """What a chunk needs beside its straightened columns to know where the light comes from.

    Attributes
    ----------
    turn, height : Float64, shape (n_altitude,)
        g and the true height on the chunk's grid.
    aim : SunAim
    depth : Float64, shape (n_height * n_mu * width,)
        ``ln(tau + tau_0)`` towards the Sun on the nodes of ``aim``.
    """

    turn: Any
    height: Any
    aim: SunAim
    depth: Any

    def sunlight(self, height_m: Any, mu: Any, width: int) -> tuple[list[Any], Any, Any]:
        """Return ``(share of the Sun's irradiance across the ray, whether it shines, local cosine)``.

        ``mu`` is the true cosine. The share is transmittance times spreading.
        """
        aim = self.aim
        i, wx, lowest = aim.cell(height_m)
        y = dr.sqrt(dr.clip((mu - lowest) / (1.0 - lowest), 0.0, 1.0)) * (aim.n_mu - 1)
        j = dr.minimum(mi.UInt32(y), aim.n_mu - 2)
        wy = y - mi.Float64(j)
        row = i * aim.n_mu + j

        def look(table: Any, n: int) -> list[Any]:
            near, far = interpolate(table, row, wy, n), interpolate(table, row + aim.n_mu, wy, n)
            return [dr.fma(b - a, wx, a) for a, b in zip(near, far, strict=True)]

        lift, spread = look(aim.values, 2)
        share = [spread * dr.exp(TAU_FLOOR - dr.exp(v)) for v in look(self.depth, width)]
        return share, mu > lowest, dr.minimum(mu + lift, 1.0)


@dataclass(frozen=True)
class BentRay:
    """A straight ray that knows how the bent one turns: the Sun as seen from it.

    ``along_sun``, ``up_sun``: components of the Sun's direction along the ray and along ``up``.
    ``up``: unit vector across the ray in its vertical plane, 0 for vertical rays; they do not turn.
    """

    bending: Bending
    direction: Vec
    up: Vec
    along_sun: Any
    up_sun: Any
    sun: Vec

    @classmethod
    def of(cls, bending: Bending, d: Vec, sun: Vec, vertical: Vec) -> BentRay:
        """Build from the vertical at the ray's lowest point."""
        slope = dot(vertical, d)
        up = (vertical[0] - slope * d[0], vertical[1] - slope * d[1], vertical[2] - slope * d[2])
        scale = dr.rsqrt(dr.maximum(dot(up, up), 1e-12))
        up = (up[0] * scale, up[1] * scale, up[2] * scale)
        return cls(bending, d, up, dot(d, sun), dot(up, sun), sun)

    def turn_per_m(self, i: Any, w: Any, inside: Any, normal: Vec) -> Any:
        """Return how fast the bent ray turns at a place of the chunk's grid."""
        return dr.select(inside, interpolate(self.bending.turn, i, w, 1)[0] * dot(normal, self.up), 0.0)

    def true_height(self, i: Any, w: Any) -> Any:
        """Return the height of a place of the chunk's grid above the planet as it is."""
        return interpolate(self.bending.height, i, w, 1)[0]

    def sun_at(self, turned: Any) -> Vec:
        """Return the true Sun as the straight ray's own frame sees it where the bent ray has turned by ``turned``."""
        sine, cosine = _small_sincos(turned)
        less = cosine - 1.0
        along = less * self.along_sun - sine * self.up_sun
        up = sine * self.along_sun + less * self.up_sun
        s, d, u = self.sun, self.direction, self.up
        x, y, z = (dr.fma(d[k], along, dr.fma(u[k], up, s[k])) for k in range(3))
        return x, y, z

    def sunlight(self, height_m: Any, normal: Vec, turned: Any, width: int) -> tuple[list[Any], Any, Any, Any]:
        """Return ``(share of irradiance, whether the Sun shines, local cosine, cosine of the scattering angle)``."""
        sun = self.sun_at(turned)
        mu, along, slope = dot(normal, sun), dot(self.direction, sun), dot(normal, self.direction)
        share, lit, local = self.bending.sunlight(height_m, mu, width)
        ratio = dr.sqrt(dr.maximum(1.0 - local * local, 0.0) / dr.maximum(1.0 - mu * mu, 1e-12))
        return share, lit, local, dr.select(mu < 0.999999, ratio * (along - slope * mu) + slope * local, along)

    def sun_above_lowest(self, height_m: Any, normal: Vec, turned: Any) -> Any:
        """Return by how much (true cosine) the Sun stands above the lowest that shines."""
        return dot(normal, self.sun_at(turned)) - self.bending.aim.cell(height_m)[2]
