"""Images: which cells of a frame see ground, limb or Sun, and the radiance of each.

A pixel is cut into k x k cells. A cell whose outline test is clear is one ray through its centre. A cell on the hard
edge is two: one through the middle of its covered part, ending at the ground, one through the middle of the rest,
passing it, mixed by the covered share (see ``coverage``)::

    L_cell = c L_ground + (1 - c) (L_limb + s L_sun T)

with ``s`` the share of the Sun's disc in the cell, dimmed by the transmittance ``T`` of the ray. Rays above the
atmosphere are not marched at all. Cells are grouped by what they see before the march, so no lane idles and every
cell's sum has a fixed order: the same bytes for any number of threads.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi

from horizonval.earth.column import SpectralNode
from horizonval.render.coverage import cell_coverage
from horizonval.render.march import Chunk, march
from horizonval.render.planet import Planet, Vec, dot
from horizonval.render.radiance import SOLAR_CONCENTRATION, THERMAL_CONCENTRATION
from horizonval.render.rays import RayCamera
from horizonval.render.refraction import Turning, true_direction

_NO_DIRECTION: Vec = (None, None, None)


@dataclass(frozen=True)
class View:
    """Everything geometric about one frame. ``origin`` and ``sun`` hold size-1 arrays.

    With refraction ``planet``, ``top_m`` and ``origin`` are those among which light goes straight, and ``turning``
    tells by how much it turned.
    """

    rays: RayCamera
    width: int
    height: int
    origin: Vec
    sun: Vec
    sun_radius: Any
    planet: Planet
    top_m: float
    subsamples: int
    turning: Turning | None = None


@dataclass(frozen=True)
class Rays:
    """Directions of a group of cells, and which cell each belongs to."""

    cell: Any
    direction: Vec
    count: int


@dataclass(frozen=True)
class Cells:
    """All cells of a frame, grouped. ``share``: covered by the Earth; ``sun_share``: of a cell's area, by the Sun."""

    count: int
    share: Any
    ground: Rays
    limb: Rays
    sun: Rays
    sun_share: Any


def cell_centre(view: View, cell: Any) -> tuple[Any, Any]:
    """Return pixel coordinates (column, row) of cell centres; the cells of a pixel are neighbours in memory."""
    k = view.subsamples
    pixel, sub = cell // (k * k), cell % (k * k)
    u = mi.Float64(pixel % view.width) + (mi.Float64(sub % k) + 0.5) / k - 0.5
    v = mi.Float64(pixel // view.width) + (mi.Float64(sub // k) + 0.5) / k - 0.5
    return u, v


def group_cells(view: View) -> Cells:
    """Find out what every cell sees."""
    count = view.width * view.height * view.subsamples**2
    half = 0.5 / view.subsamples
    cell = dr.arange(mi.UInt32, count)
    u, v = cell_centre(view, cell)
    centre = view.rays.direction(u, v)
    diagonals = [view.rays.direction(u + half, v + half), view.rays.direction(u + half, v - half)]
    reach = 2.0 * dr.sqrt(dr.maximum(*(_gap(centre, d) for d in diagonals)))
    depth = _limb_function(view, centre)
    share = dr.select(depth > 0.0, mi.Float64(1.0), 0.0)
    clear = dr.abs(depth) >= reach
    meets_air = view.planet.miss_distance(view.origin, centre, view.top_m) < 1.0
    ahead = dot(view.origin, centre) < 0.0
    inside_air = dot(view.origin, view.origin) < (view.planet.a_m + view.top_m) ** 2
    ground = [_through_centres(view, dr.compress(clear & (depth > 0.0)))]
    limb = [_through_centres(view, dr.compress(clear & (depth <= 0.0) & ((meets_air & ahead) | inside_air)))]
    edge = dr.compress(~clear)
    if dr.width(edge):
        edge_share, inner, outer = _edge_cells(view, edge)
        dr.scatter(share, edge_share, edge)
        ground.append(inner)
        limb.append(outer)
    lift = 0.0 if view.turning is None else view.turning.most()
    near_sun = dr.sqrt(_gap(centre, view.sun)) < view.sun_radius + reach + lift
    sun, sun_share = _sun_cells(view, dr.compress(near_sun))
    dr.eval(share)
    return Cells(count, share, _joined(ground), _joined(limb), sun, sun_share)


def _edge_cells(view: View, edge: Any) -> tuple[Any, Rays, Rays]:
    """Return the covered share of cells on the limb, rays through the covered parts and through the free parts."""
    size = 1.0 / view.subsamples

    def limb(x: Any, y: Any) -> Any:
        return _limb_function(view, view.rays.direction(x, y))

    u, v = cell_centre(view, edge)
    share, du, dv = cell_coverage(limb, u, v, size)
    # signed distance of the cell's centre from the outline along the gradient, in pixels
    step = 0.25 * size
    slope = (limb(u + step * du, v + step * dv) - limb(u - step * du, v - step * dv)) / (2.0 * step)
    offset = limb(u, v) / dr.maximum(slope, 1e-300)
    dr.eval(share, du, dv, offset)

    def through(pick: Any, depth: Any) -> Rays:
        """Rays of the picked cells, moved along the gradient to ``depth`` pixels inside the outline."""
        if not dr.width(pick):
            return Rays(pick, _NO_DIRECTION, 0)
        move = dr.clip(depth - offset, -2.0 * size, 2.0 * size)
        x, y = (dr.gather(mi.Float64, w, pick) for w in (u + move * du, v + move * dv))
        return Rays(dr.gather(mi.UInt32, edge, pick), view.rays.direction(x, y), dr.width(pick))

    inner = through(dr.compress(share > 0.0), 0.5 * size * share)
    outer = through(dr.compress(share < 1.0), -0.5 * size * (1.0 - share))
    return share, inner, outer


def _limb_function(view: View, d: Vec) -> Any:
    """Return a smooth function of directions, positive inside the Earth, close to the angle from the limb [rad]."""
    planet = view.planet
    o1 = planet.stretch(view.origin)
    distance2 = dr.maximum(dot(o1, o1), planet.a_m**2 * (1.0 + 1e-12))
    per_radian = dr.sqrt(distance2 - planet.a_m**2) / planet.a_m
    f = (1.0 - planet.miss_distance(view.origin, d)) / per_radian
    # the line's other half: behind the camera there is no Earth
    return dr.select(dot(o1, planet.stretch(d)) < 0.0, f, -1.0)


def _gap(a: Vec, b: Vec) -> Any:
    x, y, z = a[0] - b[0], a[1] - b[1], a[2] - b[2]
    return x * x + y * y + z * z


def _through_centres(view: View, index: Any) -> Rays:
    if not dr.width(index):
        return Rays(index, _NO_DIRECTION, 0)
    return Rays(index, view.rays.direction(*cell_centre(view, index)), dr.width(index))


def _joined(groups: list[Rays]) -> Rays:
    filled = [g for g in groups if g.count]
    if len(filled) < 2:
        return filled[0] if filled else groups[0]
    x, y, z = (dr.concat([g.direction[k] for g in filled]) for k in range(3))
    return Rays(dr.concat([g.cell for g in filled]), (x, y, z), sum(g.count for g in filled))


def _sun_cells(view: View, index: Any) -> tuple[Rays, Any]:
    """Return rays through cells near the Sun and the share of each that its disc covers."""
    rays = _through_centres(view, index)
    if not rays.count:
        return rays, mi.Float64(0.0)
    chord2 = (2.0 * dr.sin(0.5 * view.sun_radius)) ** 2

    def disc(x: Any, y: Any) -> Any:
        d = view.rays.direction(x, y)
        if view.turning is not None:
            d = true_direction(view.turning, view.origin, d)
        return chord2 - _gap(d, view.sun)

    share, _, _ = cell_coverage(disc, *cell_centre(view, index), 1.0 / view.subsamples)
    return rays, share


def render_bands(
    view: View, chunks: Iterable[tuple[list[SpectralNode], Chunk]], bands: list[str], nodes: int
) -> dict[str, Any]:
    """Return the radiance per band as Float64 arrays, one value per pixel in row order."""
    cells = group_cells(view)
    k2 = view.subsamples**2
    out = {band: dr.zeros(mi.Float64, view.width * view.height) for band in bands}
    for group, chunk in chunks:
        parts = list(_parts(view, cells, group, chunk, nodes))
        for band in dict.fromkeys(node.band for node in group):
            weight = [dr.opaque(mi.Float64, n.weight if n.band == band else 0.0, 1) for n in group]
            total = dr.zeros(mi.Float64, cells.count)
            for cell, share, radiance in parts:
                value = share * sum(w * r for w, r in zip(weight, radiance, strict=False))
                dr.scatter_add(total, value, cell, mode=dr.ReduceMode.NoConflicts)
                # ground and limb share edge cells: left to one launch, their kernels would race for them
                dr.eval(total)
            out[band] = out[band] + dr.block_sum(total, k2) / k2
            dr.eval(out[band])
    return out


def _parts(
    view: View, cells: Cells, group: list[SpectralNode], chunk: Chunk, nodes: int
) -> Iterator[tuple[Any, Any, list[Any]]]:
    """Yield ``(cells, share of the cell, radiance per node)`` of ground, limb and Sun; each cell once in each."""
    c = SOLAR_CONCENTRATION if chunk.kind == "solar" else THERMAL_CONCENTRATION

    def through(rays: Rays, to_ground: bool) -> tuple[list[Any], list[Any]]:
        result = march(
            view.planet,
            view.top_m,
            chunk,
            view.origin,
            rays.direction,
            view.sun,
            mi.Bool(to_ground),
            nodes,
            c,
        )
        dr.eval(result)
        return result

    def covered(rays: Rays) -> Any:
        return dr.gather(mi.Float64, cells.share, rays.cell)

    if cells.ground.count:
        yield cells.ground.cell, covered(cells.ground), through(cells.ground, True)[0]
    if cells.limb.count:
        yield cells.limb.cell, 1.0 - covered(cells.limb), through(cells.limb, False)[0]
    if cells.sun.count:
        _, transmittance = through(cells.sun, False)
        disc = [dr.opaque(mi.Float64, n.sun_radiance, 1) for n in group]
        share = (1.0 - covered(cells.sun)) * cells.sun_share
        yield cells.sun.cell, share, [r * t for r, t in zip(disc, transmittance, strict=False)]
