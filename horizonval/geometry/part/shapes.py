"""Simple shapes as triangles, in their own axes.

A circle is a polygon of 512 corners and of the circle's area: with ``theta = pi / 512`` its corners lie
``theta^2 / 3`` of the radius outside (1.3e-5) and the middles of its sides half as far inside. A circle 1000 pixels
across is right to a hundredth of a pixel.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.geometry.directions import tangent_basis
from horizonval.spec.scene import SpacecraftPart

CORNERS = 512


def panel(width_m: float, height_m: float) -> FloatArray:
    """Return a rectangle across z, shape (2, 3, 3)."""
    x, y = 0.5 * width_m, 0.5 * height_m
    corner = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    return corner[[[0, 1, 2], [0, 2, 3]]]


def disc(radius_m: float) -> FloatArray:
    """Return a circle across z, shape (n, 3, 3)."""
    return _fan(_circle(radius_m))


def tube(radius_m: float, end_radius_m: float, length_m: float) -> FloatArray:
    """Return an open tube or cone round z from z = 0, shape (n, 3, 3)."""
    near, far = _circle(radius_m), _circle(end_radius_m)
    far[:, 2] = length_m
    next_near, next_far = np.roll(near, -1, axis=0), np.roll(far, -1, axis=0)
    lower, upper = np.stack([near, next_near, next_far], axis=1), np.stack([near, next_far, far], axis=1)
    return np.concatenate([lower, upper])


def boom(radius_m: float, from_m: FloatArray, to_m: FloatArray) -> FloatArray:
    """Return a closed cylinder between two points, shape (n, 3, 3)."""
    axis = to_m - from_m
    length = float(np.linalg.norm(axis))
    axis = axis / length
    ends = _circle(radius_m)
    upright = np.concatenate(
        [tube(radius_m, radius_m, length), _fan(ends)[:, ::-1], _fan(ends + np.array([0.0, 0.0, length]))]
    )
    turned = upright @ np.column_stack([tangent_basis(axis), axis]).T
    return np.asarray(turned + from_m)


def shape_triangles(part: SpacecraftPart) -> FloatArray:
    """Return the triangles of a part that is no mesh, in its own axes [m], shape (n, 3, 3)."""
    if part.shape == "panel":
        assert part.width_m is not None
        assert part.height_m is not None
        return panel(part.width_m, part.height_m)
    assert part.radius_m is not None
    if part.shape == "disc":
        return disc(part.radius_m)
    if part.shape == "baffle":
        assert part.length_m is not None
        return tube(part.radius_m, part.end_radius_m or part.radius_m, part.length_m)
    assert part.from_m is not None
    assert part.to_m is not None
    return boom(part.radius_m, np.array(part.from_m), np.array(part.to_m))


def _circle(radius_m: float) -> FloatArray:
    """Return the corners of a circle's polygon across z, shape (n, 3)."""
    step = math.tau / CORNERS
    angle = np.arange(CORNERS) * step
    radius = radius_m * math.sqrt(step / math.sin(step))
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(CORNERS)])


def _fan(ring: FloatArray) -> FloatArray:
    centre = np.broadcast_to(ring.mean(axis=0), ring.shape)
    return np.stack([centre, ring, np.roll(ring, -1, axis=0)], axis=1)
