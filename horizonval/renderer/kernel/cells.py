"""Which cells of a frame see ground, limb or Sun, and the rays through them.

A pixel is cut into k x k cells. A cell whose outline test is clear is one ray through its centre. A cell on the hard
edge is two: one through the middle of its covered part, ending at the ground, one through the middle of the rest,
passing it (see ``coverage``). Rays above the atmosphere are not marched at all. Cells are grouped by what they see
before the march, so no lane idles and every cell's sum has a fixed order: the same bytes for any number of threads.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.coverage import cell_coverage
from horizonval.renderer.kernel.discs import SPLIT_HEIGHT_M, Direction, Disc, DiscCells, disc_cells
from horizonval.renderer.kernel.rays import RayCamera
from horizonval.renderer.kernel.surface import Ground
from horizonval.renderer.planet import Planet, distance_squared, dot
from horizonval.renderer.refraction.bending import BendingField, true_direction
from horizonval.renderer.types import Vec, indices_where

WHOLE = 1e-9
"""Rounding of a cell's covered share: within it of 0 or 1 the outline does not cut the cell."""


@dataclass(frozen=True)
class MoonInFrame:
    """The Moon of a frame.

    Attributes
    ----------
    disc : Disc
        As the camera sees it.
    nearness : float
        Irradiance at the camera over that at the Earth's centre.
    light : Vec
        Unit vector from the Earth's centre to the Moon: where moonlight comes from.
    lights_earth : bool
        Whether ground and air are to be seen in its light.
    """

    disc: Disc
    nearness: float
    light: Vec
    lights_earth: bool


@dataclass(frozen=True)
class FrameGeometry:
    """Everything geometric about one frame. ``origin`` and ``sun`` hold size-1 arrays.

    ``ground`` is None for a Lambert ground without clouds.
    ``sunless``: all air and ground in view lie in the Earth's shadow. ``glow_top_m``: nothing shines above; at least
    ``top_m``.
    With refraction ``planet``, ``top_m`` and ``origin`` are apparent ones, among which light goes straight, and
    ``bending`` tells by how much it bends.
    """

    rays: RayCamera
    width: int
    height: int
    origin: Vec
    sun: Vec
    sun_radius: mi.Float64
    planet: Planet
    top_m: float
    subsamples: int
    ground: Ground | None = None
    moon: MoonInFrame | None = None
    sunless: bool = False
    glow_top_m: float = 0.0
    bending: BendingField | None = None

    @property
    def highest_m(self) -> float:
        """Rays that stay above see space alone."""
        return max(self.top_m, self.glow_top_m)


@dataclass(frozen=True)
class Rays:
    """Directions of a group of cells, and which cell each belongs to."""

    cell: mi.UInt32
    direction: Vec
    count: int


@dataclass(frozen=True)
class Cells:
    """All cells of a frame, grouped. ``share``: covered by the Earth; ``space``: cells that see neither it nor air."""

    count: int
    share: mi.Float64
    ground: Rays
    limb: Rays
    space: mi.UInt32
    sun: DiscCells | None
    moon: DiscCells | None


def cell_centre(view: FrameGeometry, cell: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
    """Return pixel coordinates (column, row) of cell centres; the cells of a pixel are neighbours in memory."""
    k = view.subsamples
    pixel, sub = cell // (k * k), cell % (k * k)
    u = mi.Float64(pixel % view.width) + (mi.Float64(sub % k) + 0.5) / k - 0.5
    v = mi.Float64(pixel // view.width) + (mi.Float64(sub // k) + 0.5) / k - 0.5
    return u, v


def group_cells(view: FrameGeometry) -> Cells:
    """Find out what every cell sees."""
    count = view.width * view.height * view.subsamples**2
    half = 0.5 / view.subsamples
    cell = dr.arange(mi.UInt32, count)
    u, v = cell_centre(view, cell)
    centre = view.rays.direction(u, v)
    diagonals = [view.rays.direction(u + half, v + half), view.rays.direction(u + half, v - half)]
    reach = 2.0 * dr.sqrt(dr.maximum(*(distance_squared(centre, d) for d in diagonals)))
    depth = _limb_function(view, centre)
    share = dr.select(depth > 0.0, mi.Float64(1.0), 0.0)
    clear = dr.abs(depth) >= reach
    edge = ~clear
    lit: mi.Bool | None = None
    if view.rays.circle is not None:
        # a pixel beyond the lens's image circle sees nothing, by its centre, as geometry.camera has it
        pixel = cell // view.subsamples**2
        lit = view.rays.sees(mi.Float64(pixel % view.width), mi.Float64(pixel // view.width))
        share = dr.select(lit, share, 0.0)
        clear, edge = clear & lit, edge & lit
    meets_air = view.planet.miss_distance(view.origin, centre, view.highest_m) < 1.0
    ahead = dot(view.origin, centre) < 0.0
    inside_air = dot(view.origin, view.origin) < (view.planet.a_m + view.highest_m) ** 2
    ground = [_through_centres(view, indices_where(clear & (depth > 0.0)))]
    in_air = (meets_air & ahead) | inside_air
    limb = [_through_centres(view, indices_where(clear & (depth <= 0.0) & in_air))]
    space = indices_where(clear & (depth <= 0.0) & ~in_air)
    edge_cells = indices_where(edge)
    if dr.width(edge_cells):
        edge_share, inner, outer = _edge_cells(view, edge_cells)
        dr.scatter(share, edge_share, edge_cells)
        ground.append(inner)
        limb.append(outer)
    dr.eval(share)
    sun = _disc_cells(view, Disc(view.sun, view.sun_radius), centre, reach, lit)
    moon = None if view.moon is None else _disc_cells(view, view.moon.disc, centre, reach, lit)
    return Cells(count, share, _joined(ground), _joined(limb), space, sun, moon)


@dataclass(frozen=True)
class EdgeGeometry:
    """Cells on the limb: covered share, and directions through the middles of the covered and of the free part."""

    share: mi.Float64
    inner: Vec
    outer: Vec


def edge_geometry(view: FrameGeometry, edge: mi.UInt32) -> EdgeGeometry:
    """Return what cells on the limb see."""
    size = 1.0 / view.subsamples

    def limb(x: mi.Float64, y: mi.Float64) -> mi.Float64:
        return _limb_function(view, view.rays.direction(x, y))

    u, v = cell_centre(view, edge)
    share, du, dv = cell_coverage(limb, u, v, size)
    # signed distance of the cell's centre from the outline along the gradient, in pixels
    step = 0.25 * size
    slope = (limb(u + step * du, v + step * dv) - limb(u - step * du, v - step * dv)) / (2.0 * step)
    offset = limb(u, v) / dr.maximum(slope, 1e-300)
    dr.eval(share, du, dv, offset)

    def through(depth: mi.Float64, whole: mi.Bool) -> Vec:
        """Directions, unless cells are ``whole`` through points ``depth`` pixels inside the outline."""
        shift: mi.Float64 = dr.clip(depth - offset, -2.0 * size, 2.0 * size)
        shift = dr.select(whole, 0.0, shift)
        return view.rays.direction(u + shift * du, v + shift * dv)

    inner = through(0.5 * size * share, share > 1.0 - WHOLE)
    return EdgeGeometry(share, inner, through(-0.5 * size * (1.0 - share), share < WHOLE))


def _edge_cells(view: FrameGeometry, edge: mi.UInt32) -> tuple[mi.Float64, Rays, Rays]:
    """Return the covered share of cells on the limb, rays through the covered parts and through the free parts."""
    cells = edge_geometry(view, edge)
    dr.eval(cells.inner, cells.outer)

    def of(index: mi.UInt32, direction: Vec) -> Rays:
        if not dr.width(index):
            return _no_rays(index)
        x, y, z = (dr.gather(mi.Float64, c, index) for c in direction)
        return Rays(dr.gather(mi.UInt32, edge, index), (x, y, z), dr.width(index))

    inner = of(indices_where(cells.share > 0.0), cells.inner)
    return cells.share, inner, of(indices_where(cells.share < 1.0), cells.outer)


def _limb_function(view: FrameGeometry, d: Vec) -> mi.Float64:
    """Return a smooth function of directions, positive inside the Earth, close to the angle from the limb [rad]."""
    planet = view.planet
    o1 = planet.stretch(view.origin)
    distance2 = dr.maximum(dot(o1, o1), planet.a_m**2 * (1.0 + 1e-12))
    per_radian = dr.sqrt(distance2 - planet.a_m**2) / planet.a_m
    f = (1.0 - planet.miss_distance(view.origin, d)) / per_radian
    # the line's other half: behind the camera there is no Earth
    return dr.select(dot(o1, planet.stretch(d)) < 0.0, f, -1.0)


def _no_rays(index: mi.UInt32) -> Rays:
    """Return rays of no cells."""
    none = mi.Float64()
    return Rays(index, (none, none, none), 0)


def _through_centres(view: FrameGeometry, index: mi.UInt32) -> Rays:
    if not dr.width(index):
        return _no_rays(index)
    return Rays(index, view.rays.direction(*cell_centre(view, index)), dr.width(index))


def _joined(groups: list[Rays]) -> Rays:
    filled = [g for g in groups if g.count]
    if len(filled) < 2:
        return filled[0] if filled else groups[0]
    x, y, z = (dr.concat([g.direction[k] for g in filled]) for k in range(3))
    return Rays(dr.concat([g.cell for g in filled]), (x, y, z), sum(g.count for g in filled))


def _disc_cells(
    view: FrameGeometry, disc: Disc, centre: Vec, reach: mi.Float64, lit: mi.Bool | None
) -> DiscCells | None:
    """Return the cells near a disc, split as it needs; None where it is outside the frame. ``lit``: cells to look at.

    With refraction the disc stands where the rays point that have left the air behind.
    """

    def refracted(x: mi.Float64, y: mi.Float64) -> Vec:
        assert view.bending is not None
        return true_direction(view.bending, view.origin, view.rays.direction(x, y))

    lift = 0.0
    through: Direction | None = None
    if view.bending is not None:
        lift = view.bending.largest_angle()
        through = refracted

    touching = dr.sqrt(distance_squared(centre, disc.direction)) < disc.radius + reach + lift
    near = indices_where(touching if lit is None else touching & lit)
    if not dr.width(near):
        return None
    k = view.subsamples
    pixel = near // (k * k)

    def limb(x: mi.Float64, y: mi.Float64) -> mi.Float64:
        return _limb_function(view, view.rays.direction(x, y))

    return disc_cells(
        disc,
        near,
        cell_centre(view, near),
        (mi.Float64(pixel % view.width), mi.Float64(pixel // view.width)),
        k,
        view.rays.direction,
        limb,
        _height_at_limb_rad(view, disc),
        through,
    )


def _height_at_limb_rad(view: FrameGeometry, disc: Disc) -> float | None:
    """Return the angle of :data:`SPLIT_HEIGHT_M` at the limb, or None for a disc clear of air and ground."""
    toward, distance2 = float(dot(view.origin, disc.direction)[0]), float(dot(view.origin, view.origin)[0])
    miss = math.sqrt(max(distance2 - toward * toward, 0.0))
    radius = float(disc.radius[0])
    if toward > 0.0 or miss - radius * abs(toward) > view.planet.a_m + view.top_m:
        return None
    return SPLIT_HEIGHT_M / max(math.sqrt(max(distance2 - view.planet.b_m**2, 0.0)), SPLIT_HEIGHT_M)
