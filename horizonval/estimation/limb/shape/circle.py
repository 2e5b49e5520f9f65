"""A circle through image points: Taubin's algebraic fit.

A circle is ``a (x^2 + y^2) + b x + c y + d = 0``. The fit minimises the sum of squares of the left side over the sum of
squares of its gradient, which is the distance of the points to first order (Taubin, IEEE Trans. PAMI 13, 1115, 1991).
On centred points with ``z = x^2 + y^2`` the minimum is the smallest singular vector of three columns,
``((z - mean z) / (2 sqrt(mean z)), x, y)``: closed form, no start, and a straight line is only the circle ``a = 0``.

A horizon in an image is a conic, not a circle: see :mod:`horizonval.geometry.horizon` for the curve that it
is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray

STRAIGHT = 1e-9
"""Points of unit spread with less curvature than this have no centre that float64 could tell."""


@dataclass(frozen=True)
class Circle:
    """A circle in an image: ``centre`` (column, row) and ``radius_px``."""

    centre: FloatArray
    radius_px: float

    def distance_px(self, uv: FloatArray) -> FloatArray:
        """Return the distance of points, shape (n, 2), from the circle, positive outside."""
        return np.hypot(*(uv - self.centre).T) - self.radius_px

    def nearest(self, uv: FloatArray) -> FloatArray:
        """Return the points of the circle nearest to given ones, shape (n, 2)."""
        outwards = uv - self.centre
        return self.centre + self.radius_px * outwards / np.hypot(*outwards.T)[:, None]

    def along(self, uv: FloatArray) -> FloatArray:
        """Return the angle [rad] of points about the centre, from the middle of them all."""
        outwards = uv - self.centre
        middle = outwards.mean(axis=0)
        across = middle[0] * outwards[:, 1] - middle[1] * outwards[:, 0]
        return np.arctan2(across, outwards @ middle)


def fit_circle(uv: FloatArray) -> Circle | None:
    """Return the circle through image points, shape (n, 2), n >= 3; None for points on a straight line or in one place.

    Raises
    ------
    ValueError
        With fewer than three points.
    """
    if len(uv) < 3:
        raise ValueError(f"a circle needs three points, not {len(uv)}")
    middle = uv.mean(axis=0)
    scale = float(np.abs(uv - middle).max())
    if scale == 0.0:
        return None
    xy = (uv - middle) / scale
    z = (xy**2).sum(axis=1)
    mean = float(z.mean())
    columns = np.column_stack([(z - mean) / (2.0 * np.sqrt(mean)), xy])
    _, _, rows = np.linalg.svd(columns, full_matrices=False)
    a = rows[2, 0] / (2.0 * np.sqrt(mean))
    if abs(a) < STRAIGHT:
        return None
    centre = -rows[2, 1:] / (2.0 * a)
    radius = float(np.sqrt(centre @ centre + mean))
    return Circle(centre * scale + middle, radius * scale)
