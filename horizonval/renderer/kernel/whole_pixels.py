r"""Which pixels of a frame one ray serves, and which are cut into cells.

A pixel is cut where anything in it has an edge or bends: near the limb and in the air above it, where the light changes
over the scale height of the air, at the discs of Sun and Moon. A pixel of space needs no ray at all. A pixel of even
ground is one ray through its centre: where the light changes over an angle s, the mean of 2 x 2 cells differs from the
value at the centre by :math:`(p/s)^2/32` for pixels of angle p, which is 5e-5 for :data:`EVEN_PIXELS` pixels to s. The
scales are

- the angle from the limb, in powers of which a grazing ray's way through the air changes,
- the width of the particles' phase function (:data:`PHASE_RAD`) and of the glint (:data:`GLINT_RAD`),
- on the ground a sixth of the cosine of the light's zenith angle, and in twilight the angle over which the Earth's
  shadow rises by a scale height (:data:`TWILIGHT_RAD`); beyond twilight there is no light (:data:`NIGHT`).

Where the ground's own terminator, a coast, the edge of snow or ice or a border between kinds of ground runs through a
pixel, it is cut, too, and so is all that lies under clouds.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.ground.cover import GroundTable, Places, look_alike
from horizonval.renderer.kernel.discs import Disc
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, limb_function
from horizonval.renderer.planet import along, distance_squared, dot
from horizonval.renderer.refraction.ray_end import ray_end
from horizonval.renderer.types import Vec, constant, indices_where

EVEN_PIXELS = 25.0
"""Pixels to the angle over which light changes, for a pixel to be whole."""
PHASE_RAD = 0.2
"""Over which the light that particles scatter changes near the forward direction."""
GLINT_RAD = 0.08
"""Width of the Sun's glint on a calm sea."""
TWILIGHT_RAD = 0.005
"""Half of what a scale height of the shadow takes in the middle of twilight: the ground's terminator is sharper."""
NIGHT = -0.33
"""Cosine of the zenith angle of a light that has gone down for good."""


@dataclass(frozen=True)
class PixelKinds:
    """Pixels of a frame by what is to be done with them, each rising. Pixels that see nothing are in none.

    ``cut``: into cells; ``ground``: whole; ``space``: whole, above the air. ``all_cut``: nothing else is in the frame.
    """

    cut: mi.UInt32
    ground: mi.UInt32
    space: mi.UInt32
    all_cut: bool = False


_CUT, _WHOLE_GROUND, _WHOLE_SPACE, _DARK = range(4)


def sort_pixels(view: FrameGeometry) -> PixelKinds:
    """Sort the pixels of a frame."""
    pixel = dr.arange(mi.UInt32, view.width * view.height)
    if view.every_cell or view.subsamples == 1:
        none = mi.UInt32()
        return PixelKinds(pixel, none, none, all_cut=True)
    u, v = view.column_and_row(pixel)
    centre, reach = centre_and_reach(view, u, v, 0.5)
    touched = near_disc(view, sun_disc(view), centre, reach)
    if view.moon is not None:
        touched |= near_disc(view, view.moon.disc, centre, reach)
    kind = dr.select(_even_ground(view, centre, reach), mi.UInt32(_WHOLE_GROUND), _CUT)
    kind = dr.select(_above_air(view, centre, reach), _WHOLE_SPACE, kind)
    kind = dr.select(touched, _CUT, kind)
    if view.rays.circle is not None:
        kind = dr.select(view.rays.sees(u, v), kind, _DARK)
    dr.eval(kind)
    if view.ground is not None and view.ground.table is not None:
        candidates = indices_where(kind == _WHOLE_GROUND)
        if dr.width(candidates):
            coasts = indices_where(_coast(view, view.ground.table, candidates))
            if dr.width(coasts):
                dr.scatter(kind, mi.UInt32(_CUT), dr.gather(mi.UInt32, candidates, coasts))
    cut, ground, space = (indices_where(kind == k) for k in (_CUT, _WHOLE_GROUND, _WHOLE_SPACE))
    return PixelKinds(cut, ground, space)


def centre_and_reach(view: FrameGeometry, u: mi.Float64, v: mi.Float64, half: float) -> tuple[Vec, mi.Float64]:
    """Return directions of squares' centres, and twice the largest chord to their corners; ``half`` an edge [px]."""
    centre = view.rays.direction(u, v)
    diagonals = [view.rays.direction(u + half, v + half), view.rays.direction(u + half, v - half)]
    return centre, 2.0 * dr.sqrt(dr.maximum(*(distance_squared(centre, d) for d in diagonals)))


def sun_disc(view: FrameGeometry) -> Disc:
    """Return the Sun's disc in a frame."""
    return Disc(view.sun, view.sun_radius)


def near_disc(view: FrameGeometry, disc: Disc, centre: Vec, reach: mi.Float64) -> mi.Bool:
    """Return whether squares of a frame may touch a disc, lifted by refraction at most."""
    lift = 0.0 if view.bending is None else constant(view.bending.largest_angle())
    return dr.sqrt(distance_squared(centre, disc.direction)) < disc.radius + reach + lift


def _above_air(view: FrameGeometry, centre: Vec, reach: mi.Float64) -> mi.Bool:
    inside = dot(view.origin, view.origin) < (view.planet.a_m + view.highest_m) ** 2
    return ~inside & (limb_function(view, centre, view.highest_m) < -reach)


def _even_ground(view: FrameGeometry, centre: Vec, reach: mi.Float64) -> mi.Bool:
    if view.ground is not None and view.ground.clouds is not None:
        return dr.full(mi.Bool, False, dr.width(reach))
    needed = reach * (EVEN_PIXELS / dr.sqrt(2.0))
    widest = PHASE_RAD if view.ground is None or view.ground.table is None else GLINT_RAD
    even = needed < dr.minimum(limb_function(view, centre), widest)
    mid, half, _ = view.planet.chord(view.origin, centre)
    # seen from the Earth's centre, along the ray's trace on the ground
    needed *= (mid - half) / dr.maximum(half, 1.0)
    size, lift = needed / EVEN_PIXELS, 0.0 if view.bending is None else constant(view.bending.largest_angle())
    point = along(view.origin, centre, mid - half)
    lights = [view.sun]
    if view.moon is not None and view.moon.lights_earth:
        lights.append(view.moon.light)
    for light in lights:
        cosine = dot(point, light) / view.planet.a_m
        scale: mi.Float64 = dr.maximum(cosine / 6.0, TWILIGHT_RAD)
        scale = dr.select(cosine < NIGHT, PHASE_RAD, scale)
        even &= (needed < scale) & ((cosine > size) | (cosine < -(size + lift)))
    return even


def _coast(view: FrameGeometry, table: GroundTable, pixel: mi.UInt32) -> mi.Bool:
    """Return whether the rays through pixels' centres and through those of their cells end on several kinds of ground,
    or where kinds of ground meet.
    """
    k = view.subsamples
    column, row = mi.Float64(pixel % view.width), mi.Float64(pixel // view.width)

    def kind(u: mi.Float64, v: mi.Float64) -> tuple[mi.UInt32, mi.Bool]:
        d = view.rays.direction(u, v)
        mid, half, _ = view.planet.chord(view.origin, d)
        normal = ray_end(view.planet, view.bending, view.origin, d, mid - half).vertical
        return look_alike(table, Places.below(normal))

    def at_cell(i: mi.UInt32, several: mi.Bool) -> tuple[mi.UInt32, mi.Bool]:
        part = i % k, i // k
        u, v = (c + (mi.Float64(j) + 0.5) / k - 0.5 for c, j in zip((column, row), part, strict=True))
        here, alike = kind(u, v)
        return i + 1, several | ~alike | (here != middle)

    middle, alone = kind(column, row)
    dr.eval(middle, alone)
    start = mi.UInt32(0), ~alone
    return dr.while_loop(start, lambda i, several: i < k * k, at_cell, label="coasts")[1]
