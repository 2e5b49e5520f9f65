r"""Which way a ray's direction goes with a moving camera for the ray to meet about the same.

Radiance L(o, d) changes fast with the direction d, across the limb, and slowly along the ground. So the derivative by
the camera's position o is taken apart::

    dL/do_k = S_k - grad_d L . delta_k,     S_k = derivative of L(o + s e_k, d + s delta_k) by s

with ``delta_k`` the change of direction that keeps both numbers of the ray
(:mod:`horizonval.renderer.kernel.ray_coordinates`): in the stretched space the ray turns with the vertical, and its
nadir angle changes so that its miss distance stays; inside the air, for rays past the Earth, so that its angle from the
limb stays. Then the nadir angle is corrected for the Earth's flattening, so that the geodetic height of the lowest
point stays, or the geodetic elevation at the ground: air that is the same everywhere is seen the same, S_k is nothing
for its emission. For sunlight S_k is about L over the Earth's radius, and smooth: a coarse table holds it.
"""

from __future__ import annotations

import math

import drjit as dr

from horizonval.core.arrays import FloatArray
from horizonval.renderer.derivatives.ray_slopes import slopes
from horizonval.renderer.derivatives.vectors import added, cross, scaled
from horizonval.renderer.planet import Planet, along, dot
from horizonval.renderer.types import Values, Vec, constant_vector, inverse_root


def transport(planet: Planet, o: Vec, d: Vec, step: FloatArray, inside_limb: bool) -> Vec:
    """Return ``delta`` of the module text [1/m] for rays of unit directions.

    Parameters
    ----------
    o : Vec
        The camera, size 1.
    step : ndarray, shape (3,)
        Unit vector of the camera's motion.
    inside_limb : bool
        Whether the camera is inside the air and the rays go past the Earth.
    """
    o1, moved = planet.stretch(o), planet.stretch(constant_vector(step))
    r = dr.sqrt(dot(o1, o1))
    up = scaled(o1, 1.0 / r)
    d1 = planet.stretch(d)
    length = dr.sqrt(dot(d1, d1))
    d1 = scaled(d1, 1.0 / length)
    rise = dot(up, moved) / r
    turning = cross(up, scaled(moved, 1.0 / r))
    cosine = -dot(d1, up)
    sideways = added(d1, scaled(up, cosine))
    sine = dr.sqrt(dot(sideways, sideways))
    if inside_limb:
        limb = float(dr.minimum(planet.a_m / r, 1.0 - 1e-12)[0])
        steepening = -rise * (limb / math.sqrt(1.0 - limb * limb))
        tilt = added(scaled(sideways, steepening * cosine / dr.maximum(sine, 1e-12)), scaled(up, steepening * sine))
    else:
        # away from the Earth nothing is met, and beside the horizontal nothing outside the air
        down = dr.select(cosine > 1e-3, 1.0 / dr.maximum(cosine, 1e-3), 0.0)
        tilt = added(scaled(sideways, -rise), scaled(up, -rise * sine * sine * down))
    change = added(cross(turning, d1), tilt)
    # back from the stretched space, as a change of the unit vector
    back = planet.b_m / planet.a_m
    change = scaled((change[0], change[1], change[2] * back), length)
    return added(change, scaled(d, -dot(change, d)))


def level_transport(planet: Planet, o: Vec, d: Vec, step: FloatArray, to_ground: bool, inside_limb: bool) -> Vec:
    """Return :func:`transport`, corrected for the flattening but for rays from inside the air past the Earth."""
    change = transport(planet, o, d, step, inside_limb)
    if inside_limb:
        return change
    radial = scaled(o, inverse_root(dot(o, o)))
    steeper = added(radial, scaled(d, -dot(radial, d)))

    def level(o: Vec, d: Vec) -> Values:
        mid, half, _ = planet.chord(o, d)
        height, normal = planet.height_and_normal(along(o, d, mid - half if to_ground else mid))
        return [-dot(normal, d) if to_ground else height]

    _, ((moved,), (turned,)) = slopes(level, o, d, [(constant_vector(step), change), (None, steeper)])
    share = dr.select(dr.abs(turned) > 1e-9, moved / turned, 0.0)
    change = added(change, scaled(steeper, -share))
    dr.eval(change)
    return change
