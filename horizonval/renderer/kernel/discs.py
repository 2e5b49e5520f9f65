r"""Sun and Moon as discs in a frame: how much of a disc's light falls into a cell, exact in energy.

Seen in the plane that touches the celestial sphere at the disc's centre (gnomonic), the disc is a circle of radius
:math:`\tan\alpha` and a cell is a quadrilateral. With that radius as unit, the share of the disc's light that comes
from within a distance r of its centre is, for ``I(mu) = sum a_k mu^k`` and ``mu^2 = 1 - r^2``::

    Q(r) = 1 - sum a_k mu^(k+2) / (k+2)  /  sum a_k / (k+2),        Q = 1 outside

and by Green's theorem the share that falls into a cell is an integral along its outline::

    q = 1/(2 pi) oint Q(r) dphi

where phi is the position angle about the disc's centre. Parts of an edge outside the disc add ``Q = 1`` times the angle
they subtend, in closed form; parts inside are a Gauss rule in a smooth integrand. Cells share edges and run through
them in opposite directions, so the shares of all cells add up to 1 to the last few bits, however coarse cells or rule
are. A pixel's radiance is the energy in it over the solid angle of the pixel, that of the polygon of its corners:
summed over the frame, radiance times solid angle is the irradiance.

Cells that are coarse against the disc, or against the air in front of it, are split into sub-cells, each with a ray of
its own for the transmittance and its own part behind the Earth.

The Moon has a phase: a sub-cell's share of the disc's area times the law of Lommel and Seeliger (mean of 16 points).

**Coverage** of a cell by the inside of a smooth outline: the limb, or the Sun's disc. The outline is the zero of a
smooth function F of the pixel coordinates, positive inside. F is sampled on the cell's 3 x 3 grid. Along each of three
lines across the cell (in the direction in which F changes faster) the root of the parabola through the three samples is
the outline's position; the parabola :math:`p(s)` through the three roots is the outline. The covered area is then
exact::

    area = int clip(p(s), 0, 1) ds = int max(p, 0) ds - int max(p - 1, 0) ds,     s in [-1/2, 1/2]

with the roots of ``p`` and ``p - 1`` as limits. What is neglected is of third order in cell size over the outline's
radius of curvature in the image: below 1e-6 of a cell for a radius of 100 cells, 2e-5 for 20.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import drjit as dr
import mitsuba as mi
import numpy as np

from horizonval.geometry.rotation import tangent_basis
from horizonval.renderer.planet import distance_squared, dot
from horizonval.renderer.types import Vec, constant_vector, indices_where, inverse_root


def _root(low: mi.Float64, mid: mi.Float64, high: mi.Float64) -> mi.Float64:
    """Return where the parabola through values at -1/2, 0, 1/2 crosses zero: the root nearest to the middle."""
    a = 2.0 * (low + high) - 4.0 * mid
    b = high - low
    disc = dr.sqrt(dr.maximum(b * b - 4.0 * a * mid, 0.0))
    q = -0.5 * (b + dr.select(b < 0.0, -disc, disc))
    return mid / dr.select(dr.abs(q) < 1e-300, 1e-300, q)


def _positive_area(c0: mi.Float64, c1: mi.Float64, c2: mi.Float64) -> mi.Float64:
    """Return the integral of ``max(c0 + c1 s + c2 s^2, 0)`` over [-1/2, 1/2]."""

    def primitive(s: mi.Float64 | float) -> mi.Float64:
        return s * (c0 + s * (c1 / 2.0 + s * (c2 / 3.0)))

    disc = c1 * c1 - 4.0 * c2 * c0
    q = -0.5 * (c1 + dr.select(c1 < 0.0, -1.0, 1.0) * dr.sqrt(dr.maximum(disc, 0.0)))
    flat = dr.abs(c2) < 1e-14
    # a straight outline has its second root at infinity
    far = dr.select(flat, 1e6 * dr.sign(c1 + 1e-300) * dr.select(c2 < 0.0, 1.0, -1.0), q / dr.select(flat, 1.0, c2))
    near = c0 / dr.select(dr.abs(q) < 1e-300, 1e-300, q)
    low = dr.clip(dr.minimum(far, near), -0.5, 0.5)
    high = dr.clip(dr.maximum(far, near), -0.5, 0.5)
    whole = primitive(0.5) - primitive(-0.5)
    between = primitive(high) - primitive(low)
    crossed = dr.select(c2 < 0.0, between, whole - between)
    return dr.select(disc <= 0.0, dr.select(c0 > 0.0, whole, 0.0), crossed)


def cell_coverage(
    inside: Callable[[mi.Float64, mi.Float64], mi.Float64], u: mi.Float64, v: mi.Float64, size: mi.Float64 | float
) -> tuple[mi.Float64, mi.Float64, mi.Float64]:
    """Return the covered share of square cells and the unit step towards the inside, ``(share, du, dv)``.

    ``inside``: F of pixel coordinates (column, row), smooth, positive inside; ``u``, ``v``: cell centres; ``size``:
    edge of a cell [pixels].
    """
    f = [[inside(u + size * 0.5 * i, v + size * 0.5 * j) for i in (-1, 0, 1)] for j in (-1, 0, 1)]
    gu, gv = f[1][2] - f[1][0], f[2][1] - f[0][1]
    steep_u = dr.abs(gu) >= dr.abs(gv)
    lines = [[dr.select(steep_u, f[j][i], f[i][j]) for i in range(3)] for j in range(3)]
    rising = dr.select(steep_u, gu, gv) >= 0.0
    roots = [_root(*line) for line in lines]
    # distance covered along each line, measured from the inner edge of the cell
    p = [dr.select(rising, 0.5 - r, r + 0.5) for r in roots]
    c0, c1, c2 = p[1], p[2] - p[0], 2.0 * (p[0] + p[2]) - 4.0 * p[1]
    share = dr.clip(_positive_area(c0, c1, c2) - _positive_area(c0 - 1.0, c1, c2), 0.0, 1.0)
    norm = inverse_root(dr.maximum(gu * gu + gv * gv, 1e-300))
    return share, gu * norm, gv * norm


SPLITS_PER_RADIUS = 6.0
"""Sub-cells across the radius of a disc, at least; twice as many where the limb may cut it, four times on the Moon."""
SPLIT_HEIGHT_M = 1500.0
"""Size of a sub-cell at the limb, at most, for discs that are seen through the air."""
MOST_SUB_CELLS = 2**19
_X, _W = np.polynomial.legendre.leggauss(12)
_POINTS = 4

Direction: TypeAlias = "Callable[[mi.Float64, mi.Float64], Vec]"
Limb: TypeAlias = "Callable[[mi.Float64, mi.Float64], mi.Float64]"


@dataclass(frozen=True)
class Disc:
    """A disc in the sky: unit vector to its centre and angular radius, size-1 arrays.

    ``light``: unit vector from a lit body towards the Sun; None for a body that shines.
    """

    direction: Vec
    radius: mi.Float64
    light: Vec | None = None


@dataclass(frozen=True)
class DiscCells:
    """Sub-cells of a frame that hold light of a disc.

    ``cell``: cells of the frame, each once. ``sub``: sub-cells with light; ``sub // splits^2`` is the index into
    ``cell``. ``direction``: rays through the free part of each sub-cell, as the camera sees them. ``corners``: of each
    sub-cell, in the disc's plane and radii. ``free``: share of the sub-cell that is not behind the Earth, over the
    solid angle of a cell of its pixel [1/sr]. ``phase``: radiance of each sub-cell over the disc's mean; None for a
    disc that shines.
    """

    cell: mi.UInt32
    sub: mi.UInt32
    splits: int
    direction: Vec
    corners: list[tuple[mi.Float64, mi.Float64]]
    free: mi.Float64
    phase: mi.Float64 | None = None

    @property
    def count(self) -> int:
        """Sub-cells to march through."""
        return int(dr.width(self.sub)) if dr.width(self.cell) else 0

    def radiance(self, irradiance: mi.Float64, darkening: Sequence[float], transmittance: mi.Float64) -> mi.Float64:
        """Return what a disc of this irradiance adds to the radiance of every cell of ``cell``."""
        value = irradiance * share_of_disc(self.corners, darkening) * self.free * transmittance
        if self.phase is not None:
            value = value * self.phase
        full = dr.zeros(mi.Float64, dr.width(self.cell) * self.splits**2)
        dr.scatter(full, value, self.sub, mode=dr.ReduceMode.NoConflicts)
        dr.eval(full)
        return dr.block_sum(full, self.splits**2)


def share_of_disc(corners: list[tuple[mi.Float64, mi.Float64]], darkening: Sequence[float]) -> mi.Float64:
    """Return the share of a disc's light inside polygons; corners in radii of the disc, from its centre."""
    terms = [a / (k + 2.0) for k, a in enumerate(darkening)]
    total = sum(terms)
    terms = [t / total for t in terms]

    def within(r2: mi.Float64) -> mi.Float64:
        """Return Q(r)."""
        mu2 = dr.maximum(1.0 - r2, 0.0)
        mu = dr.sqrt(mu2)
        outer = mi.Float64(0.0)
        for t in reversed(terms):
            outer = outer * mu + t
        return 1.0 - outer * mu2

    winding = mi.Float64(0.0)
    for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
        dx, dy = x1 - x0, y1 - y0
        scale = inverse_root(dr.maximum(dx * dx + dy * dy, 1e-300))
        tx, ty = dx * scale, dy * scale
        h = x0 * ty - y0 * tx
        s0, s1 = x0 * tx + y0 * ty, x1 * tx + y1 * ty
        half = dr.sqrt(dr.maximum(1.0 - h * h, 0.0))
        a, b = dr.clip(-half, s0, s1), dr.clip(half, s0, s1)
        reach = dr.abs(h)
        outside = (dr.atan2(a, reach) - dr.atan2(s0, reach)) + (dr.atan2(s1, reach) - dr.atan2(b, reach))
        inside = mi.Float64(0.0)
        for node, weight in zip(_X, _W, strict=True):
            s = 0.5 * (a + b) + 0.5 * (b - a) * float(node)
            r2 = dr.maximum(h * h + s * s, 1e-24)
            inside = inside + float(weight) * within(r2) / r2
        winding = winding + dr.sign(h) * outside + h * 0.5 * (b - a) * inside
    return dr.abs(winding) * (0.5 / math.pi)


def disc_cells(
    disc: Disc,
    cell: mi.UInt32,
    centre: tuple[mi.Float64, mi.Float64],
    pixel: tuple[mi.Float64, mi.Float64],
    subsamples: int,
    seen: Direction,
    limb: Limb,
    height_rad: float | None,
    through: Direction | None = None,
) -> DiscCells:
    """Return the sub-cells of some cells of a frame that hold light of a disc.

    ``cell``: cells that may touch the disc, each once; ``centre``, ``pixel``: (column, row) of the cells' centres and
    of their pixels'; ``subsamples``: cells per pixel and axis; ``seen``: direction of the ray through pixel
    coordinates, at the camera; ``limb``: smooth function of pixel coordinates, positive where a ray ends on the Earth;
    ``height_rad``: angle under which the camera sees :data:`SPLIT_HEIGHT_M` at the limb, None where no air is in front;
    ``through``: direction outside the air, default ``seen``. Radiance is constant along a bent ray, so that nothing
    else depends on it.
    """
    through = through or seen
    size = 1.0 / subsamples
    middle, side = through(*centre), through(centre[0] + size, centre[1])
    width = math.sqrt(float(dr.max(distance_squared(middle, side))[0]))
    finest = float(disc.radius[0]) / (SPLITS_PER_RADIUS if disc.light is None else 4.0 * SPLITS_PER_RADIUS)
    if height_rad is not None:
        finest = min(float(disc.radius[0]) / (2.0 * SPLITS_PER_RADIUS), finest, height_rad)
    splits = max(1, min(math.ceil(width / finest), math.isqrt(MOST_SUB_CELLS // dr.width(cell))))
    # data, not constants: frames share compiled kernels whatever their splitting
    parts, across = dr.opaque(mi.UInt32, splits**2, 1), dr.opaque(mi.UInt32, splits, 1)
    small = dr.opaque(mi.Float64, size / splits, 1)
    across_disc = tangent_basis(np.array([float(c[0]) for c in disc.direction])).T
    e1, e2 = (constant_vector(axis) for axis in across_disc)
    sine, cosine = dr.sincos(disc.radius)
    tangent = sine / cosine

    def on_disc(x: mi.Float64, y: mi.Float64) -> tuple[mi.Float64, mi.Float64]:
        d = through(x, y)
        scale = 1.0 / (dr.maximum(dot(d, disc.direction), 1e-3) * tangent)
        return dot(d, e1) * scale, dot(d, e2) * scale

    sub = dr.arange(mi.UInt32, dr.width(cell) * splits**2)

    def centre_of(index: mi.UInt32) -> tuple[mi.Float64, mi.Float64]:
        owner, part = index // parts, index % parts
        u = dr.gather(mi.Float64, centre[0], owner) + (mi.Float64(part % across) + 0.5) * small - 0.5 * size
        v = dr.gather(mi.Float64, centre[1], owner) + (mi.Float64(part // across) + 0.5) * small - 0.5 * size
        return u, v

    def corners(u: mi.Float64, v: mi.Float64) -> list[tuple[mi.Float64, mi.Float64]]:
        h = 0.5 * small
        return [on_disc(u + i * h, v + j * h) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]

    sub = indices_where(share_of_disc(corners(*centre_of(sub)), (1.0,)) > 0.0)
    if not dr.width(sub):
        none = mi.Float64()
        return DiscCells(cell, sub, splits, (none, none, none), [], mi.Float64(0.0))
    u, v = centre_of(sub)
    covered, du, dv = cell_coverage(limb, u, v, small)
    owner = sub // parts
    column, line = (dr.gather(mi.Float64, w, owner) for w in pixel)
    solid_angle = _solid_angle(seen, column, line) / subsamples**2
    # through the middle of the part that is seen: away from the Earth where the limb cuts the sub-cell
    shift = 0.5 * small * covered
    at_corners = corners(u, v)
    dr.eval(at_corners)
    result = DiscCells(
        cell,
        sub,
        splits,
        seen(u - shift * du, v - shift * dv),
        at_corners,
        (1.0 - covered) / solid_angle,
        None if disc.light is None else _phase(disc, (e1, e2), at_corners),
    )
    dr.eval(result.direction, result.free, result.phase)
    return result


def _solid_angle(seen: Direction, u: mi.Float64, v: mi.Float64) -> mi.Float64:
    """Return the solid angle of pixels: the two spherical triangles of the corners (Van Oosterom and Strackee 1983)."""
    a, b, c, d = (seen(u + i * 0.5, v + j * 0.5) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1)))

    def triangle(p: Vec, q: Vec, r: Vec) -> mi.Float64:
        # differences of neighbours: the plain triple product of near vectors would cancel
        s, t = tuple(x - y for x, y in zip(q, p, strict=True)), tuple(x - y for x, y in zip(r, p, strict=True))
        cross = (s[1] * t[2] - s[2] * t[1], s[2] * t[0] - s[0] * t[2], s[0] * t[1] - s[1] * t[0])
        return 2.0 * dr.atan2(dr.abs(dot(p, cross)), 1.0 + dot(p, q) + dot(q, r) + dot(r, p))

    return triangle(a, b, c) + triangle(a, c, d)


def _phase(disc: Disc, axes: tuple[Vec, Vec], corners: list[tuple[mi.Float64, mi.Float64]]) -> mi.Float64:
    """Return the mean of ``mu0 / (mu0 + mu)`` in sub-cells over that of the whole disc, at most at its edge.

    Places in a sub-cell are bilinear between its ``corners``.
    """
    assert disc.light is not None
    to_observer = -dot(disc.light, disc.direction)
    lx, ly = dot(disc.light, axes[0]), dot(disc.light, axes[1])
    half = 0.5 * dr.acos(dr.clip(to_observer, -1.0, 1.0))
    sine, cosine = dr.sincos(half)
    tan_quarter = dr.clip(sine / (1.0 + cosine), 1e-12, 1.0 - 1e-12)
    whole = 0.5 * (1.0 + sine * sine / cosine * dr.log(tan_quarter))
    total, points = mi.Float64(0.0), mi.Float64(0.0)
    for i in range(_POINTS):
        for j in range(_POINTS):
            across, down = (i + 0.5) / _POINTS, (j + 0.5) / _POINTS
            x, y = (
                dr.lerp(dr.lerp(a, b, across), dr.lerp(d, c, across), down) for a, b, c, d in zip(*corners, strict=True)
            )
            scale = dr.minimum(1.0, 0.9995 * inverse_root(dr.maximum(x * x + y * y, 1e-12)))
            # points beside the disc stand on its edge, and count only where there are no others
            weight = dr.select(scale < 1.0, mi.Float64(1e-6), 1.0)
            x, y = x * scale, y * scale
            mu = dr.sqrt(1.0 - x * x - y * y)
            mu0 = dr.maximum(x * lx + y * ly + mu * to_observer, 0.0)
            total = total + weight * mu0 / (mu0 + mu)
            points = points + weight
    return total / (points * dr.maximum(whole, 1e-9))
