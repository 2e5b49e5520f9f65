"""Maps beside the radiance: what the ray through each pixel's centre meets, where, and under which Sun.

They describe the picture for a reader; the truth that scores an estimator is analytic and never comes from here.
"""

from __future__ import annotations

import math

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from horizonval.frame import Hit
from horizonval.renderer.kernel.clouds import first_cloud
from horizonval.renderer.kernel.frame_geometry import FrameGeometry
from horizonval.renderer.planet import along, dot
from horizonval.renderer.types import Vec


def truth_maps(view: FrameGeometry) -> dict[str, NDArray[np.float32]]:
    """Return the maps of :data:`horizonval.frame.MAP_UNITS`, each of shape (H, W), float32.

    The tangent height of a ray that hits the surface is minus the depth of its chord below it, measured at the point
    of the line nearest to the stretched sphere's centre; within 1e-3 of the depth for the Earth's flattening. Clouds
    appear in ``hit`` and ``distance``; the other maps are those of the bare ellipsoid. Pixels beyond the lens's image
    circle see nothing: ``hit`` is space there, distance and tangent height are infinite, and the Sun is at 180 deg.
    """
    pixel = dr.arange(mi.UInt32, view.width * view.height)
    u, v = view.column_and_row(pixel)
    d = view.rays.direction(u, v)
    mid, half, meets = view.planet.chord(view.origin, d)
    ahead = mid > 0.0
    hits = meets & ahead
    distance = dr.select(hits, mid - half, dr.inf)
    lowest = along(view.origin, d, dr.maximum(mid, 0.0))
    tangent_height, normal = view.planet.height_and_normal(lowest)
    _, ground_normal = view.planet.height_and_normal(along(view.origin, d, dr.select(hits, distance, 0.0)))
    cosine = dr.select(hits, dot(ground_normal, view.sun), dot(normal, view.sun))
    zenith = dr.rad2deg(dr.acos(dr.clip(cosine, -1.0, 1.0)))

    def on_disc(direction: Vec, radius: mi.Float64) -> mi.Bool:
        chord = [a - b for a, b in zip(d, direction, strict=True)]
        return dr.sqrt(chord[0] ** 2 + chord[1] ** 2 + chord[2] ** 2) < radius

    sky = dr.select(tangent_height < view.top_m, mi.Float64(float(Hit.ATMOSPHERE)), 0.0)
    if view.moon is not None:
        sky = dr.select(on_disc(view.moon.disc.direction, view.moon.disc.radius), mi.Float64(float(Hit.MOON)), sky)
    sky = dr.select(on_disc(view.sun, view.sun_radius), mi.Float64(float(Hit.SUN)), sky)
    hit = dr.select(hits, mi.Float64(float(Hit.SURFACE)), sky)
    if view.ground is not None and view.ground.clouds is not None:
        clouded, at = first_cloud(view.ground.clouds, view.planet, view.origin, d, to_ground=hits)
        clouded &= at < distance
        hit = dr.select(clouded, mi.Float64(float(Hit.CLOUD)), hit)
        distance = dr.select(clouded, at, distance)
    shape = (view.height, view.width)
    maps = {"distance": distance, "tangent_height": tangent_height, "solar_zenith": zenith, "hit": hit}
    if view.rays.circle is not None:
        lit, nothing = view.rays.sees(u, v), {"hit": float(Hit.SPACE), "solar_zenith": 180.0}
        maps = {name: dr.select(lit, value, nothing.get(name, math.inf)) for name, value in maps.items()}
    dr.eval(maps)
    return {name: np.array(value, dtype=np.float32).reshape(shape) for name, value in maps.items()}
