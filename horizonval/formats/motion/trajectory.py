r"""A satellite's states between those that a file has: the polynomial through the nearest of them.

With velocities it is Hermite's through the four nearest states, of degree 7, else Lagrange's through the eight nearest
positions, whose derivative is the velocity. Of a circular orbit of 6 928 km, states a minute apart are met between them
to 0.1 um with velocities and to 40 um without. Of states five minutes apart the first are off by 7 mm in the middle of
a piece and 2 cm at its ends, the second by 1 m and 12 m.
Pieces do not know each other: a manoeuvre lies between two.

An interval in which the polynomial may be more than 100 m off is a gap, and no place in it is flown. How far it may be
off is told by the remainder of interpolation for a circular orbit: in low orbit the largest steps are 16 minutes with
velocities and 8 without, and near the ends of a piece, where states stand to one side only, 14 and 6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import KroghInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.motion.coverage import Coverage, coverage_of, together
from horizonval.geometry.orbit import GM_M3_PER_S2

WITH_VELOCITY, WITHOUT = 4, 8
"""Nearest states that a polynomial goes through."""
FEWEST = 2
LARGEST_OFF_M = 100.0
"""Three arc seconds of the way round the Earth, in low orbit."""


@dataclass(frozen=True)
class TrajectoryPiece:
    """States without a manoeuvre between them.

    ``seconds`` after the trajectory's epoch, shape (m,), rising; ``r_gcrs`` [m] and ``v_gcrs`` [m/s], shape (m, 3).
    ``coverage``: the times that may be asked for.
    """

    seconds: FloatArray
    r_gcrs: FloatArray
    v_gcrs: FloatArray | None
    coverage: Coverage


@dataclass(frozen=True)
class Trajectory:
    """Where a satellite is; ``where`` names the file for messages."""

    epoch_utc: datetime
    pieces: tuple[TrajectoryPiece, ...]
    where: str

    @cached_property
    def coverage(self) -> Coverage:
        """The times that may be asked for."""
        return together([piece.coverage for piece in self.pieces])

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last time that may be asked for."""
        if not len(self.coverage.begins):
            raise UserError("no state that may be used", where=self.where, expected="states in the usable span")
        return float(self.coverage.begins[0]), float(self.coverage.ends[-1])

    def states(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions [m] and velocities [m/s] in ``gcrs``, shape (n, 3) each, at times (n,) after the epoch.

        Raises
        ------
        UserError
            A time outside all pieces, or in a gap.
        """
        t = np.asarray(seconds, dtype=np.float64)
        r, v = np.full((len(t), 3), np.nan), np.full((len(t), 3), np.nan)
        for piece in self.pieces:
            inside = np.isfinite(piece.coverage.around(t)[0])
            if inside.any():
                r[inside], v[inside] = _between(piece, t[inside])
        if np.isnan(r).any():
            first = float(t[int(np.flatnonzero(np.isnan(r[:, 0]))[0])])
            known = zip(self.coverage.begins, self.coverage.ends, strict=True)
            spans = [f"{self._time(begin)} to {self._time(end)}" for begin, end in known]
            more = ", ..." if len(spans) > 3 else ""
            raise UserError(f"no state for {self._time(first)}", where=self.where, expected=", ".join(spans[:3]) + more)
        return r, v

    def _time(self, seconds: float) -> str:
        return (self.epoch_utc + timedelta(seconds=float(seconds))).isoformat()


def piece_of(
    seconds: FloatArray,
    r_gcrs: FloatArray,
    v_gcrs: FloatArray | None,
    where: str,
    usable_s: tuple[float, float] | None = None,
) -> TrajectoryPiece:
    """Return a piece, or a :class:`UserError` where its states are no way round the Earth.

    States outside ``usable_s`` are interpolated through, and not flown.
    """
    if len(seconds) < FEWEST:
        raise UserError(f"{len(seconds)} states", where=where, expected=f"{FEWEST} and more")
    steps = np.diff(seconds)
    if (steps <= 0.0).any():
        number = int(np.flatnonzero(steps <= 0.0)[0]) + 2
        raise UserError(f"state {number} is not after the one before", where=where, expected="rising times")
    distance_km = np.linalg.norm(r_gcrs, axis=1) / 1e3
    if distance_km.min() < 6200.0:
        number = int(np.argmin(distance_km)) + 1
        raise UserError(
            f"state {number} is {distance_km[number - 1]:.6g} km from the Earth's centre",
            where=where,
            expected="a place above the ground; are these kilometres?",
        )
    gaps = _gaps(seconds, r_gcrs, v_gcrs is not None)
    return TrajectoryPiece(seconds, r_gcrs, v_gcrs, coverage_of(seconds, gaps, usable_s))


def _nodes(total: int, interval: NDArray[np.intp], with_velocity: bool) -> tuple[int, NDArray[np.intp]]:
    """Return how many states the polynomials of intervals go through, and the first of them."""
    count = min(WITH_VELOCITY if with_velocity else WITHOUT, total)
    return count, np.clip(interval - (count // 2 - 1), 0, total - count)


def _gaps(seconds: FloatArray, r_gcrs: FloatArray, with_velocity: bool) -> NDArray[np.bool_]:
    """Return whether the polynomial of each interval, shape (m - 1,), may be too far off.

    A circle of radius R and rate w has n-th derivatives of R w^n, so that the remainder of a polynomial through n
    values is ``R prod|w (t - t_i)| / n!``, here at the middle. The rate is that of a circular orbit as high.
    """
    interval = np.arange(len(seconds) - 1)
    count, first = _nodes(len(seconds), interval, with_velocity)
    middle = (seconds[1:] + seconds[:-1]) / 2.0
    lowest = np.minimum(np.linalg.norm(r_gcrs[1:], axis=1), np.linalg.norm(r_gcrs[:-1], axis=1))
    rate = np.sqrt(GM_M3_PER_S2 / lowest**3)
    turns = np.abs(rate[:, None] * (middle[:, None] - seconds[first[:, None] + np.arange(count)]))
    values = 2 if with_velocity else 1
    off = lowest * np.prod(turns, axis=1) ** values / math.factorial(values * count)
    return np.asarray(off > LARGEST_OFF_M)


def _between(piece: TrajectoryPiece, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the states at times (n,) within a piece: those between the same two states by one polynomial."""
    interval = np.clip(np.searchsorted(piece.seconds, t, side="right") - 1, 0, len(piece.seconds) - 2)
    count, first = _nodes(len(piece.seconds), interval, piece.v_gcrs is not None)
    r, v = np.empty((len(t), 3)), np.empty((len(t), 3))
    for start in np.unique(first):
        here = first == start
        rows = slice(int(start), int(start) + count)
        origin, scale = piece.seconds[rows][0], float(np.ptp(piece.seconds[rows]))
        x = (piece.seconds[rows] - origin) / scale
        if piece.v_gcrs is None:
            polynomial = KroghInterpolator(x, piece.r_gcrs[rows])
        else:
            # A node that stands twice has its derivative as the second value.
            values = np.stack([piece.r_gcrs[rows], scale * piece.v_gcrs[rows]], axis=1).reshape(-1, 3)
            polynomial = KroghInterpolator(np.repeat(x, 2), values)
        at = (t[here] - origin) / scale
        r[here], v[here] = polynomial.derivatives(at, der=2)[:2] / np.array([1.0, scale])[:, None, None]
    return r, v
