r"""The outline of cloud tops against the air above the horizon: what share of a cell lies below it.

Across a cell run a few lines along the image axis in which the limb is steeper. Where a line crosses the outline is
found from one ray through its middle, without a search: the ray passes ground points i at distances t_i in heights h_i,
under tops z_i. Turned upwards by delta it gains ``t_i delta cos(e_i)`` there, e_i its elevation, so that it just clears
all clouds when::

    delta = max over i of (z_i - h_i) / (t_i cos e_i)

and the line crosses the outline as far from its middle as that angle is worth. A turn within a cell moves the points by
nothing else. With refraction the points are those of the bent ray, which turned bends otherwise: a second ray starts
where the first found the outline. Points lie as densely as those of the search for clouds (:mod:`.clouds`);
those over squares whose highest top would stay below what is found already are skipped.

Clouds have no gaps below, so a line is covered from the outline inwards, down to the hard edge if that cuts it. The
share of a cell is the mean of its lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.earth.clouds.relief import BASE_M
from horizonval.renderer.kernel.clouds import SKIP_MARGIN_M, CloudTable
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, limb_function
from horizonval.renderer.planet import along, dot
from horizonval.renderer.types import Vec

LINES = 4
"""Across a cell. A straight outline of any slope is off by 1/128 of a cell at most."""
BENT_PASSES = 2
"""With refraction a turned ray bends otherwise: the outline is looked for again from where it was found."""
BENDING_NODES_ABOVE = 32
NONE = -1.0
"""Of the delta of the module text where there is no cloud: far below all."""
STEEPEST = 1.01
"""1 / cos e at most, in the layer of the tops beside the limb."""
LEAST_SHARE = 1.0 / 256.0
"""Of a cell, to have a ray of its own."""


@dataclass(frozen=True)
class OutlineCells:
    """What cells near the outline see: shares of cloud and of air above it, and directions through both."""

    cloud: mi.Float64
    free: mi.Float64
    to_cloud: Vec
    to_free: Vec


def outlined_clouds(view: FrameGeometry) -> CloudTable | None:
    """Return the clouds of a frame if they have an outline: seen from above them."""
    if view.ground is None or view.ground.clouds is None:
        return None
    highest = view.planet.a_m + float(view.ground.clouds.layer_m[0])
    return view.ground.clouds if float(dot(view.origin, view.origin)[0]) > highest**2 else None


def outline_cells(
    view: FrameGeometry, clouds: CloudTable, u: mi.Float64, v: mi.Float64, ground: mi.Float64
) -> OutlineCells:
    """Return what cells above or on the limb see; ``u``, ``v``: pixel coordinates of their centres.

    ``ground``: the share of each that the ellipsoid covers.
    """
    size, count = 1.0 / view.subsamples, dr.width(u)
    step = 0.25 * size

    def limb(x: mi.Float64, y: mi.Float64) -> mi.Float64:
        return limb_function(view, view.rays.direction(x, y))

    along_u = limb(u + step, v) - limb(u - step, v)
    along_v = limb(u, v + step) - limb(u, v - step)
    by_u = dr.abs(along_u) >= dr.abs(along_v)
    inwards = dr.select(dr.select(by_u, along_u, along_v) < 0.0, mi.Float64(-size), size)
    dr.eval(by_u, inwards)

    number = dr.arange(mi.UInt32, count * LINES)
    cell, line = number // LINES, number % LINES
    across = ((mi.Float64(line) + 0.5) / LINES - 0.5) * size

    def place(of: mi.UInt32, aside: mi.Float64, t: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        """Return points of lines: ``t`` from -1/2 at the outer end to 1/2 at the inner one."""
        first = dr.gather(mi.Bool, by_u, of)
        deep = dr.gather(mi.Float64, inwards, of) * t
        x, y = dr.select(first, deep, aside), dr.select(first, aside, deep)
        return dr.gather(mi.Float64, u, of) + x, dr.gather(mi.Float64, v, of) + y

    middle, outer, inner = (limb(*place(cell, across, mi.Float64(t))) for t in (0.0, -0.5, 0.5))
    per_line = dr.maximum(inner - outer, 1e-15)
    hard = dr.clip(-middle / per_line, -0.5, 0.5)
    dr.eval(per_line, hard, inner)
    top = dr.zeros(mi.Float64, count * LINES)
    for _ in range(1 if view.bending is None else BENT_PASSES):
        direction = view.rays.direction(*place(cell, across, top))
        dr.eval(direction)
        turn = _turn(view, clouds, direction, inner)
        top = dr.clip(top - turn / per_line, -0.5, 0.5)
        dr.eval(top)
    top = dr.minimum(top, hard)
    dr.eval(top)

    none, first_line = dr.zeros(mi.Float64, count), dr.zeros(mi.UInt32, count)
    covered = longest = longest_free = cloud_at = free_at = none
    cloud_line = free_line = first_line
    first_of = dr.arange(mi.UInt32, count) * LINES
    for k in range(LINES):
        low, high = (dr.gather(mi.Float64, c, first_of + k) for c in (top, hard))
        covered = dr.fma(high - low, 1.0 / LINES, covered)
        longer = high - low > longest
        longest, cloud_at = dr.select(longer, high - low, longest), dr.select(longer, 0.5 * (low + high), cloud_at)
        cloud_line = dr.select(longer, mi.UInt32(k), cloud_line)
        freer = low + 0.5 > longest_free
        longest_free, free_at = dr.select(freer, low + 0.5, longest_free), dr.select(freer, 0.5 * low - 0.25, free_at)
        free_line = dr.select(freer, mi.UInt32(k), free_line)
    rest = 1.0 - ground
    covered = dr.select(covered < LEAST_SHARE, mi.Float64(0.0), dr.minimum(covered, rest))
    covered = dr.select(rest - covered < LEAST_SHARE, rest, covered)

    def through(number_of_line: mi.UInt32, t: mi.Float64) -> Vec:
        aside = ((mi.Float64(number_of_line) + 0.5) / LINES - 0.5) * size
        return view.rays.direction(*place(dr.arange(mi.UInt32, count), aside, t))

    cells = OutlineCells(covered, rest - covered, through(cloud_line, cloud_at), through(free_line, free_at))
    dr.eval(cells.cloud, cells.free, cells.to_cloud, cells.to_free)
    return cells


def _turn(view: FrameGeometry, table: CloudTable, d: Vec, inner: mi.Float64) -> mi.Float64:
    """Return the delta of the module text [rad], far below zero where no cloud stands; ``inner``: limb function of the
    lowest ray that counts.
    """
    planet, o = view.planet, view.origin
    nearest, _, _ = planet.chord(o, d)
    lowest = dr.maximum(-inner * nearest, 0.0)
    half = dr.sqrt(dr.maximum(table.layer_m - lowest, 0.0) * (2.0 * planet.a_m + table.layer_m))
    start = dr.maximum(nearest - half, table.step_m)
    count = dr.select(half > 0.0, dr.ceil((nearest + half - start) / table.step_m), -1.0)

    bending = view.bending
    up = None if bending is None else bending.up(o, d)

    def place(t: mi.Float64, angle: mi.Float64) -> tuple[mi.Float64, Vec]:
        if bending is None:
            return planet.height_and_normal(along(o, d, t))
        return bending.place(o, d, t, angle)

    def turned(t: mi.Float64, angle: mi.Float64, further_m: mi.Float64) -> mi.Float64:
        if bending is None or up is None:
            return angle
        return dr.fma(bending.rate(o, d, up, dr.fma(0.5, further_m, t)), further_m, angle)

    def turn_at(t: mi.Float64, height: mi.Float64, normal: Vec) -> mi.Float64:
        top, rise = table.top(normal), dr.minimum(dot(normal, d), 0.9)
        return dr.select(top > BASE_M, (top - height) * dr.rsqrt(1.0 - rise * rise) / t, NONE)

    def glance(i: mi.Float64, angle: mi.Float64, highest: mi.Float64) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
        t, further = dr.fma(i, table.step_m, start), table.skipped * table.step_m
        highest = dr.maximum(highest, turn_at(t, *place(t, angle)))
        return i + table.skipped, turned(t, angle, further), highest

    def look(i: mi.Float64, angle: mi.Float64, highest: mi.Float64) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
        t, skipped_m = dr.fma(i, table.step_m, start), table.skipped * table.step_m
        height, normal = place(t, angle)
        turn = turn_at(t, height, normal)
        lowest = dr.fma(dr.minimum(dot(normal, d), 0.0), skipped_m, height - SKIP_MARGIN_M)
        above = table.highest_around(normal) - lowest
        most = above * dr.select(above > 0.0, STEEPEST / t, 1.0 / (t + skipped_m))
        steps = dr.select(most <= highest, table.skipped, 1.0)
        return i + steps, turned(t, angle, steps * table.step_m), dr.maximum(highest, turn)

    at_start = 0.0 * start if bending is None else bending.angle(o, d, BENDING_NODES_ABOVE, start)
    highest = dr.full(mi.Float64, NONE, dr.width(d[0]))
    # a glance at some points first: what stays below the highest of them is skipped then
    for pass_of, label in ((glance, "cloud glance"), (look, "cloud outline")):
        highest = dr.while_loop(
            (dr.zeros(mi.Float64, dr.width(d[0])), at_start, highest),
            lambda i, angle, highest: i <= count,
            pass_of,
            labels=("i", "angle", "highest"),
            label=label,
        )[2]
    return highest


def near_clouds(view: FrameGeometry, clouds: CloudTable, direction: Vec, reach: mi.Float64) -> mi.Bool:
    """Return whether cells above the limb may see tops; ``reach``: twice their size, in directions."""
    nearest, _, _ = view.planet.chord(view.origin, direction)
    return -(limb_function(view, direction) + reach) * nearest < clouds.layer_m
