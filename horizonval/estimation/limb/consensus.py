"""Which edge points lie on one horizon: consensus on the cone of sight lines.

Three lines of sight define a cone (see :mod:`horizonval.geometry.cone`). Triples of edge points are drawn
(RANSAC, Fischler and Bolles 1981); a point supports a cone if

* it lies on its limb, within a pixel tolerance widened by a few kilometres of real limb (clouds, oblateness, haze:
  a height ``h`` at the limb is seen under ``h tan(rho) / R``), and
* its grey-level gradient is perpendicular to the limb, and
* all supporters are bright on the same side. Which side is not prescribed: on an infrared print space is white.

The cone closes around the Earth, so the side is decided by the curve alone. Working on cones in three dimensions makes
the test independent of field of view and projection, and nothing needs to know whether the image shows a circle, an
ellipse or a hyperbola.

Triples are drawn preferably from points with one calm side, since space is featureless; and a triple must agree with
its own three gradients before it is tried, which throws away all but a few in a thousand of the chance ones.
The generator's seed is the image's hash: the same image always gives the same points.

**Cost.** Whatever is asked of many points or cones is asked of arrays with the points along them, in pieces that stay
in the processor's cache; the cheapest question comes first, and the next one only for what is left. Cones that gather
the same supporters on their way are one from there on.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.edges import Edges
from horizonval.estimation.limb.shape.cone import arc_order
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.cone import cones_through, fit_cone
from horizonval.geometry.directions import cross

IndexArray = NDArray[np.int64]

TOLERANCE_PX = 1.5
LIMB_RELIEF = 8e3 / 6.371e6
"""Height of real limb relief over Earth radii."""
LARGEST_TOLERANCE_SHARE = 0.006
"""Tolerance never exceeds this share of the image's smaller side (nor falls below the pixel tolerance)."""
COS_GRADIENT = float(np.cos(np.deg2rad(25.0)))
TRIPLES = 60_000
TRIED = 1_200
SUBSET = 900
POOL = 6_000
KEPT = 12
SLACKS = (2.0, 1.5, 1.0, 1.0, 1.0)
"""Of the tolerance, each time that a cone is fitted to its supporters again."""
TRIPLES_AT_ONCE = 12_000
FEW = 1_000
"""Points of which it is sooner asked at once than which are near."""
PLACES_AT_ONCE = 32_000
"""Points times cones that are looked at in one piece."""
PRODUCTS = ((0, 1), (0, 2), (1, 2))
GAP_PX = 3.5
"""Supporters closer than this along the limb are one unbroken piece of it."""


@dataclass(frozen=True)
class EdgePoints:
    """Edge points as lines of sight.

    Attributes
    ----------
    uv, gradient : ndarray, shape (n, 2)
    los_cam : ndarray, shape (n, 3)
    jacobian : ndarray, shape (n, 3, 2)
        Derivative of the line of sight by (column, row).
    quiet : ndarray, shape (n,)
    shape : tuple of int
        Image size (H, W).
    """

    uv: FloatArray
    gradient: FloatArray
    los_cam: FloatArray
    jacobian: FloatArray
    quiet: FloatArray
    shape: tuple[int, int]

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> EdgePoints:
        """Return a selection of the points."""
        return EdgePoints(
            self.uv[rows], self.gradient[rows], self.los_cam[rows], self.jacobian[rows], self.quiet[rows], self.shape
        )

    @cached_property
    def pixel_rad(self) -> FloatArray:
        """Root sum of squares of the angles of a pixel's width and height at each point, shape (n,)."""
        return np.asarray(np.linalg.norm(self.jacobian, axis=(1, 2)))

    @cached_property
    def slopes(self) -> FloatArray:
        """Derivatives of the line of sight along the gradient, by the column and by the row, shape (3, 3, n)."""
        x, y = np.ascontiguousarray(self.jacobian.transpose(2, 1, 0))
        return np.stack([self.gradient[:, 0] * x + self.gradient[:, 1] * y, x, y])

    @cached_property
    def planes(self) -> FloatArray:
        """What is asked of points again and again, shape (14, n).

        Line of sight (3), one, pixels per radian; by the axis of a cone: the turn of the gradient from the inward
        normal times the slope of the cone (3), and that slope squared, of the axis' squares and products (6).
        """
        turn, x, y = self.slopes
        squares = x * x + y * y
        products = [2.0 * (x[i] * x[j] + y[i] * y[j]) for i, j in PRODUCTS]
        px_per_rad = 1.0 / self.pixel_rad * np.sqrt(2.0)
        return np.concatenate([self.los_cam.T, [np.ones(len(x.T)), px_per_rad], turn, squares, products])


@dataclass(frozen=True)
class Candidate:
    """A cone with the points that support it.

    Attributes
    ----------
    axis_cam : ndarray, shape (3,)
    cos_rho : float
    bright_inside : bool
    rows : ndarray of int
        Supporters, in order of azimuth about the axis.
    arc_px : float
        Length of limb along which supporters follow each other without a gap.
    """

    axis_cam: FloatArray
    cos_rho: float
    bright_inside: bool
    rows: IndexArray
    arc_px: float


def to_sight(edges: Edges, camera: CameraModel, shape: tuple[int, int]) -> EdgePoints:
    """Turn edge points into lines of sight; points where the camera has no direction are left out."""
    (sight,) = to_sights(edges, camera, shape, np.arange(len(edges.uv)))
    return sight


def to_sights(
    edges: Edges, camera: CameraModel, shape: tuple[int, int], *selections: IndexArray
) -> tuple[EdgePoints, ...]:
    """Turn selections of edge points, each in the edges' order, into lines of sight: every point but once."""
    members = np.zeros((len(selections), len(edges.uv)), dtype=bool)
    for member, rows in zip(members, selections, strict=True):
        member[rows] = True
    used = np.flatnonzero(members.any(axis=0))
    uv = edges.uv[used]
    los = unproject(camera, uv)
    step = np.array([[0.5, 0.0], [0.0, 0.5]])
    jacobian = np.stack([unproject(camera, uv + step[i]) - unproject(camera, uv - step[i]) for i in (0, 1)], axis=-1)
    good = np.isfinite(los).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    both = EdgePoints(uv, edges.gradient[used], los, jacobian, edges.quiet[used], shape)
    return tuple(both.take(good & member[used]) for member in members)


def find_candidates(sight: EdgePoints, rng: np.random.Generator) -> list[Candidate]:
    """Return the best supported cones, the longest supported arc first; cones that are the same are given once.

    Parameters
    ----------
    sight : EdgePoints
    rng : numpy.random.Generator
    """
    n = len(sight.uv)
    if n < 3:
        return []
    pool = np.argsort(sight.quiet, kind="stable")[: max(POOL, n // 4)]
    if len(pool) > POOL:
        pool = rng.permutation(pool)[:POOL]
    distinct: list[Candidate] = []
    for candidate in _improved(sight, _draw(sight, pool, rng)):
        if not any(_same(candidate, other) for other in distinct):
            distinct.append(candidate)
    return sorted(distinct, key=lambda c: -c.arc_px)


def support(
    sight: EdgePoints, axis: FloatArray, cosine: float, bright_inside: bool, slack: float = 1.0
) -> NDArray[np.bool_]:
    """Return which points support a cone (see the module text); ``slack`` widens or narrows the tolerance."""
    cones = _Cones.of(axis[None], np.array([cosine]), sight.shape, slack)
    if len(sight.uv) < FEW:
        return cones.hits(sight.planes, bright_inside)[0]
    supports = np.zeros(len(sight.uv), dtype=bool)
    # The limb crosses no more of a pixel than its diagonal: most edges of an image are too far off by that alone.
    reach = slack * _largest_tolerance_px(sight.shape) * (1.0 + 1e-9)
    near = np.flatnonzero(np.abs(axis @ sight.planes[:3] - cosine) <= reach * sight.pixel_rad)
    supports[near] = cones.hits(np.take(sight.planes, near, axis=1), bright_inside)[0]
    return supports


def off_limb_px(sight: EdgePoints, axis: FloatArray, cosine: float) -> FloatArray:
    """Return how far each point lies inside (positive) a cone's limb [px], to first order."""
    cone = _Cones.of(axis[None], np.array([cosine]), sight.shape, 1.0)
    slope = np.sqrt(np.maximum(cone.factors[:, 6:] @ sight.planes[8:], 0.0))[0]
    return np.asarray((cone.factors[:, :4] @ sight.planes[:4])[0] / np.where(slope > 0.0, slope, np.inf))


@dataclass(frozen=True)
class _Cones:
    """Cones as factors of the points' ``planes``.

    ``factors``, shape (k, 12): axis and negative cosine, for how far inside the limb; two for how far it may be, over
    the slope of the cone, at most ``largest``; and six for that slope squared.
    """

    factors: FloatArray
    largest: float

    @classmethod
    def of(cls, axes: FloatArray, cosines: FloatArray, shape: tuple[int, int], slack: float) -> _Cones:
        """Return cones, axes (k, 3), with the tolerance of a search, which ``slack`` widens."""
        factors = np.empty((len(axes), 12))
        factors[:, :3] = axes
        factors[:, 3] = -cosines
        factors[:, 4] = slack * TOLERANCE_PX
        tangent = np.sqrt(np.maximum(1.0 - cosines**2, 0.0)) / np.maximum(cosines, 0.17)
        factors[:, 5] = slack * LIMB_RELIEF * tangent
        factors[:, 6:9] = axes * axes
        for column, (i, j) in enumerate(PRODUCTS, 9):
            factors[:, column] = axes[:, i] * axes[:, j]
        return cls(factors, slack * _largest_tolerance_px(shape))

    def take(self, rows: slice) -> _Cones:
        """Return a selection of the cones."""
        return _Cones(self.factors[rows], self.largest)

    def hits(self, planes: FloatArray, bright_inside: bool) -> NDArray[np.bool_]:
        """Return which points (14, n) support which cones, shape (k, n)."""
        slope2 = self.factors[:, 6:] @ planes[8:]
        off = self.factors[:, :4] @ planes[:4]
        off *= off
        tolerance = self.factors[:, 4:6] @ planes[3:5]
        np.minimum(tolerance, self.largest, out=tolerance)
        tolerance *= tolerance
        tolerance *= slope2
        hits = np.asarray(off <= tolerance)
        turn = np.matmul(self.factors[:, :3], planes[5:8], out=off)
        hits &= turn > 0.0 if bright_inside else turn < 0.0
        turn *= turn
        slope2 *= COS_GRADIENT**2
        hits &= turn >= slope2
        return hits


def _largest_tolerance_px(shape: tuple[int, int]) -> float:
    return max(TOLERANCE_PX, LARGEST_TOLERANCE_SHARE * min(shape))


def _draw(sight: EdgePoints, pool: IndexArray, rng: np.random.Generator) -> list[tuple[FloatArray, float, bool]]:
    """Return the ``KEPT`` cones with most support among random triples, of each polarity."""
    triples = pool[rng.integers(0, len(pool), size=(TRIPLES, 3))]
    subset = sight.take(pool if len(pool) <= SUBSET else rng.permutation(pool)[:SUBSET])
    chosen: list[tuple[FloatArray, float, bool]] = []
    for bright_inside, good in zip((True, False), _agreeing(sight, triples), strict=True):
        axes, cosines = cones_through(*(sight.los_cam[good[:, i]] for i in range(3)))
        votes = _votes(subset, axes, cosines, bright_inside)
        for k in np.argsort(-votes, kind="stable")[:KEPT]:
            chosen.append((axes[k], float(cosines[k]), bright_inside))
    return chosen


def _agreeing(sight: EdgePoints, triples: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return the first ``TRIED`` triples, shape (k, 3), whose gradients agree, bright inside and bright outside.

    All three must point along the limb's normal, to the same side of it. No more triples are looked at than it takes.
    """
    u, v = sight.uv.T.copy()
    los, slopes = sight.planes[:3], sight.slopes
    apart2 = (0.04 * min(sight.shape)) ** 2
    pieces: tuple[list[IndexArray], list[IndexArray]] = ([], [])
    missing = [TRIED, TRIED]
    for start in range(0, len(triples), TRIPLES_AT_ONCE):
        points = triples[start : start + TRIPLES_AT_ONCE].T
        (ua, ub, uc), (va, vb, vc) = u[points], v[points]
        far = ((ua - ub) ** 2 + (va - vb) ** 2 > apart2) & ((ub - uc) ** 2 + (vb - vc) ** 2 > apart2)
        far &= (ua - uc) ** 2 + (va - vc) ** 2 > apart2
        points = points.compress(far, axis=1)
        a, b, c = (np.take(los, row, axis=1) for row in points)
        normal = np.stack(cross(b - a, c - a))
        # The cone is on the side of its points.
        opposite = _product(normal, a) < 0.0
        side = np.zeros(len(opposite))
        for i in range(3):
            turns, across, down = np.take(slopes, points[i], axis=2)
            turn, x, y = _product(normal, turns), _product(normal, across), _product(normal, down)
            agrees = (turn * turn >= COS_GRADIENT**2 * (x * x + y * y)) & (turn != 0.0)
            if i > 0:
                agrees &= side * turn >= 0.0
            elif not all(missing):
                agrees &= (turn < 0.0) == (opposite if missing[0] else ~opposite)
            points, normal, opposite = (some.compress(agrees, axis=-1) for some in (points, normal, opposite))
            side = turn.compress(agrees)
        for polarity, good in enumerate(((side < 0.0) == opposite, (side < 0.0) != opposite)):
            pieces[polarity].append(points.compress(good, axis=1).T[: missing[polarity]])
            missing[polarity] -= len(pieces[polarity][-1])
        if not any(missing):
            break
    return np.concatenate(pieces[0]), np.concatenate(pieces[1])


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of vectors (3, n), shape (n,)."""
    product = a[0] * b[0]
    product += a[1] * b[1]
    product += a[2] * b[2]
    return product


def _votes(subset: EdgePoints, axes: FloatArray, cosines: FloatArray, bright_inside: bool) -> IndexArray:
    """Return how many points of a subset support each of the cones (k, 3), shape (k,)."""
    # Triples of whole-pixel points predict the far end of an arc poorly: twice the tolerance here.
    cones = _Cones.of(axes, cosines, subset.shape, 2.0)
    votes = np.zeros(len(axes), dtype=np.int64)
    at_once = max(1, PLACES_AT_ONCE // len(subset.uv))
    for start in range(0, len(axes), at_once):
        some = slice(start, start + at_once)
        votes[some] = np.count_nonzero(cones.take(some).hits(subset.planes, bright_inside), axis=1)
    return votes


def _improved(sight: EdgePoints, cones: Iterable[tuple[FloatArray, float, bool]]) -> Iterable[Candidate]:
    """Refit cones to their supporters until they no longer change, narrowing the tolerance from 2 to 1.

    A cone that comes to where another one was is left out: both would end as the same.
    """
    passed: set[tuple[int, bool, bytes]] = set()
    for axis, cosine, bright_inside in cones:
        before = np.empty(0, dtype=bool)
        for step, slack in enumerate((*SLACKS, 1.0)):
            supports = support(sight, axis, cosine, bright_inside, slack)
            rows = np.flatnonzero(supports)
            if len(rows) < 5:
                break
            # The same supporters give the same cone, and this the same supporters.
            if step == len(SLACKS) or (slack == SLACKS[step - 1] and np.array_equal(supports, before)):
                rows = rows[arc_order(sight.los_cam[rows], axis)]
                yield Candidate(axis, cosine, bright_inside, rows, unbroken_px(sight.uv[rows]))
                break
            cone = fit_cone(sight.los_cam[rows])
            # A nearly straight arc may flip its convex side while it is refitted: polarity flips with it.
            if cone.axis_cam @ axis < 0 and abs(cone.cos_rho) + abs(cosine) < 0.5:
                bright_inside = not bright_inside
            axis, cosine, before = cone.axis_cam, cone.cos_rho, supports
            place = (step, bright_inside, np.packbits(supports).tobytes())
            if place in passed:
                break
            passed.add(place)


def unbroken_px(uv: FloatArray) -> float:
    """Return the length [px] along which points in arc order follow each other without a gap (the arc may close)."""
    gaps = np.hypot(*(np.roll(uv, -1, axis=0) - uv).T)
    return float(gaps[gaps <= GAP_PX].sum())


def _same(one: Candidate, other: Candidate) -> bool:
    """Whether two cones share most supporters."""
    if one.bright_inside != other.bright_inside:
        return False
    shared = np.intersect1d(one.rows, other.rows, assume_unique=True).size
    return shared > 0.7 * min(len(one.rows), len(other.rows))
