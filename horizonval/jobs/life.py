"""A sign of life: one line on standard error where a command has loaded for a while and not yet said anything.

The renderer, and what reads tables and draws figures, take seconds to load from a cold disk. Who shows progress calls
:func:`hush`, and nothing is said.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

AFTER_S = 0.7
"""From the program's start; the interpreter took up to half a second before, and two are allowed."""

_hushed = threading.Event()


@contextmanager
def sign_of_life(line: str, after_s: float = AFTER_S) -> Iterator[None]:
    """Write a line to standard error if the work inside goes on for so long without :func:`hush`."""
    _hushed.clear()

    def tell() -> None:
        if not _hushed.wait(after_s):
            sys.stderr.write(line + "\n")
            sys.stderr.flush()

    threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        hush()


def hush() -> None:
    """Say that there is output of another kind, so that no sign of life is needed."""
    _hushed.set()
