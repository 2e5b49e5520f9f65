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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.edges import Edges
from horizonval.estimation.limb.shape.cone import arc_order
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.cone import cones_through, fit_cone

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
    los = unproject(camera, edges.uv)
    step = np.array([[0.5, 0.0], [0.0, 0.5]])
    jacobian = np.stack(
        [unproject(camera, edges.uv + step[i]) - unproject(camera, edges.uv - step[i]) for i in (0, 1)], axis=-1
    )
    good = np.isfinite(los).all(axis=1) & np.isfinite(jacobian).all(axis=(1, 2))
    return EdgePoints(edges.uv[good], edges.gradient[good], los[good], jacobian[good], edges.quiet[good], shape)


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
    found: list[Candidate] = []
    for axis, cosine, bright_inside in _draw(sight, pool, rng):
        candidate = _improve(sight, axis, cosine, bright_inside)
        if candidate is not None and not any(_same(candidate, other) for other in found):
            found.append(candidate)
    return sorted(found, key=lambda c: -c.arc_px)


def support(
    sight: EdgePoints, axis: FloatArray, cosine: float, bright_inside: bool, slack: float = 1.0
) -> NDArray[np.bool_]:
    """Return which points support a cone (see the module text); ``slack`` widens or narrows the tolerance."""
    off_px, turn = _residuals(sight, axis[:, None], np.array([cosine]))
    sign = 1.0 if bright_inside else -1.0
    tolerance = slack * _tolerance_px(sight, np.array([cosine]), axis[:, None])
    return np.asarray((np.abs(off_px) <= tolerance) & (sign * turn >= COS_GRADIENT))[:, 0]


def off_limb_px(sight: EdgePoints, axis: FloatArray, cosine: float) -> FloatArray:
    """Return how far each point lies inside (positive) a cone's limb [px], to first order."""
    return _residuals(sight, axis[:, None], np.array([cosine]))[0][:, 0]


def _residuals(sight: EdgePoints, axes: FloatArray, cosines: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return distances from the limb [px] and cosines between gradient and inward normal, (n, k) for axes (3, k)."""
    ex = sight.jacobian[:, :, 0] @ axes
    ey = sight.jacobian[:, :, 1] @ axes
    size = np.hypot(ex, ey)
    size[size == 0] = np.inf
    off = (sight.los_cam @ axes - cosines) / size
    turn = (sight.gradient[:, :1] * ex + sight.gradient[:, 1:] * ey) / size
    return off, turn


def _tolerance_px(sight: EdgePoints, cosines: FloatArray, axes: FloatArray) -> FloatArray:
    sine = np.sqrt(np.clip(1.0 - cosines**2, 0.0, None))
    tangent = sine / np.clip(cosines, 0.17, None)
    px_per_rad = 1.0 / np.linalg.norm(sight.jacobian, axis=(1, 2)) * np.sqrt(2.0)
    relief = LIMB_RELIEF * tangent[None, :] * px_per_rad[:, None]
    largest = max(TOLERANCE_PX, LARGEST_TOLERANCE_SHARE * min(sight.shape))
    return np.minimum(TOLERANCE_PX + relief, largest)


def _draw(sight: EdgePoints, pool: IndexArray, rng: np.random.Generator) -> list[tuple[FloatArray, float, bool]]:
    """Return the ``KEPT`` cones with most support among random triples, of each polarity."""
    triples = pool[rng.integers(0, len(pool), size=(TRIPLES, 3))]
    a, b, c = (sight.uv[triples[:, i]] for i in range(3))
    apart = 0.04 * min(sight.shape)
    far = np.minimum(np.minimum(np.hypot(*(a - b).T), np.hypot(*(b - c).T)), np.hypot(*(a - c).T)) > apart
    triples = triples[far]
    axes, cosines = cones_through(*(sight.los_cam[triples[:, i]] for i in range(3)))
    # All three gradients must point along the limb's normal, to the same side of it.
    turns = []
    for i in range(3):
        jacobian = sight.jacobian[triples[:, i]]
        normal = np.einsum("nij,ni->nj", jacobian, axes)
        size = np.hypot(normal[:, 0], normal[:, 1])
        turns.append((sight.gradient[triples[:, i]] * normal).sum(axis=1) / np.where(size > 0, size, np.inf))
    turn = np.stack(turns)
    chosen: list[tuple[FloatArray, float, bool]] = []
    subset = sight.take(pool if len(pool) <= SUBSET else rng.permutation(pool)[:SUBSET])
    for bright_inside in (True, False):
        sign = 1.0 if bright_inside else -1.0
        good = np.flatnonzero((sign * turn >= COS_GRADIENT).all(axis=0))[:TRIED]
        if not good.size:
            continue
        off, subset_turn = _residuals(subset, axes[good].T, cosines[good])
        # Triples of whole-pixel points predict the far end of an arc poorly: twice the tolerance here.
        hit = (np.abs(off) <= 2 * _tolerance_px(subset, cosines[good], axes[good].T)) & (
            sign * subset_turn >= COS_GRADIENT
        )
        votes = hit.sum(axis=0)
        for k in np.argsort(-votes, kind="stable")[:KEPT]:
            chosen.append((axes[good[k]], float(cosines[good[k]]), bright_inside))
    return chosen


def _improve(sight: EdgePoints, axis: FloatArray, cosine: float, bright_inside: bool) -> Candidate | None:
    """Refit a cone to its supporters until they no longer change, narrowing the tolerance from 2 to 1."""
    rows = np.empty(0, dtype=np.int64)
    for slack in (2.0, 1.5, 1.0, 1.0, 1.0):
        rows = np.flatnonzero(support(sight, axis, cosine, bright_inside, slack))
        if len(rows) < 5:
            return None
        cone = fit_cone(sight.los_cam[rows])
        # A nearly straight arc may flip its convex side while it is refitted: polarity flips with it.
        if cone.axis_cam @ axis < 0 and abs(cone.cos_rho) + abs(cosine) < 0.5:
            bright_inside = not bright_inside
        axis, cosine = cone.axis_cam, cone.cos_rho
    rows = np.flatnonzero(support(sight, axis, cosine, bright_inside))
    if len(rows) < 5:
        return None
    rows = rows[arc_order(sight.los_cam[rows], axis)]
    return Candidate(axis, cosine, bright_inside, rows, unbroken_px(sight.uv[rows]))


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
