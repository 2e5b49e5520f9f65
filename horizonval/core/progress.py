"""What long work reports while it goes on, and the time it spends on what is made once for many frames."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol


class Progress(Protocol):
    """Told how far the work has come: items that are counted, and steps whose length nobody knows."""

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        """Begin with ``total`` items, of which ``kept`` are finished.

        ``unit`` is what is counted and ``what`` the work; empty for the listener's defaults.
        """

    def done(self, name: str, *, failed: str | None = None) -> None:
        """One more item is finished; ``failed`` says why it has no result."""

    def left(self, seconds: float | None) -> None:
        """Say about how long the rest will take, before the next item is said to be done; None: nothing tells it."""

    def step(self, what: str, state: str = "") -> None:
        """Something that takes a while is under way: ``what`` it is, and how it stands."""

    def note(self, text: str) -> None:
        """Something that the user ought to know, such as a warning about the frames that are about to be rendered."""


class Silent:
    """A listener that shows nothing."""

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        """Ignore."""

    def done(self, name: str, *, failed: str | None = None) -> None:
        """Ignore."""

    def left(self, seconds: float | None) -> None:
        """Ignore."""

    def step(self, what: str, state: str = "") -> None:
        """Ignore."""

    def note(self, text: str) -> None:
        """Ignore."""


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
