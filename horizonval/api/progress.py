"""Who is told how far long work has come: nobody, a terminal, or whoever the caller names."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from horizonval.core.progress import Progress, Silent


@contextmanager
def shown(progress: bool | Progress, what: str = "", unit: str = "frames") -> Iterator[Progress]:
    """Give a listener of ``what``: the terminal for True, none for False, else the one that was given."""
    if progress is False:
        yield Silent()
    elif progress is True:
        from horizonval.jobs.progress import Terminal

        with Terminal(what, unit) as terminal:
            yield terminal
    else:
        yield progress
