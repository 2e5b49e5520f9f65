"""Cones that may be the limb: through three edge points of one level whose gradients agree.

Edge points are Canny's (IEEE Trans. PAMI 8, 679, 1986) with gradients above the noise. Points with a calm side come
first, since space is calm: mean gradient of the calmer side over their own. Three lines of sight determine a cone
(:mod:`horizonval.geometry.horizon`). Of random triples (Fischler and Bolles, Communications of the ACM 24, 381, 1981)
those are used whose gradients are normal to the cone's limb with the bright side on the same side, and the other points
that agree are counted. Proposals are judged by their likelihood (:mod:`.evidence`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.edges import canny
from horizonval.estimation.limb.picture import FEWEST_POINTS
from horizonval.estimation.limb.pyramid import PyramidLevel
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.horizon import cones_through, fit_cone

MOST_EDGES = 400
"""Largest number of edges, those with the calmest side: a limb across a level of 320 px, and some clouds."""
TRIPLES = 6_000
"""Where a tenth of the edges are the limb's, six of these lie on it wholly."""
COS_GRADIENT = float(np.cos(np.deg2rad(25.0)))
"""Cosine of three standard deviations of a 3 x 3 gradient's direction just above the noise."""
MOST_CONES = 64
"""Largest number of cones whose support is counted; where the limb dominates the edges, most triples lie on it."""
TOLERANCE_PX = 1.5
"""A whole pixel lies up to 0.7 px from a curve, and the curve through three of them as far again."""


@dataclass(frozen=True)
class _Edges:
    """Edge points: lines of sight (n, 3), and how they turn across (n, 3) and along (n, 3) the gradient by a pixel."""

    los: FloatArray
    by_across: FloatArray
    by_along: FloatArray

    def supports(self, axes: FloatArray, cosines: FloatArray, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which of n points agree with k cones that have their bright side inside or not, shape (k, n)."""
        across, along = axes @ self.by_across.T, axes @ self.by_along.T
        slope = np.sqrt(across * across + along * along)
        near = np.abs(axes @ self.los.T - cosines[:, None]) <= TOLERANCE_PX * slope
        return np.asarray(near & (np.abs(across) >= COS_GRADIENT * slope) & ((across > 0.0) == inside[:, None]))


def propose(level: PyramidLevel, camera: CameraModel, largest_rho_rad: float) -> Iterator[tuple[FloatArray, float]]:
    """Yield axes and half-angles of the cones that most edge points of a level agree with.

    ``camera``: of the picture.
    """
    uv, gradient = edge_points(level)
    edges = _sights(uv * level.scale, gradient, camera, level.scale)
    n = len(edges.los)
    if n < FEWEST_POINTS:
        return
    rng = np.random.default_rng(np.random.SeedSequence(n))
    axes, cosines, inside = _agreeing(edges, rng.integers(0, n, size=(TRIPLES, 3)), largest_rho_rad)
    supports = edges.supports(axes, cosines, inside)
    taken = np.zeros(n, dtype=bool)
    # Four cones a level: another level shows what one does not.
    for _ in range(4 if len(axes) else 0):
        votes = np.count_nonzero(supports & ~taken, axis=1)
        best = int(np.argmax(votes))
        if votes[best] < FEWEST_POINTS:
            break
        support, axis, cosine = supports[best], axes[best], cosines[best]
        taken |= support
        cone = fit_cone(edges.los[support])
        again = edges.supports(cone.axis_cam[None], np.array([cone.cos_rho]), inside[best : best + 1])[0]
        if np.count_nonzero(again) >= np.count_nonzero(support):
            support, axis, cosine = again, cone.axis_cam, cone.cos_rho
        taken |= support
        sine = np.linalg.norm(np.cross(edges.los[support], axis), axis=1).mean()
        yield axis, float(np.arctan2(sine, cosine))


def _agreeing(
    edges: _Edges, triples: NDArray[np.int64], largest_rho_rad: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the first cones through triples (t, 3) of edges that agree: axes, cosines, bright side inside."""
    batches: list[tuple[FloatArray, FloatArray, NDArray[np.bool_]]] = []
    found = 0
    # Where a quarter of the triples and more agree, the first part of them gives all that are needed.
    for some in np.split(triples, [4 * MOST_CONES, 20 * MOST_CONES]):
        axes, cosines = cones_through(*np.moveaxis(edges.los[some], 1, 0))
        across = np.einsum("ij,ikj->ik", axes, edges.by_across[some])
        along = np.einsum("ij,ikj->ik", axes, edges.by_along[some])
        inside = across > 0.0
        good = (across * across >= COS_GRADIENT**2 * (across * across + along * along)).all(axis=1)
        good &= axes.any(axis=1) & (cosines > np.cos(largest_rho_rad)) & (inside == inside[:, :1]).all(axis=1)
        rows = np.flatnonzero(good)[: MOST_CONES - found]
        batches.append((axes[rows], cosines[rows], inside[rows, 0]))
        found += len(rows)
        if found == MOST_CONES:
            break
    axes, cosines, inside = (np.concatenate(parts) for parts in zip(*batches, strict=True))
    return axes, cosines, inside


def edge_points(level: PyramidLevel) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) and unit gradients (n, 2) of a level's edges, those with a calm side."""
    mask, dx, dy = canny(level.grey, level.noise)
    strength = cv2.magnitude(dx, dy)
    if level.known is not None:
        mask[cv2.erode(level.known.view(np.uint8), np.ones((5, 5))) == 0] = 0
    rows, columns = np.nonzero(mask)
    gradient = np.column_stack([dx[rows, columns], dy[rows, columns]]).astype(np.float64)
    own = strength[rows, columns].astype(np.float64)
    gradient /= np.maximum(own, 1e-300)[:, None]
    uv = np.column_stack([columns, rows]).astype(np.float64)
    if len(uv) <= MOST_EDGES:
        return uv, gradient
    # The calmer of two squares of five pixels whose middles are four pixels to either side.
    activity = cv2.blur(strength, (5, 5))
    sides = np.rint(uv + 4.0 * np.array([-1.0, 1.0])[:, None, None] * gradient).astype(np.intp)
    column, row = np.moveaxis(np.clip(sides, 0, np.array(activity.shape[::-1]) - 1), -1, 0)
    calm = activity[row, column].min(axis=0)
    order = np.argsort((calm + 1.0) / own, kind="stable")[:MOST_EDGES]
    return uv[order], gradient[order]


def _sights(uv: FloatArray, gradient: FloatArray, camera: CameraModel, scale: float) -> _Edges:
    turned = np.column_stack([-gradient[:, 1], gradient[:, 0]])
    steps = 0.5 * scale * np.array([np.zeros_like(uv), gradient, -gradient, turned, -turned])
    los, inner, outer, left, right = unproject(camera, uv + steps)
    across, along = inner - outer, left - right
    good = np.isfinite(los).all(axis=1) & np.isfinite(across).all(axis=1) & np.isfinite(along).all(axis=1)
    return _Edges(los[good], across[good], along[good])
