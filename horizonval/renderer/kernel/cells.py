"""Which cells of a frame see ground, limb or Sun, and the rays through them.

Pixels that contain an edge are cut into k x k cells. A cell whose outline test is clear is one ray through its centre.
A cell on the hard edge is two: one through the middle of its covered part, which ends at the ground, and one through
the middle of the rest. Where the outline of clouds cuts what lies above the limb, that is two as well
(``cloud_outline``). A whole pixel is one ray. Rays above the atmosphere are not marched.

Cells and whole pixels are grouped by what they see before any radiance is computed: every sum has a fixed order.
Both have slots in one array: first the cells, those of a pixel side by side, then the whole pixels.

**Whole pixels.** A pixel is cut where anything in it has an edge or bends: near the limb, in the air above it, at the
discs of Sun and Moon, under clouds, at a border between kinds of ground, and where it is large against gaps in thin
cloud. A pixel of even ground is one ray: where radiance changes over an angle s, the mean of 2 x 2 cells differs from
the value at the centre by :math:`(p/s)^2/32` for pixels of angle p, which is 5e-5 for :data:`EVEN_PIXELS` pixels to s.
The scales are the angle from the limb, the width of the particles' phase function (:data:`PHASE_RAD`) and of the glint
(:data:`GLINT_RAD`), and on the ground a sixth of the cosine of the light's zenith angle; in twilight the angle over
which the Earth's shadow rises by a scale height (:data:`TWILIGHT_RAD`), beyond which there is no light (:data:`NIGHT`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import drjit as dr
import mitsuba as mi

from horizonval.renderer.kernel.cloud_outline import near_clouds, outline_cells, outlined_clouds
from horizonval.renderer.kernel.clouds import CloudTable
from horizonval.renderer.kernel.discs import SPLIT_HEIGHT_M, Disc, DiscCells, cell_coverage, disc_cells
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, limb_function
from horizonval.renderer.kernel.surface import GroundTable, Places, look_alike
from horizonval.renderer.planet import along, distance_squared, dot
from horizonval.renderer.refraction import ray_end, true_direction
from horizonval.renderer.types import Vec, constant, indices_where, joined, numbers_from

EVEN_PIXELS = 25.0
"""Pixels to the angle over which light changes, for a pixel to be whole."""
PHASE_RAD = 0.2
"""Over which the light that particles scatter changes near the forward direction."""
GLINT_RAD = 0.08
"""Width of the Sun's glint on a calm sea."""
TWILIGHT_RAD = 0.005
"""Half of what a scale height of the shadow takes in the middle of twilight: the ground's terminator is sharper."""
GAP_PIXELS = 1.0 / 15.0
"""Largest pixel on the ground that is not cut, of the scale of gaps in thin cloud."""
NIGHT = -0.33
"""Cosine of the zenith angle of a light that has gone down for good."""


@dataclass(frozen=True)
class PixelKinds:
    """Pixels of a frame by treatment, each rising; pixels that see nothing are in none.

    ``cut``: into cells; ``ground``: whole; ``space``: whole, above the air.
    """

    cut: mi.UInt32
    ground: mi.UInt32
    space: mi.UInt32


_CUT, _WHOLE_GROUND, _WHOLE_SPACE, _DARK = range(4)


def sort_pixels(view: FrameGeometry) -> PixelKinds:
    """Sort the pixels of a frame."""
    pixel = dr.arange(mi.UInt32, view.width * view.height)
    if view.every_cell or view.subsamples == 1:
        none = mi.UInt32()
        return PixelKinds(pixel, none, none)
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
    for gaps in view.gap_maps:
        if gaps is not None:
            even &= size * view.planet.a_m < GAP_PIXELS * gaps.scale_m
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
    """Return whether rays through pixels' and cells' centres end on several kinds of ground or near a border."""
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


WHOLE = 1e-9
"""Rounding of a cell's covered share: within it of 0 or 1 the outline does not cut the cell."""


@dataclass(frozen=True)
class Rays:
    """Directions of a group of rays, the slot that each belongs to, and the share of it that each fills."""

    slot: mi.UInt32
    direction: Vec
    share: mi.Float64
    count: int


@dataclass(frozen=True)
class Cells:
    """All slots of a frame, grouped. ``space``: slots that see neither Earth nor air.

    The last rays of ``ground`` are those of whole pixels. ``second``: the cells with two rays in ``limb``, one that
    ends on a cloud and one above it; the second ray has a separate slot behind all others.
    """

    view: FrameGeometry
    kinds: PixelKinds
    ground: Rays
    limb: Rays
    space: mi.UInt32
    sun: DiscCells | None
    moon: DiscCells | None
    second: mi.UInt32 | None = None

    @property
    def count(self) -> int:
        """Slots."""
        return self._first_second + (0 if self.second is None else int(dr.width(self.second)))

    @property
    def _first_second(self) -> int:
        kinds = self.kinds
        return _cell_count(self.view, kinds) + int(dr.width(kinds.ground) + dr.width(kinds.space))

    def image(self, values: mi.Float64) -> mi.Float64:
        """Return pixels in row order from the values of all slots; a pixel that was cut is the mean of its cells."""
        k2, kinds = self.view.subsamples**2, self.kinds
        if self.second is not None:
            first, more = self._first_second, dr.width(self.second)
            added = dr.gather(mi.Float64, values, numbers_from(first, more))
            values = dr.gather(mi.Float64, values, dr.arange(mi.UInt32, first))
            dr.scatter_add(values, added, self.second, mode=dr.ReduceMode.NoConflicts)
        image = dr.zeros(mi.Float64, self.view.width * self.view.height)
        first = _cell_count(self.view, kinds)
        if first:
            cells = dr.gather(mi.Float64, values, dr.arange(mi.UInt32, first))
            dr.scatter(image, dr.block_sum(cells, k2) / k2, kinds.cut)
        for pixel in (kinds.ground, kinds.space):
            if dr.width(pixel):
                dr.scatter(image, dr.gather(mi.Float64, values, numbers_from(first, dr.width(pixel))), pixel)
                first += dr.width(pixel)
        return image


def _cell_count(view: FrameGeometry, kinds: PixelKinds) -> int:
    return int(dr.width(kinds.cut)) * view.subsamples**2


@dataclass(frozen=True)
class CutPixels:
    """The pixels that are cut, and where their cells lie."""

    view: FrameGeometry
    kinds: PixelKinds

    def pixel(self, cell: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
        """Return (column, row) of the pixels of cells."""
        pixel = dr.gather(mi.UInt32, self.kinds.cut, cell // self.view.subsamples**2)
        return self.view.column_and_row(pixel)

    def centre(self, cell: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
        """Return pixel coordinates (column, row) of cells' centres."""
        k = self.view.subsamples
        sub, (column, row) = cell % (k * k), self.pixel(cell)
        u = column + (mi.Float64(sub % k) + 0.5) / k - 0.5
        v = row + (mi.Float64(sub // k) + 0.5) / k - 0.5
        return u, v

    def rays(self, cell: mi.UInt32) -> Rays:
        """Return rays through the centres of cells."""
        return _through(self.view, cell, lambda: self.centre(cell))


_NOTHING, _SPACE, _LIMB, _GROUND, _EDGE = range(5)


def group_cells(view: FrameGeometry, outlines: bool = True) -> Cells:
    """Return what every pixel and cell sees.

    Without ``outlines`` of clouds one ray decides for a cell above the limb.
    """
    kinds = sort_pixels(view)
    count, cut = _cell_count(view, kinds), CutPixels(view, kinds)
    whole_slots = numbers_from(count, dr.width(kinds.ground))
    whole = _through(view, whole_slots, lambda: view.column_and_row(kinds.ground))
    whole_space = numbers_from(count + dr.width(kinds.ground), dr.width(kinds.space))
    if not count:
        return Cells(view, kinds, _joined([whole]), _no_rays(mi.UInt32()), whole_space, None, None)
    cell = dr.arange(mi.UInt32, count)
    centre, reach = centre_and_reach(view, *cut.centre(cell), 0.5 / view.subsamples)
    depth = limb_function(view, centre)
    meets_air = view.planet.miss_distance(view.origin, centre, view.highest_m) < 1.0
    ahead = dot(view.origin, centre) < 0.0
    inside_air = dot(view.origin, view.origin) < (view.planet.a_m + view.highest_m) ** 2
    sees = dr.select((meets_air & ahead) | inside_air, mi.UInt32(_LIMB), _SPACE)
    sees = dr.select(depth > 0.0, _GROUND, sees)
    sees = dr.select(dr.abs(depth) >= reach, sees, _EDGE)
    lit: mi.Bool | None = None
    if view.rays.circle is not None:
        # a pixel beyond the lens's image circle sees nothing, by its centre, as geometry.camera has it
        lit = view.rays.sees(*cut.pixel(cell))
        sees = dr.select(lit, sees, _NOTHING)
    discs = [sun_disc(view)] if view.moon is None else [sun_disc(view), view.moon.disc]
    near = [near_disc(view, disc, centre, reach) for disc in discs]
    dr.eval(sees, near)
    ground = [cut.rays(indices_where(sees == _GROUND))]
    clouds = outlined_clouds(view) if outlines else None
    second = _SecondRays(count + dr.width(kinds.ground) + dr.width(kinds.space))
    above = sees == _LIMB
    below_tops = None if clouds is None else above & near_clouds(view, clouds, centre, reach)
    limb = [cut.rays(indices_where(above if below_tops is None else above & ~below_tops))]
    if clouds is not None and below_tops is not None:
        limb += second.of(view, clouds, cut, indices_where(below_tops))
    space = joined([indices_where(sees == _SPACE), whole_space])
    edge_cells = indices_where(sees == _EDGE)
    if dr.width(edge_cells):
        inner, outer = _edge_cells(view, cut, edge_cells)
        ground.append(inner)
        limb += [outer] if clouds is None else second.of(view, clouds, cut, outer.slot, outer)
    ground.append(whole)
    seen = [indices_where(touching & (sees != _NOTHING)) for touching in near]
    split = [_disc_cells(view, cut, disc, cells) for disc, cells in zip(discs, seen, strict=True)]
    moon = None if view.moon is None else split[1]
    return Cells(view, kinds, _joined(ground), _joined(limb), space, split[0], moon, second.cells())


class _SecondRays:
    """The second rays of cells that the outline of clouds cuts, and the slots that they get."""

    def __init__(self, first_slot: int) -> None:
        self._first_slot = first_slot
        self._cells: list[mi.UInt32] = []

    def cells(self) -> mi.UInt32 | None:
        """Return the cells with two rays, None without any."""
        return joined(self._cells) if self._cells else None

    def of(
        self, view: FrameGeometry, clouds: CloudTable, cut: CutPixels, cell: mi.UInt32, whole: Rays | None = None
    ) -> list[Rays]:
        """Return the rays of cells above the limb, or of the parts above it of cells on the hard edge.

        ``whole``: the rays of these parts if no cloud cuts them; by default the cells' centres.
        """
        if not dr.width(cell):
            return []
        if whole is None:
            whole = cut.rays(cell)
        seen = outline_cells(view, clouds, *cut.centre(cell), 1.0 - whole.share)
        cloudy, free = seen.cloud > 0.0, seen.free > 0.0
        mixed = indices_where(cloudy & free)
        rays = [_picked(whole, indices_where(~(cloudy & free)))]
        if dr.width(mixed):
            above = Rays(whole.slot, seen.to_free, seen.free, whole.count)
            on_clouds = Rays(whole.slot, seen.to_cloud, seen.cloud, whole.count)
            below = _picked(on_clouds, mixed)
            slot = numbers_from(self._first_slot, below.count)
            self._first_slot += below.count
            self._cells.append(below.slot)
            rays += [_picked(above, mixed), replace(below, slot=slot)]
        return rays


def _picked(rays: Rays, index: mi.UInt32) -> Rays:
    """Return some of a group of rays."""
    if not dr.width(index):
        return _no_rays(index)
    x, y, z, share = (dr.gather(mi.Float64, c, index) for c in (*rays.direction, rays.share))
    return Rays(dr.gather(mi.UInt32, rays.slot, index), (x, y, z), share, dr.width(index))


def _through(view: FrameGeometry, slot: mi.UInt32, at: Callable[[], tuple[mi.Float64, mi.Float64]]) -> Rays:
    """Return rays that fill their slots, through pixel coordinates."""
    n = dr.width(slot)
    return Rays(slot, view.rays.direction(*at()), dr.ones(mi.Float64, n), n) if n else _no_rays(slot)


@dataclass(frozen=True)
class EdgeGeometry:
    """Cells on the limb: covered share, and directions through the middles of the covered and of the free part."""

    share: mi.Float64
    inner: Vec
    outer: Vec


def edge_geometry(view: FrameGeometry, u: mi.Float64, v: mi.Float64) -> EdgeGeometry:
    """Return what cells on the limb see; ``u``, ``v``: pixel coordinates of their centres."""
    size = 1.0 / view.subsamples

    def limb(x: mi.Float64, y: mi.Float64) -> mi.Float64:
        return limb_function(view, view.rays.direction(x, y))

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

    inner, outer = through(0.5 * size * share, share > 1.0 - WHOLE), through(-0.5 * size * (1.0 - share), share < WHOLE)
    dr.eval(inner, outer)
    return EdgeGeometry(share, inner, outer)


def _edge_cells(view: FrameGeometry, cut: CutPixels, edge: mi.UInt32) -> tuple[Rays, Rays]:
    """Return rays of cells on the limb, through the covered parts and through the free parts."""
    cells, count = edge_geometry(view, *cut.centre(edge)), dr.width(edge)
    parts = (cells.share, cells.inner), (1.0 - cells.share, cells.outer)
    inner, outer = (_picked(Rays(edge, d, part, count), indices_where(part > 0.0)) for part, d in parts)
    return inner, outer


def _no_rays(index: mi.UInt32) -> Rays:
    """Return rays of no cells."""
    none = mi.Float64()
    return Rays(index, (none, none, none), none, 0)


def _joined(groups: list[Rays]) -> Rays:
    """Return several groups as one, its directions found once for all that looks along them."""
    filled = [g for g in groups if g.count]
    rays = filled[0] if filled else groups[0]
    if len(filled) > 1:
        x, y, z = (joined([g.direction[k] for g in filled]) for k in range(3))
        slot, share = joined([g.slot for g in filled]), joined([g.share for g in filled])
        rays = Rays(slot, (x, y, z), share, sum(g.count for g in filled))
    dr.eval(rays.slot, rays.direction, rays.share)
    return rays


def _disc_cells(view: FrameGeometry, cut: CutPixels, disc: Disc, near: mi.UInt32) -> DiscCells | None:
    """Return the cells near a disc, split as it needs; None where it is outside the frame.

    Refraction moves the disc.
    """

    def refracted(x: mi.Float64, y: mi.Float64) -> Vec:
        assert view.bending is not None
        return true_direction(view.bending, view.origin, view.rays.direction(x, y))

    def limb(x: mi.Float64, y: mi.Float64) -> mi.Float64:
        return limb_function(view, view.rays.direction(x, y))

    if not dr.width(near):
        return None
    return disc_cells(
        disc,
        near,
        cut.centre(near),
        cut.pixel(near),
        view.subsamples,
        view.rays.direction,
        limb,
        _height_at_limb_rad(view, disc),
        None if view.bending is None else refracted,
    )


def _height_at_limb_rad(view: FrameGeometry, disc: Disc) -> float | None:
    """Return the angle of :data:`SPLIT_HEIGHT_M` at the limb, or None for a disc clear of air and ground."""
    toward, distance2 = float(dot(view.origin, disc.direction)[0]), float(dot(view.origin, view.origin)[0])
    miss = math.sqrt(max(distance2 - toward * toward, 0.0))
    radius = float(disc.radius[0])
    if toward > 0.0 or miss - radius * abs(toward) > view.planet.a_m + view.top_m:
        return None
    return SPLIT_HEIGHT_M / max(math.sqrt(max(distance2 - view.planet.b_m**2, 0.0)), SPLIT_HEIGHT_M)
