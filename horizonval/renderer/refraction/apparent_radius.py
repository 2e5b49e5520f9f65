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

**One scale for all air.** Lines stay straight when all lengths are multiplied by the same number. Apparent radii are
multiplied by ``s = (R + w) / (n(0) R)``, w whole kilometres (2 km for all the Earth's air), so that the apparent planet
and the top of the air are the same whatever the air: they are constants of the kernels, and all scenes share theirs.
Cameras move by that, some 4e-5 of their distance; directions stay.

Approximations: one index for all wavelengths of a model, the mean of its nodes (1 % of the bending at either end of the
visible; 20 m at the ground, 5 m at 10 km); one radius of curvature, the mean (N dR: 10 m at the ground in places of the
Earth's ellipsoid, 3 m at 10 km, less above); geodetic verticals turn with the ray as if the planet were a sphere
(1e-4 rad). Light is bent as by the column below the camera, whatever the air at the limb: no horizontal gradients, no
scintillation. The index starts from 1 at the highest node.
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
from horizonval.renderer.tables import table_of
from horizonval.renderer.types import Vec, constant

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

    Attributes
    ----------
    model : OpticalModel
        Over apparent heights ``s (x - n(0) R)``, coefficients per metre of the straight line.
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
    scale : float
        The s of the module text.
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
