"""Spans of time that a file of states or attitudes covers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry import clock

ROUNDING_S = 1e-6
"""Times are whole microseconds."""


@dataclass(frozen=True)
class Coverage:
    """Spans in rising order: ``begins`` and ``ends``, shape (k,) each [s]."""

    begins: FloatArray
    ends: FloatArray

    def around(self, seconds: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return begin and end, shape (n,) each, of the spans that times (n,) lie in; NaN outside all."""
        lo, hi = np.full(len(seconds), np.nan), np.full(len(seconds), np.nan)
        for begin, end in zip(self.begins, self.ends, strict=True):
            inside = (seconds >= begin - ROUNDING_S) & (seconds <= end + ROUNDING_S)
            lo[inside], hi[inside] = begin, end
        return lo, hi


def outside(what: str, epoch_utc: datetime, seconds: float, coverage: Coverage, where: str) -> UserError:
    """Return the error for a time outside the spans of a file, the first three of which it names."""

    def stamp(t: float) -> str:
        return clock.stamp_after(epoch_utc, float(t))

    spans = [f"{stamp(begin)} to {stamp(end)}" for begin, end in zip(coverage.begins, coverage.ends, strict=True)]
    more = ", ..." if len(spans) > 3 else ""
    return UserError(f"no {what} for {stamp(seconds)}", where=where, expected=", ".join(spans[:3]) + more)


def coverage_of(seconds: FloatArray, gaps: NDArray[np.bool_], usable_s: tuple[float, float] | None = None) -> Coverage:
    """Return the spans between rising times (m,), without those intervals (m - 1,) that are gaps.

    A state between two gaps is a span of no length. ``usable_s``: what lies outside is left out.
    """
    begins, ends = seconds[np.concatenate([[True], gaps])], seconds[np.concatenate([gaps, [True]])]
    if usable_s is not None:
        begins, ends = np.maximum(begins, usable_s[0]), np.minimum(ends, usable_s[1])
    kept = ends >= begins
    return Coverage(begins[kept], ends[kept])


def together(spans: Sequence[Coverage]) -> Coverage:
    """Return the spans of several parts as one, in their order."""
    return Coverage(np.concatenate([s.begins for s in spans]), np.concatenate([s.ends for s in spans]))
