"""Time spent on what is made once for many frames, tables and compiled kernels: no measure of the next frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

COMPILING = "compiling"
_seconds: dict[str, float] = {}


@contextmanager
def made_once(what: str) -> Iterator[None]:
    """Count the time inside under ``what``."""
    start = time.perf_counter()
    try:
        yield
    finally:
        count(what, time.perf_counter() - start)


def count(what: str, seconds: float) -> None:
    """Add seconds under ``what``."""
    _seconds[what] = _seconds.get(what, 0.0) + seconds


def taken_s() -> dict[str, float]:
    """Return the seconds that were counted in this process since the last call."""
    seconds = dict(_seconds)
    _seconds.clear()
    return seconds
