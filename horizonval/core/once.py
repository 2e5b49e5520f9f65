"""Time spent on what is made once for many frames, as a table of scattered light: no measure of the next frame."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

_seconds = 0.0


@contextmanager
def made_once() -> Iterator[None]:
    """Count the time inside."""
    global _seconds
    start = time.perf_counter()
    try:
        yield
    finally:
        _seconds += time.perf_counter() - start


def taken_s() -> float:
    """Return the seconds that were counted in this process since the last call."""
    global _seconds
    seconds, _seconds = _seconds, 0.0
    return seconds
