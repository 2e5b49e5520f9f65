r"""The outline of cloud tops against the air above the horizon: what share of a cell lies below it.

Seen from one place the outline is a height above the hard limb for every azimuth, whatever the camera looks at. Frames
find it where they first need it, at a set of azimuths (:class:`OutlineTable`), and it is linear between. Clouds have no
gaps below, so that rays below the outline end on a cloud and rays above it do not: it is bisected with the search for
clouds (:mod:`.clouds`).

Across a cell run a few lines along the image axis in which the limb is steeper. A line is
covered from the outline inwards, down to the hard edge if that cuts it. The share of a cell is the mean of its lines.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.renderer.kernel.clouds import CloudTable, first_cloud
from horizonval.renderer.kernel.frame_geometry import FrameGeometry, RayCoordinates, limb_function
from horizonval.renderer.planet import dot
from horizonval.renderer.tables import table_of, vectors
from horizonval.renderer.types import Vec

LINES = 4
"""Lines across a cell. A straight outline of any slope is off by 1/128 of a cell at most."""
LEAST_SHARE = 1.0 / 256.0
"""Smallest share of a cell that has a separate ray."""
ABOVE_TOPS = 1.01
"""Ratio of the height where the bisection begins to the highest tops: stretching raises them by up to 0.3 %."""
BISECTIONS = 11
"""Number of bisections: the height is then right to 8 m from tops of 17 km."""
FEWEST, MOST = 2**10, 2**20
"""Azimuths of the outline all round: as many as four to the smallest cell, in powers of two."""
BLOCK = 64
"""Of azimuths that are found together."""


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

    def where(level: mi.Float64 | float) -> mi.Float64:
        """Return where lines have a limb function, which bends: straight on both sides of the middle."""
        out = (level - middle) / dr.maximum(middle - outer, 1e-15)
        return dr.clip(
            0.5 * dr.select(level < middle, out, (level - middle) / dr.maximum(inner - middle, 1e-15)), -0.5, 0.5
        )

    hard = where(0.0)
    dr.eval(hard, middle, outer, inner)
    direction = view.rays.direction(*place(cell, across, mi.Float64(0.0)))
    top = dr.minimum(where(outline_of(view, clouds).at(view, clouds, direction)), hard)
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
    # of a corner that no line meets one ray is enough: there is no place on a line for a second
    covered = dr.select(longest_free > 0.0, covered, rest)
    covered = dr.select(covered < LEAST_SHARE, mi.Float64(0.0), dr.minimum(covered, rest))
    covered = dr.select(rest - covered < LEAST_SHARE, rest, covered)

    def through(number_of_line: mi.UInt32, t: mi.Float64) -> Vec:
        aside = ((mi.Float64(number_of_line) + 0.5) / LINES - 0.5) * size
        return view.rays.direction(*place(dr.arange(mi.UInt32, count), aside, t))

    cells = OutlineCells(covered, rest - covered, through(cloud_line, cloud_at), through(free_line, free_at))
    dr.eval(cells.cloud, cells.free, cells.to_cloud, cells.to_free)
    return cells


class OutlineTable:
    """The limb function of what just clears the clouds, at ``count`` azimuths all round.

    0 without clouds above the limb.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._values = np.zeros(count)
        self._made = np.zeros(count // BLOCK, dtype=bool)
        self._kernel = table_of(mi.Float64, self._values)

    @property
    def nbytes(self) -> int:
        """Return the memory of the table."""
        return 2 * self._values.nbytes

    def at(self, view: FrameGeometry, clouds: CloudTable, direction: Vec) -> mi.Float64:
        """Return the limb function on the outline at the azimuths of directions; what is missing is found."""
        coordinates = _coordinates(view)
        _, azimuth = coordinates.place(view.origin, direction, to_ground=False)
        turns = azimuth * (0.5 / math.pi)
        place = (turns - dr.floor(turns)) * float(self.count)
        i = dr.minimum(mi.UInt32(place), self.count - 1)
        weight, following = place - mi.Float64(i), dr.select(i == self.count - 1, 0, i + 1)
        dr.eval(i, weight, following)
        self._cover(view, clouds, coordinates, i, following)
        low, high = (dr.gather(mi.Float64, self._kernel, k) for k in (i, following))
        return dr.fma(high - low, weight, low)

    def _cover(
        self,
        view: FrameGeometry,
        clouds: CloudTable,
        coordinates: RayCoordinates,
        i: mi.UInt32,
        following: mi.UInt32,
    ) -> None:
        seen = dr.zeros(mi.UInt32, len(self._made))
        for k in (i, following):
            dr.scatter(seen, mi.UInt32(1), k // BLOCK)
        missing = np.flatnonzero((np.array(seen) > 0) & ~self._made)
        if not len(missing):
            return
        number = (missing[:, None] * BLOCK + np.arange(BLOCK)).ravel()
        self._values[number] = _limb_functions(
            view, clouds, coordinates, np.asarray(number * (2.0 * math.pi / self.count))
        )
        self._made[missing] = True
        self._kernel = table_of(mi.Float64, self._values)


def outline_of(view: FrameGeometry, clouds: CloudTable) -> OutlineTable:
    """Return the outline that a frame sees, as far as it is known."""
    planet, bending = view.planet, view.bending
    longest = max(float(f[0]) for f in view.rays.values[:2])
    # a cell's azimuths are as far apart as the sine of the limb's nadir angle makes them
    distance = math.sqrt(sum(float(c[0]) ** 2 for c in planet.stretch(view.origin)))
    needed = 2.0 * math.pi * LINES * longest * view.subsamples * planet.a_m / distance
    count = min(max(2 ** math.ceil(math.log2(needed)), FEWEST), MOST)
    bent = None if bending is None else [np.array(column) for column in bending.single]
    return view.position.table(lambda: OutlineTable(count), "cloud outline", clouds.field, bent, count)


def _coordinates(view: FrameGeometry) -> RayCoordinates:
    return view.coordinates(view.top_m)


def _limb_functions(
    view: FrameGeometry, clouds: CloudTable, coordinates: RayCoordinates, azimuth: FloatArray
) -> FloatArray:
    """Return the limb function on the outline at azimuths [rad]."""
    distance, radius = coordinates.distance_m, view.planet.a_m
    most = ABOVE_TOPS * float(clouds.layer_m[0])
    if coordinates.inside:
        most = math.asin(min((radius + most) / distance, 1.0)) - math.asin(radius / distance)
    low, high = np.zeros(len(azimuth)), np.full(len(azimuth), most)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        d = vectors(coordinates.directions(middle, azimuth, to_ground=False))
        hit = np.array(first_cloud(clouds, view.planet, view.origin, d, False, view.bending)[0])
        low, high = np.where(hit, middle, low), np.where(hit, high, middle)
    d = vectors(coordinates.directions(0.5 * (low + high), azimuth, to_ground=False))
    return np.where(low > 0.0, np.minimum(np.array(limb_function(view, d)), 0.0), 0.0)


def near_clouds(view: FrameGeometry, clouds: CloudTable, direction: Vec, reach: mi.Float64) -> mi.Bool:
    """Return whether cells above the limb may see tops; ``reach``: twice their size, in directions."""
    nearest, _, _ = view.planet.chord(view.origin, direction)
    return -(limb_function(view, direction) + reach) * nearest < clouds.layer_m
