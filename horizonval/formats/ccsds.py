"""CCSDS messages: lines of keys and values, times as text, and the spans of time that a file covers.

A message is a header, then for each part a block of metadata and one of data. Keys are in capitals before ``=``;
``COMMENT`` lines are skipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt
from horizonval.geometry import clock

EXPECTED = "a UTC time as 2026-03-20T12:00:00.25"


def utc_of(text: str, where: str) -> datetime:
    """Return the time of ``2026-03-20T12:00:00`` or ``2026-079T12:00:00``; a Z and parts of a second may follow."""
    plain = text.strip().removesuffix("Z")
    try:
        whole, _, part = plain.partition(".")
        form = "%Y-%jT%H:%M:%S" if len(whole.split("T")[0].split("-")) == 2 else "%Y-%m-%dT%H:%M:%S"
        found = datetime.strptime(whole.replace(" ", "T"), form).replace(tzinfo=UTC)
        if part:
            found = found.replace(microsecond=min(round(float(f"0.{part}") * 1e6), 999_999))
    except ValueError:
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=EXPECTED) from None
    return found


def seconds_after(epoch_utc: datetime, times: Sequence[datetime]) -> FloatArray:
    """Return how long after an epoch some times are, shape (n,) [s]; leap seconds between them are not counted."""
    return np.array([(time - epoch_utc).total_seconds() for time in times])


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
