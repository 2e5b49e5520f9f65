"""How a body was turned, between the quaternions that a file has: one turn at a constant rate from each to the next."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.motion.axes import Axes, gcrs_from

LONGEST_OFF = 1e-3
"""Of a unit quaternion's length, by how much a file's may be off: four digits are written at least."""
ROUNDING_S = 1e-6


@dataclass(frozen=True)
class AttitudeHistory:
    """Attitudes in ``axes`` at ``seconds`` (m,) after an epoch; ``q_body_from_axes`` (m, 4), scalar last."""

    epoch_utc: datetime
    seconds: FloatArray
    q_body_from_axes: FloatArray
    axes: Axes
    where: str

    def __post_init__(self) -> None:
        if len(self.seconds) < 2:
            raise UserError(f"{len(self.seconds)} attitudes", where=self.where, expected="2 and more")
        steps = np.diff(self.seconds)
        if (steps <= 0.0).any():
            number = int(np.flatnonzero(steps <= 0.0)[0]) + 2
            raise UserError(f"attitude {number} is not after the one before", where=self.where, expected="rising times")
        length = np.linalg.norm(self.q_body_from_axes, axis=1)
        off = int(np.argmax(np.abs(length - 1.0)))
        if abs(length[off] - 1.0) > LONGEST_OFF:
            raise UserError(
                f"quaternion {off + 1} has the length {length[off]:.6g}", where=self.where, expected="unit quaternions"
            )

    def body_from_gcrs(self, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
        """Return matrices, shape (n, 3, 3), at times (n,) after another epoch; just outside the span its end.

        Raises
        ------
        UserError
            A time more than a second outside.
        """
        t = np.asarray(seconds, dtype=np.float64) + (epoch_utc - self.epoch_utc).total_seconds()
        first, last = float(self.seconds[0]), float(self.seconds[-1])
        # Rates are differences over a tenth of a second, which may reach beyond an end.
        outside = (t < first - 1.0) | (t > last + 1.0)
        if outside.any():
            when = self.epoch_utc + timedelta(seconds=float(t[int(np.flatnonzero(outside)[0])]))
            ends = [(self.epoch_utc + timedelta(seconds=s)).isoformat() for s in (first, last)]
            raise UserError(f"no attitude for {when.isoformat()}", where=self.where, expected=" to ".join(ends))
        turns = Slerp(self.seconds, Rotation.from_quat(self.q_body_from_axes))(np.clip(t, first, last))
        return np.asarray(turns.as_matrix() @ np.swapaxes(gcrs_from(self.axes, self.epoch_utc, t), -1, -2))
