"""What is left of an estimator that crashed: a reason of one line, the last lines printed and the traceback.

Both come from code that may do anything, and go into records, tables, pages and terminals. They are bounded, bytes that
are no text are replaced, and so are control characters. What would differ between two runs of the same code (addresses
in memory, names of temporary folders, where packages are installed) is left out of tracebacks and reasons. What a
program prints of itself is its own: one that prints the time crashes in other words every time.
"""

from __future__ import annotations

import contextlib
import re
import sys
import traceback
import unicodedata
from pathlib import PurePath
from types import TracebackType

from horizonval.core.outcome import Outcome, Refusal

LONGEST_REASON = 500
LONGEST_OUTPUT = 4096
"""Characters, of what was printed and the traceback together."""
_FRAMES = 20
_TEMPORARY = re.compile(r"[^\s'\"]*/horizonval-[a-z0-9_]{8}\b")
_ADDRESS = re.compile(r"\b0x[0-9a-fA-F]{4,}")
_UNSAFE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
"""Unicode categories that steer a terminal or a page, or cannot be written."""


def crash(reason: str, output: str | bytes = "") -> Refusal:
    """Return the outcome of an estimator that gave no answer.

    Parameters
    ----------
    reason : str
    output : str or bytes
        What was printed last, and a traceback.
    """
    return Refusal(Outcome.CRASHED, one_line(reason) or "no reason given", output=tail(output))


def one_line(text: str) -> str:
    """Return text as one line that can be written anywhere, cut after :data:`LONGEST_REASON` characters."""
    line = _safe(" ".join(str(text)[: 4 * LONGEST_REASON].split()))
    return line if len(line) <= LONGEST_REASON else line[: LONGEST_REASON - 3] + "..."


def tail(text: str | bytes) -> str:
    """Return the last lines of text, at most :data:`LONGEST_OUTPUT` characters that can be written anywhere."""
    if isinstance(text, bytes):
        text = text[-4 * LONGEST_OUTPUT :].decode("utf-8", "replace")
    lines = [_safe(line).rstrip() for line in text[-4 * LONGEST_OUTPUT :].replace("\r\n", "\n").split("\n")]
    joined = "\n".join(lines).strip("\n")
    if len(joined) <= LONGEST_OUTPUT:
        return joined
    cut = joined[-LONGEST_OUTPUT:]
    return cut.partition("\n")[2] or cut


def _safe(text: str) -> str:
    text = text.replace("\t", "    ")
    if not text.isascii() or not text.isprintable():
        text = "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(c) in _UNSAFE else c for c in text)
    return _TEMPORARY.sub("...", _ADDRESS.sub("0x...", text))


def raised(error: BaseException) -> str:
    """Return the type of an exception and what it says, in one line, whatever its ``__str__`` does."""
    try:
        words = str(error)
    except BaseException:
        words = "(which cannot be printed)"
    return one_line(f"{type(error).__name__}: {words}" if words else type(error).__name__)


def traceback_of(error: BaseException, below: int = 1) -> str:
    """Return a traceback without the first frames, which are ours, and with paths as a module would be imported."""
    with contextlib.suppress(BaseException):
        start: TracebackType | None = error.__traceback__
        for _ in range(below):
            start = start.tb_next if start is not None else None
        frames = traceback.extract_tb(start, limit=-_FRAMES)
        for frame in frames:
            frame.filename = _importable(frame.filename)
        return tail("Traceback (most recent call last):\n" + "".join(frames.format()) + raised(error))
    return raised(error)


def _importable(filename: str) -> str:
    """Return a path below the place that it was imported from, else the file's name."""
    path = PurePath(filename)
    places = sorted((place for place in sys.path if place), key=len, reverse=True)
    below = next((path.relative_to(place) for place in places if path.is_relative_to(place)), None)
    return (PurePath(path.name) if below is None else below).as_posix()
