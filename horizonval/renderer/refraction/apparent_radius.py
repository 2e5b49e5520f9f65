r"""Apparent-radius (Bouguer) coordinates: a change of height in which refracted light goes straight.

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

import mitsuba as mi
import numpy as np
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.earth.column import OpticalModel
from horizonval.renderer.planet import Planet
from horizonval.renderer.types import Vec

STEP_M = 100.0
"""Largest distance of the nodes of a model over apparent heights."""
_FINE = 10
LEAST_SLOPE = 0.05
"""Least ``dx/dr``: below 0 a level ray would be held by the air for ever."""


@dataclass(frozen=True)
class ApparentRadiusAir:
    """A model over apparent heights, in which light goes straight, for the march.

    Attributes
    ----------
    model : OpticalModel
        Over apparent heights ``x - n(0) R``, coefficients per metre of the straight line.
    planet : Planet
        The apparent planet.
    bending_per_m : ndarray, shape (n,)
        g of the module text.
    height_m : ndarray, shape (n,)
        True heights of the model's nodes.
    dr_dx : ndarray, shape (n,)
        ``dr/dx``: metres of the bent ray per metre of the straight one, by which the coefficients are multiplied.
    altitude_m, rise_m : ndarray
        True heights, and by how much the apparent radius is larger than the radius.
    true_model : OpticalModel
        The model as it was.
    true_planet : Planet
        The planet as it is.
    """

    model: OpticalModel
    planet: Planet
    bending_per_m: FloatArray
    height_m: FloatArray
    dr_dx: FloatArray
    altitude_m: FloatArray
    rise_m: FloatArray
    true_model: OpticalModel
    true_planet: Planet

    def apparent_position(self, observer: Vec) -> Vec:
        """Return where observers stand among the straight rays: inside the air they are raised, outside they stay."""
        height, normal = self.true_planet.height_and_normal(observer)
        rise = mi.Float64(np.interp(np.array(height), self.altitude_m, self.rise_m, right=0.0))
        return observer[0] + rise * normal[0], observer[1] + rise * normal[1], observer[2] + rise * normal[2]


def to_apparent_radius(model: OpticalModel, planet: Planet) -> ApparentRadiusAir:
    """Return a model over apparent heights, in which light goes straight.

    Raises
    ------
    UserError
        The refractivity falls so fast somewhere that a level ray follows the ground.
    """
    assert model.refractivity is not None
    z = model.altitude_m
    radius = planet.mean_radius_m
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
    true_height = nodes
    if np.all(np.abs(steps - steps[0]) <= 1e-9 * z[-1]):
        # equal steps in apparent height, so that the march need not search
        apparent_height = np.linspace(0.0, float(apparent(z[-1:])[0]), len(nodes))
        true_height = np.interp(apparent_height, apparent(fine), fine)
        true_height[-1] = z[-1]
    else:
        apparent_height = apparent(nodes)
    apparent_height[0], apparent_height[-1] = 0.0, round(float(apparent_height[-1]), 6)
    dr_dx = 1.0 / slope(true_height)

    def column(values: FloatArray) -> FloatArray:
        return np.interp(true_height, z, values)

    def layer_columns(layers: FloatArray) -> FloatArray:
        return np.stack([column(values) * dr_dx for values in layers]) if len(layers) else layers

    straight = tuple(
        replace(
            node,
            extinction_per_m=column(node.extinction_per_m) * dr_dx,
            molecular_per_m=column(node.molecular_per_m) * dr_dx,
            particle_per_m=column(node.particle_per_m) * dr_dx,
            layer_per_m=layer_columns(node.layer_per_m),
            asymmetry=column(node.asymmetry),
            source=column(node.source),
        )
        for node in model.nodes
    )
    # Whole micrometres: lengths are constants of the kernels, their last bits would make every frame compile its own.
    rise_at_ground = round(float(excess(0.0)) * radius, 6)
    # above the top the air goes on shining but no longer bends
    glow = np.minimum(model.glow_altitude_m, z[-1])
    glow = np.round(np.where(glow > 0.0, apparent(glow), 0.0) + model.glow_altitude_m - glow, 6)
    return ApparentRadiusAir(
        model=replace(
            model,
            altitude_m=apparent_height,
            top_m=float(apparent_height[-1]),
            nodes=straight,
            refractivity=None,
            glow_altitude_m=glow,
            layers=tuple((float(apparent(np.array(a))), float(apparent(np.array(b)))) for a, b in model.layers),
        ),
        planet=Planet(planet.a_m + rise_at_ground, planet.b_m + rise_at_ground),
        bending_per_m=-excess(true_height, 1) / (1.0 + excess(true_height)) * dr_dx,
        height_m=true_height,
        dr_dx=dr_dx,
        altitude_m=fine,
        rise_m=excess(fine) * (radius + fine),
        true_model=model,
        true_planet=planet,
    )
