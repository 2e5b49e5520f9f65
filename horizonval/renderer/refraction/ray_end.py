"""Where rays end on the planet as it is, and how they arrive there, with and without refraction."""

from __future__ import annotations

from dataclasses import dataclass

import mitsuba as mi

from horizonval.renderer.planet import Planet, along
from horizonval.renderer.refraction.bending import BendingField
from horizonval.renderer.types import Vec

END_BENDING_NODES = 32
"""Along a ray to its end. Against ten times as many the angle is within 1e-5 rad, 60 m on the ground."""


@dataclass(frozen=True)
class RayEnd:
    """The end of rays.

    Attributes
    ----------
    height_m : Float64
        Geodetic.
    vertical, direction, point : Vec
        Upwards and along the ray, unit vectors; the place, planet-centred [m].
    bending : Float64 or None
        By how much the ray has turned [rad]; None without refraction.
    """

    height_m: mi.Float64
    vertical: Vec
    direction: Vec
    point: Vec
    bending: mi.Float64 | None


def ray_end(
    planet: Planet, bending: BendingField | None, o: Vec, d: Vec, t: mi.Float64, angle: mi.Float64 | None = None
) -> RayEnd:
    """Return where rays end that are cut at parameters ``t``.

    Parameters
    ----------
    planet : Planet
        Among whose rays light goes straight.
    bending : BendingField or None
        None without refraction.
    o, d : Vec
        Origins and unit directions of the straight rays.
    t : Float64
        Inside the air.
    angle : Float64, optional
        By how much the rays have turned there [rad], where that is known.
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
