"""How a body was turned, between the quaternions that a file has: one turn at a constant rate from each to the next.

An interval in which the body turns by more than 90 deg is a gap: which way round it went is not told. So is one ten
times as long as most, if the body turns by more than 5 deg in it. No attitude in a gap is flown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.motion.axes import Axes, gcrs_from
from horizonval.formats.motion.coverage import Coverage, coverage_of, together

LONGEST_OFF = 1e-3
"""Of a unit quaternion's length, by how much a file's may be off: four digits are written at least."""
LARGEST_TURN = math.radians(90.0)
GAP_STEPS, GAP_TURN = 10.0, math.radians(5.0)


@dataclass(frozen=True)
class AttitudePiece:
    """Attitudes at ``seconds`` (m,) after the history's epoch; ``q_body_from_axes`` (m, 4), scalar last."""

    seconds: FloatArray
    q_body_from_axes: FloatArray
    coverage: Coverage


@dataclass(frozen=True)
class AttitudeHistory:
    """How a body was turned against ``axes``; ``where`` names the file for messages. Pieces do not know each other."""

    epoch_utc: datetime
    pieces: tuple[AttitudePiece, ...]
    axes: Axes
    where: str

    @cached_property
    def coverage(self) -> Coverage:
        """The times that may be asked for."""
        return together([piece.coverage for piece in self.pieces])

    def body_from_gcrs(self, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
        """Return matrices, shape (n, 3, 3), at times (n,) after another epoch.

        Raises
        ------
        UserError
            A time outside all pieces, or in a gap.
        """
        t = np.asarray(seconds, dtype=np.float64) + (epoch_utc - self.epoch_utc).total_seconds()
        matrices = np.full((len(t), 3, 3), np.nan)
        for piece in self.pieces:
            inside = np.isfinite(piece.coverage.around(t)[0])
            if inside.any():
                turns = Slerp(piece.seconds, Rotation.from_quat(piece.q_body_from_axes))
                matrices[inside] = turns(np.clip(t[inside], piece.seconds[0], piece.seconds[-1])).as_matrix()
        if np.isnan(matrices).any():
            first = float(t[int(np.flatnonzero(np.isnan(matrices[:, 0, 0]))[0])])
            known = zip(self.coverage.begins, self.coverage.ends, strict=True)
            spans = [f"{self._time(begin)} to {self._time(end)}" for begin, end in known]
            more = ", ..." if len(spans) > 3 else ""
            raise UserError(
                f"no attitude for {self._time(first)}", where=self.where, expected=", ".join(spans[:3]) + more
            )
        return np.asarray(matrices @ np.swapaxes(gcrs_from(self.axes, self.epoch_utc, t), -1, -2))

    def around(self, epoch_utc: datetime, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return begin and end, shape (n,) each, of the spans that times after another epoch lie in; NaN outside."""
        offset = (epoch_utc - self.epoch_utc).total_seconds()
        lo, hi = self.coverage.around(seconds + offset)
        return lo - offset, hi - offset

    def _time(self, seconds: float) -> str:
        return (self.epoch_utc + timedelta(seconds=float(seconds))).isoformat()


def attitudes_of(
    seconds: FloatArray, q_body_from_axes: FloatArray, where: str, usable_s: tuple[float, float] | None = None
) -> AttitudePiece:
    """Return a piece, or a :class:`UserError` for what is no history of attitudes."""
    if len(seconds) < 2:
        raise UserError(f"{len(seconds)} attitudes", where=where, expected="2 and more")
    steps = np.diff(seconds)
    if (steps <= 0.0).any():
        number = int(np.flatnonzero(steps <= 0.0)[0]) + 2
        raise UserError(f"attitude {number} is not after the one before", where=where, expected="rising times")
    length = np.linalg.norm(q_body_from_axes, axis=1)
    off = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[off] - 1.0) > LONGEST_OFF:
        raise UserError(
            f"quaternion {off + 1} has the length {length[off]:.6g}", where=where, expected="unit quaternions"
        )
    return AttitudePiece(seconds, q_body_from_axes, coverage_of(seconds, _gaps(steps, q_body_from_axes), usable_s))


def _gaps(steps: FloatArray, q: FloatArray) -> NDArray[np.bool_]:
    """Return whether each interval, shape (m - 1,), is one between whose ends nothing is known."""
    turns = Rotation.from_quat(q)
    angle = (turns[1:] * turns[:-1].inv()).magnitude()
    long = steps > GAP_STEPS * float(np.median(steps))
    return np.asarray((angle > LARGEST_TURN) | (long & (angle > GAP_TURN)))
