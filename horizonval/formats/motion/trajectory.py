r"""A satellite's states between those that a file has: the polynomial through the nearest of them.

With velocities it is Hermite's through the four nearest states, of degree 7, else Lagrange's through the eight nearest
positions, whose derivative is the velocity. Of a circular orbit of 6 928 km, states a minute apart are met between them
to 0.1 um with velocities and to 40 um without. Of states five minutes apart the first are off by 7 mm in the middle of
a piece and 2 cm at its ends, the second by 1 m and 12 m.
Pieces do not know each other: a manoeuvre lies between two.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from scipy.interpolate import KroghInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError

WITH_VELOCITY, WITHOUT = 4, 8
"""Nearest states that a polynomial goes through."""
FEWEST = 2
ROUNDING_S = 1e-6
"""Times are whole microseconds."""


@dataclass(frozen=True)
class TrajectoryPiece:
    """States without a manoeuvre between them.

    ``seconds`` after the trajectory's epoch, shape (m,), rising; ``r_gcrs`` [m] and ``v_gcrs`` [m/s], shape (m, 3).
    """

    seconds: FloatArray
    r_gcrs: FloatArray
    v_gcrs: FloatArray | None


@dataclass(frozen=True)
class Trajectory:
    """Where a satellite is; ``where`` names the file for messages."""

    epoch_utc: datetime
    pieces: tuple[TrajectoryPiece, ...]
    where: str

    @property
    def span_s(self) -> tuple[float, float]:
        """Times of the first and the last state."""
        return float(self.pieces[0].seconds[0]), float(self.pieces[-1].seconds[-1])

    def states(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions [m] and velocities [m/s] in ``gcrs``, shape (n, 3) each, at times (n,) after the epoch.

        Raises
        ------
        UserError
            A time outside all pieces.
        """
        t = np.asarray(seconds, dtype=np.float64)
        r, v = np.full((len(t), 3), np.nan), np.full((len(t), 3), np.nan)
        for piece in self.pieces:
            inside = (t >= piece.seconds[0] - ROUNDING_S) & (t <= piece.seconds[-1] + ROUNDING_S)
            if inside.any():
                r[inside], v[inside] = _between(piece, t[inside])
        if np.isnan(r).any():
            first = float(t[int(np.flatnonzero(np.isnan(r[:, 0]))[0])])
            spans = [f"{self._time(p.seconds[0])} to {self._time(p.seconds[-1])}" for p in self.pieces[:3]]
            raise UserError(f"no state for {self._time(first)}", where=self.where, expected=", ".join(spans))
        return r, v

    def _time(self, seconds: float) -> str:
        return (self.epoch_utc + timedelta(seconds=float(seconds))).isoformat()


def piece_of(seconds: FloatArray, r_gcrs: FloatArray, v_gcrs: FloatArray | None, where: str) -> TrajectoryPiece:
    """Return a piece, or a :class:`UserError` where its states are no way round the Earth."""
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
    return TrajectoryPiece(seconds, r_gcrs, v_gcrs)


def _between(piece: TrajectoryPiece, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the states at times (n,) within a piece: those between the same two states by one polynomial."""
    count = min(WITH_VELOCITY if piece.v_gcrs is not None else WITHOUT, len(piece.seconds))
    interval = np.clip(np.searchsorted(piece.seconds, t, side="right") - 1, 0, len(piece.seconds) - 2)
    first = np.clip(interval - (count // 2 - 1), 0, len(piece.seconds) - count)
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
