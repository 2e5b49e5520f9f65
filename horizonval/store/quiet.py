"""Silence for libraries that print: our message describes a damaged file in one line."""

from __future__ import annotations

import contextlib
import ctypes
import io
import os
import sys
import threading
from collections.abc import Iterator

_lock = threading.Lock()


@contextlib.contextmanager
def silenced() -> Iterator[None]:
    """Discard what a library prints, through Python and C++ streams; C buffers are flushed before and after."""
    with _lock, open(os.devnull, "wb") as sink, contextlib.redirect_stdout(io.StringIO()):
        _flush_c_streams()
        saved = [(number, os.dup(number)) for number in (1, 2)]
        try:
            for number, _ in saved:
                os.dup2(sink.fileno(), number)
            yield
        finally:
            _flush_c_streams()
            for number, copy in saved:
                os.dup2(copy, number)
                os.close(copy)


def _flush_c_streams() -> None:
    if sys.platform != "win32":
        ctypes.CDLL(None).fflush(None)
