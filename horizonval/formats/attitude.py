"""Attitudes from files: quaternions, and one turn at a constant rate from each to the next.

An interval in which the body turns by more than 90 deg is a gap, since the sense of the turn is unknown. So is one ten
times as long as most, if the body turns by more than 5 deg in it. Attitudes in a gap are refused.

**Axes** are celestial (``GCRF``, ``ICRF``, ``EME2000``, ``J2000``), Earth-fixed (``ITRF`` of any year), ``TOD``, the
true equator and equinox of date by IAU 2006/2000A, or ``TEME``, that of two-line elements. ``EME2000`` differs from
``GCRF`` by 23 milliarcseconds (0.8 m in low orbit), the pole and equinox of older theories from ``TOD`` by some 0.05
arcsec, and the realisations of ``ITRF`` from each other by centimetres: each is taken as one.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.formats.coverage import Coverage, coverage_of, outside, together
from horizonval.geometry import clock
from horizonval.geometry.orbit import EARTH_RATE_RAD_S
from horizonval.geometry.rotation import itrs_from_gcrs, itrs_from_teme, tod_from_gcrs, turn

Axes = Literal["gcrs", "itrs", "tod", "teme"]
KNOWN = "GCRF, ICRF, EME2000, J2000, ITRF (of any year), TOD or TEME"
_CELESTIAL = ("GCRF", "ICRF", "EME2000", "J2000", "GCRS")
_EARTH_FIXED = re.compile(r"ITR[FS]([-_ ]?\d+)?")


def axes_of(name: str, where: str) -> Axes:
    """Return the kind of axes of a name; another one is a :class:`UserError` at ``where``."""
    upper = name.strip().upper()
    if upper in _CELESTIAL:
        return "gcrs"
    if upper == "TEME":
        return "teme"
    if upper == "TOD":
        return "tod"
    if _EARTH_FIXED.fullmatch(upper):
        return "itrs"
    raise UserError(f"axes {name!r}", where=where, expected=KNOWN)


def gcrs_from(axes: Axes, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
    """Return matrices, shape (n, 3, 3), from axes to ``gcrs`` at times after an epoch."""
    if axes == "gcrs":
        return np.broadcast_to(np.eye(3), (len(seconds), 3, 3))
    if axes == "tod":
        return np.swapaxes(tod_from_gcrs(epoch_utc, seconds), -1, -2)
    to_gcrs = np.swapaxes(itrs_from_gcrs(epoch_utc, seconds), -1, -2)
    return to_gcrs if axes == "itrs" else to_gcrs @ itrs_from_teme(epoch_utc, seconds)


def states_in_gcrs(
    axes: Axes, epoch_utc: datetime, seconds: FloatArray, r: FloatArray, v: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return positions and velocities, shape (n, 3) each, turned to ``gcrs``; Earth-fixed velocities are relative."""
    matrices = gcrs_from(axes, epoch_utc, seconds)
    if v is not None and axes == "itrs":
        v = v + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r)
    return turn(matrices, r), None if v is None else turn(matrices, v)


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
    """How a body was turned against ``axes``; ``where`` names the file for messages. Pieces do not know each other.

    ``doubt``: warning about the file, or nothing.
    """

    epoch_utc: datetime
    pieces: tuple[AttitudePiece, ...]
    axes: Axes
    where: str
    doubt: str = ""

    @cached_property
    def coverage(self) -> Coverage:
        """Spans of time with values."""
        return together([piece.coverage for piece in self.pieces])

    def body_from_gcrs(self, epoch_utc: datetime, seconds: FloatArray) -> FloatArray:
        """Return matrices, shape (n, 3, 3), at times (n,) after another epoch.

        Raises
        ------
        UserError
            A time outside all pieces, or in a gap.
        """
        t = np.asarray(seconds, dtype=np.float64) + clock.elapsed_s(self.epoch_utc, epoch_utc)
        matrices = np.full((len(t), 3, 3), np.nan)
        for piece in self.pieces:
            inside = np.isfinite(piece.coverage.around(t)[0])
            if inside.any():
                turns = Slerp(piece.seconds, Rotation.from_quat(piece.q_body_from_axes))
                matrices[inside] = turns(np.clip(t[inside], piece.seconds[0], piece.seconds[-1])).as_matrix()
        if np.isnan(matrices).any():
            first = float(t[int(np.flatnonzero(np.isnan(matrices[:, 0, 0]))[0])])
            raise outside("attitude", self.epoch_utc, first, self.coverage, self.where)
        return np.asarray(matrices @ np.swapaxes(gcrs_from(self.axes, self.epoch_utc, t), -1, -2))

    def around(self, epoch_utc: datetime, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return begin and end, shape (n,) each, of the spans that times after another epoch lie in; NaN outside."""
        offset = clock.elapsed_s(self.epoch_utc, epoch_utc)
        lo, hi = self.coverage.around(seconds + offset)
        return lo - offset, hi - offset


def attitudes_of(
    seconds: FloatArray,
    q_body_from_axes: FloatArray,
    where: str,
    usable_s: tuple[float, float] | None = None,
    place: Callable[[int], str] | None = None,
) -> AttitudePiece:
    """Return a piece, or a :class:`UserError` for what is no history of attitudes.

    ``seconds`` rise. ``place``: name of an attitude, by its index, for messages.
    """
    named = place or (lambda k: f"{where}: attitude {k + 1}")
    if len(seconds) < 2:
        raise UserError(f"{len(seconds)} attitudes", where=where, expected="2 and more")
    check_length(q_body_from_axes, named)
    turns = Rotation.from_quat(q_body_from_axes)
    angle = (turns[1:] * turns[:-1].inv()).magnitude()
    return AttitudePiece(seconds, q_body_from_axes, coverage_of(seconds, _gaps(np.diff(seconds), angle), usable_s))


def check_length(q: FloatArray, place: Callable[[int], str]) -> None:
    """Refuse a quaternion, of shape (n, 4), that is not of length 1."""
    length = np.linalg.norm(q, axis=1)
    if (off := np.flatnonzero(np.abs(length - 1.0) > LONGEST_OFF)).size:
        k = int(off[0])
        raise UserError(f"a quaternion of the length {length[k]:.6g}", where=place(k), expected="the length 1")


def _gaps(steps: FloatArray, angle: FloatArray) -> NDArray[np.bool_]:
    """Return whether each interval, shape (m - 1,), is one between whose ends nothing is known."""
    long = steps > GAP_STEPS * float(np.median(steps))
    return np.asarray((angle > LARGEST_TURN) | (long & (angle > GAP_TURN)))


def other_readings(q: FloatArray) -> list[tuple[str, FloatArray]]:
    """Return what quaternions (n, 4), scalar last, would be if they were meant otherwise, and in which way."""
    inverse = np.array([-1.0, -1.0, -1.0, 1.0])
    found = [("its turn is the inverse (ATTITUDE_DIR)", q * inverse)]
    for given in (q, q * inverse):
        for roll in (-1, 1):
            other_end = np.roll(given, roll, axis=1)
            found += [("its scalar is at the other end (QUATERNION_TYPE)", other_end * s) for s in (1.0, inverse)]
    return found
