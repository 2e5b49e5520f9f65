"""The point nearest to two lines of sight.

From the stations ``L1``, ``L2`` along unit vectors ``r1``, ``r2`` (Hadinejad & Amiri 2020)::

    [r1  -r2] [d1  d2]^T = L2 - L1,      X = (A^T A)^-1 A^T B,      R = (L1 + L2 + [r1  r2] X) / 2

three equations, two distances; the answer is the middle of the shortest line between the two lines of sight. The
least squares give both directions the same weight *in metres*, so the farther station's error counts as much as the
nearer one's.

To first order, for a small change ``dA`` of the directions,
``dX = (A^T A)^-1 (dA^T (B - A X) - A^T dA X)``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.systems.e.localisation.stations import Station


def triangulate(
    r1_itrs: ArrayLike, r2_itrs: ArrayLike, u1_itrs: ArrayLike, u2_itrs: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the point between two lines, the two distances, and by how much the lines miss each other.

    Parameters
    ----------
    r1_itrs, r2_itrs : array_like, shape (3,)
        Stations [m].
    u1_itrs, u2_itrs : array_like, shape (..., 3)
        Unit directions; not parallel (then the numbers are large and mean nothing).

    Returns
    -------
    r_itrs : ndarray, shape (..., 3)
        [m]
    distances : ndarray, shape (..., 2)
        Along the two lines [m].
    miss : ndarray, shape (...)
        Length of the shortest line between them [m].
    """
    l1, l2 = np.asarray(r1_itrs, float), np.asarray(r2_itrs, float)
    u1, u2 = np.broadcast_arrays(np.asarray(u1_itrs, float), np.asarray(u2_itrs, float))
    a = np.stack([u1, -u2], axis=-1)
    x = _solve(a, np.einsum("...ij,i->...j", a, l2 - l1))
    p1, p2 = l1 + x[..., :1] * u1, l2 + x[..., 1:] * u2
    return 0.5 * (p1 + p2), x, np.linalg.norm(p1 - p2, axis=-1)


def triangulate_with_partials(
    stations: tuple[Station, Station], angles_rad: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return positions [m], shape (..., 3), and derivatives by the angles [m/rad], shape (..., 3, 4), Earth-fixed.

    Parameters
    ----------
    stations : two stations
    angles_rad : array_like, shape (..., 4)
        Azimuth and elevation of the first, then of the second station.
    """
    both = np.asarray(angles_rad, float)
    angles = (both[..., :2], both[..., 2:])
    station1, station2 = stations
    u1, u2 = (s.directions_itrs(a[..., 0], a[..., 1]) for s, a in zip(stations, angles, strict=True))
    r, x, _ = triangulate(station1.r_itrs, station2.r_itrs, u1, u2)
    a = np.stack([u1, -u2], axis=-1)
    rest = (station2.r_itrs - station1.r_itrs) - np.einsum("...ij,...j->...i", a, x)
    columns = []
    for i, (station, angle) in enumerate(zip(stations, angles, strict=True)):
        for du in _partials(station, angle):
            da = np.zeros_like(a)
            da[..., i] = du if i == 0 else -du
            dx = _solve(
                a,
                np.einsum("...ij,...i->...j", da, rest)
                - np.einsum("...ij,...i->...j", a, np.einsum("...ij,...j->...i", da, x)),
            )
            columns.append(0.5 * (u1 * dx[..., :1] + u2 * dx[..., 1:] + du * x[..., i, None]))
    return r, np.stack(columns, axis=-1)


def _solve(a: FloatArray, right: FloatArray) -> FloatArray:
    """Return ``(A^T A)^-1 right``: the diagonal of ``A^T A`` is 1 for unit directions."""
    c = np.einsum("...i,...i->...", a[..., 0], a[..., 1])
    # 1 - c^2 from the cross product: two stations near each other see almost parallel lines.
    d = np.sum(np.cross(a[..., 0], a[..., 1]) ** 2, axis=-1)
    return np.stack([right[..., 0] - c * right[..., 1], right[..., 1] - c * right[..., 0]], axis=-1) / d[..., None]


def _partials(station: Station, angles_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the direction by azimuth and by elevation, shape (..., 3) each."""
    sa, ca = np.sin(angles_rad[..., 0]), np.cos(angles_rad[..., 0])
    se, ce = np.sin(angles_rad[..., 1]), np.cos(angles_rad[..., 1])
    by_azimuth = np.stack([ce * ca, -ce * sa, np.zeros_like(sa)], axis=-1)
    by_elevation = np.stack([-se * sa, -se * ca, ce], axis=-1)
    m = station.itrs_from_enu.T
    return by_azimuth @ m, by_elevation @ m
