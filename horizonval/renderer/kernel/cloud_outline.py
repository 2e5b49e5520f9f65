r"""The outline of cloud tops against the air above the horizon: what share of a cell lies below it.

Across a cell run a few lines along the image axis in which the limb is steeper. Where a line crosses the outline is
found from one ray through its middle, without a search: the ray passes ground points i at distances t_i in heights h_i,
under tops z_i. Turned upwards by delta it gains ``t_i delta cos(e_i)`` there, e_i its elevation, so that it just clears
all clouds when::

    delta = max over i of (z_i - h_i) / (t_i cos e_i)

and the line crosses the outline as far from its middle as that angle is worth. A turn within a cell moves the points by
nothing else. With refraction heights are the apparent ones, in which the turned ray is as straight as the first; the
points are those below the bent ray, which turned bends by a little more or less and passes the same clouds up to 3 km
earlier or later. Points lie as densely as those of the search for clouds (:mod:`.clouds`); those over squares whose
highest top would stay below what is found already are skipped.

Clouds have no gaps below, so a line is covered from the outline inwards, down to the hard edge if that cuts it. The
share of a cell is the mean of its lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from horizonval.earth.clouds.relief import BASE_M
from horizonval.renderer.kernel.clouds import BENDING_NODES_ABOVE, NO_TOP_M, SKIP_MARGIN_M, CloudTable
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, limb_function
from horizonval.renderer.planet import along, dot
from horizonval.renderer.refraction.bending import turn_between, vertical_of
from horizonval.renderer.types import Vec, Vec3, in_single

LINES = 4
"""Across a cell. A straight outline of any slope is off by 1/128 of a cell at most."""
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
    direction = view.rays.direction(*place(cell, across, mi.Float64(0.0)))
    dr.eval(direction)
    turn = _turn(view, clouds, direction, inner)
    top = dr.minimum(dr.clip(-turn / per_line, -0.5, 0.5), hard)
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

    bending, single = view.bending, mi.Float32
    up = None if bending is None else in_single(bending.up(o, d))
    entry, along_ray, from_camera = in_single(along(o, d, start)), in_single(d), single(start)
    step_m = single(table.step_m)

    def place(
        s: mi.Float32, before: mi.Float32, angle: mi.Float32, rate: mi.Float32
    ) -> tuple[mi.Float32, Vec3[mi.Float32], Vec3[mi.Float32], mi.Float32, mi.Float32]:
        """Return apparent heights and normals, true verticals, and angle and rate, by those at ``before``."""
        point = along(entry, along_ray, s)
        if bending is None or up is None:
            height, normal = planet.height_and_normal(point)
            return height, normal, normal, angle, rate
        bent = bending.look(point, up)
        angle = dr.fma(turn_between(rate, bent.rate), s - before, angle)
        return bent.height_m, bent.normal, vertical_of(bent.normal, along_ray, angle), angle, bent.rate

    def apparent(top: mi.Float32) -> mi.Float32:
        return top if bending is None else dr.select(top > BASE_M, bending.apparent(top), NO_TOP_M)

    def turn_at(t: mi.Float32, height: mi.Float32, normal: Vec3[mi.Float32], vertical: Vec3[mi.Float32]) -> mi.Float32:
        top, rise = table.top(vertical), dr.minimum(dot(normal, along_ray), 0.9)
        return dr.select(top > BASE_M, (apparent(top) - height) * dr.rsqrt(1.0 - rise * rise) / t, NONE)

    def glance(
        i: mi.Float32, before: mi.Float32, angle: mi.Float32, rate: mi.Float32, highest: mi.Float32
    ) -> tuple[mi.Float32, mi.Float32, mi.Float32, mi.Float32, mi.Float32]:
        s = i * step_m
        height, normal, vertical, angle, rate = place(s, before, angle, rate)
        highest = dr.maximum(highest, turn_at(from_camera + s, height, normal, vertical))
        return i + single(table.squares[0].steps), s, angle, rate, highest

    def look(
        i: mi.Float32, before: mi.Float32, angle: mi.Float32, rate: mi.Float32, highest: mi.Float32
    ) -> tuple[mi.Float32, mi.Float32, mi.Float32, mi.Float32, mi.Float32]:
        s = i * step_m
        t = from_camera + s
        height, normal, vertical, angle, rate = place(s, before, angle, rate)
        steps, falling = single(1.0), dr.minimum(dot(normal, along_ray), 0.0)
        for squares in table.squares:
            skipped = single(squares.steps)
            above = apparent(table.highest_around(squares, vertical)) - dr.fma(falling, skipped * step_m, height)
            above += SKIP_MARGIN_M
            most = above * dr.select(above > 0.0, STEEPEST / t, 1.0 / (t + skipped * step_m))
            steps = dr.maximum(steps, dr.select(most <= highest, skipped, 1.0))
        return i + steps, s, angle, rate, dr.maximum(highest, turn_at(t, height, normal, vertical))

    zero = single(0.0 * start)
    at_start = rate_at_start = zero
    if bending is not None and up is not None:
        at_start = single(bending.angle(o, d, BENDING_NODES_ABOVE, start, single=True))
        rate_at_start = bending.look(entry, up).rate
        dr.eval(at_start, rate_at_start)
    highest = dr.full(single, NONE, dr.width(d[0]))
    last = single(count)
    # a glance at some points first: what stays below the highest of them is skipped then
    for pass_of, label in ((glance, "cloud glance"), (look, "cloud outline")):
        highest = dr.while_loop(
            (zero + 0.0, zero + 0.0, at_start, rate_at_start, highest),
            lambda i, before, angle, rate, highest: i <= last,
            pass_of,
            labels=("i", "before", "angle", "rate", "highest"),
            label=label,
        )[4]
    return mi.Float64(highest)


def near_clouds(view: FrameGeometry, clouds: CloudTable, direction: Vec, reach: mi.Float64) -> mi.Bool:
    """Return whether cells above the limb may see tops; ``reach``: twice their size, in directions."""
    nearest, _, _ = view.planet.chord(view.origin, direction)
    return -(limb_function(view, direction) + reach) * nearest < clouds.layer_m
