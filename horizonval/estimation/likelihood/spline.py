r"""A cubic spline through places of an axis, as weights of the values there.

With the values ``f`` and slopes ``s`` at two places ``h`` apart, and ``t`` from 0 to 1 between them::

    p = (1 + 2 t) (1 - t)^2 f_i + t^2 (3 - 2 t) f_i+1 + h t (1 - t)^2 s_i - h t^2 (1 - t) s_i+1

Slopes make the second derivative steady, which is a set of linear equations, so that ``s = S f`` and ``p = w . f``. At
an end of the axis the slope is 0 where it is asked to be, and else that of the parabola through three places.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray


def slopes(axis: FloatArray, level: tuple[bool, bool]) -> FloatArray:
    """Return what makes slopes of values at the places of an axis, shape (n, n).

    Parameters
    ----------
    axis : ndarray, shape (n,)
        Rising.
    level : tuple of bool
        Whether the slope is 0 at the first place and at the last.
    """
    n = len(axis)
    if n == 1:
        return np.zeros((1, 1))
    step = np.diff(axis)
    chord = (np.eye(n)[1:] - np.eye(n)[:-1]) / step[:, None]
    left, right = np.eye(n), np.zeros((n, n))
    for i in range(1, n - 1):
        left[i, i - 1 : i + 2] = step[i], 2.0 * (step[i - 1] + step[i]), step[i - 1]
        right[i] = 3.0 * (step[i] * chord[i - 1] + step[i - 1] * chord[i])
    for end, first, second in ((0, 0, 1), (-1, -1, -2)):
        if level[end]:
            continue
        bend = 0.0 if n == 2 else step[first] / (step[first] + step[second]) * (chord[first] - chord[second])
        right[end] = chord[first] + bend
    return np.asarray(np.linalg.solve(left, right))


def spline_weights(axis: FloatArray, slope: FloatArray, x: FloatArray) -> FloatArray:
    """Return what the values at the places of an axis (n,) count for at x (m,), shape (m, n); ends hold.

    ``slope`` is what :func:`slopes` makes of the axis.
    """
    if len(axis) == 1:
        return np.ones((len(x), 1))
    i = np.clip(np.searchsorted(axis, x, side="right") - 1, 0, len(axis) - 2)
    h = axis[i + 1] - axis[i]
    t = np.clip((x - axis[i]) / h, 0.0, 1.0)
    weights = (h * t * (1.0 - t) ** 2)[:, None] * slope[i] - (h * t**2 * (1.0 - t))[:, None] * slope[i + 1]
    place = np.arange(len(x))
    weights[place, i] += (1.0 + 2.0 * t) * (1.0 - t) ** 2
    weights[place, i + 1] += t**2 * (3.0 - 2.0 * t)
    return np.asarray(weights)
