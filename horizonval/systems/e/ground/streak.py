"""The image of a point that moves during the exposure.

With a Gaussian point spread of standard deviation s, a point of unit light at (x, y) puts into pixel (i, j) ::

    P(i, j) = D(i - x) D(j - y),     D(t) = [erf((t + 1/2) / s sqrt 2) - erf((t - 1/2) / s sqrt 2)] / 2

which is exact over the pixel's area and adds up to 1. Along its path the point is integrated by Gauss's rule, finely
enough that the rule's error is below rounding; the sum over nodes of products is one product of two matrices.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from horizonval.core.arrays import FloatArray


def points_image(
    uv: ArrayLike, light: ArrayLike, sigma_px: float, shape: tuple[int, int], origin_uv: tuple[float, float] = (0, 0)
) -> FloatArray:
    """Return the image of points, shape (H, W).

    Parameters
    ----------
    uv : array_like, shape (n, 2)
        Column and row; integers are pixel centres.
    light : array_like, shape (n,)
        What each point adds to the whole image plane.
    sigma_px : float
    shape : (H, W)
    origin_uv : (float, float)
        Column and row of the image's first pixel.
    """
    place = np.asarray(uv, float).reshape(-1, 2)
    scale = sigma_px * np.sqrt(2.0)

    def share(centre: FloatArray, count: int, first: float) -> FloatArray:
        edges = first + np.arange(count + 1) - 0.5
        return np.asarray(0.5 * np.diff(erf((edges - centre[:, None]) / scale), axis=1))

    across = share(place[:, 0], shape[1], origin_uv[0]) * np.asarray(light, float)[:, None]
    return np.asarray(share(place[:, 1], shape[0], origin_uv[1]).T @ across)


def path_nodes(ends_uv: ArrayLike, sigma_px: float) -> tuple[FloatArray, FloatArray]:
    """Return times in [0, 1] and weights of the rule for a path from ``ends_uv[0]`` to ``ends_uv[-1]``, shape (n,)."""
    ends = np.asarray(ends_uv, float)
    length = float(np.hypot(*(ends[-1] - ends[0])))
    x, w = np.polynomial.legendre.leggauss(8 + int(2.0 * length / sigma_px))
    return 0.5 * (x + 1.0), 0.5 * w


def streak_image(
    path_uv: ArrayLike,
    light: float,
    sigma_px: float,
    shape: tuple[int, int],
    origin_uv: tuple[float, float] = (0, 0),
) -> FloatArray:
    """Return the image of a point that was at ``path_uv[0]``, ``[1]``, ``[2]`` at begin, middle and end, shape (H, W).

    Between them it moves along the parabola through the three places; two places are a straight line. ``light`` is what
    it adds to the whole image plane, spread evenly over time.
    """
    path = np.asarray(path_uv, float)
    t, w = path_nodes(path, sigma_px)
    if len(path) == 2:
        uv = path[0] + t[:, None] * (path[1] - path[0])
    else:
        begin, middle, end = (2 * t - 1) * (t - 1), 4 * t * (1 - t), t * (2 * t - 1)
        uv = np.stack([begin, middle, end], axis=1) @ path
    return points_image(uv, light * w, sigma_px, shape, origin_uv)
