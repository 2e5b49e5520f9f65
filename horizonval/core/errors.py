"""Errors a user can act on, and the line that tells how.

Every mistake a user can make ends in a :class:`UserError`; the command line prints it as one line and exits with
status 2. Anything else that escapes is a defect of this package.
"""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Self


def printable(text: str) -> str:
    r"""Return text that a terminal shows as it is, and in one line.

    Names of files and texts of headers may hold line ends, commands to the terminal or bytes that are no text: such
    characters are written as Python escapes them.

    Examples
    --------
    >>> printable("a\x1b[2Jb\n\udcffä")
    'a\\x1b[2Jb\\n\\udcffä'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def excerpt(text: str, most: int = 40) -> str:
    """Return the beginning of a word of a user's file, for a message; a whole line is nobody's to show."""
    return text if len(text) <= most else f"{text[:most]}..."


class UserError(Exception):
    """A mistake in what the user gave us: what is wrong, where, what was expected, how to mend it.

    Parameters
    ----------
    what : str
        What is wrong, with the value that was found.
    where : str, optional
        File and key (``"camera.toml: camera.width"``).
    expected : str, optional
        What would have been right.
    fix : str, optional
        What to do now.

    Examples
    --------
    >>> import horizonval as hv
    >>> try:
    ...     hv.Camera.from_file("vis-cmos-512-60deg").changed(camera={"width": "512"})
    ... except hv.UserError as e:
    ...     print(e)
    Camera: camera.width: found "512"; expected a whole number from 1 to 16384
    """

    def __init__(self, what: str, *, where: str = "", expected: str = "", fix: str = "") -> None:
        self.what, self.where, self.expected, self.fix = what, where, expected, fix
        super().__init__(self.line())

    def at(self, where: str) -> Self:
        """Return the same mistake at another place: that of the file that the user wrote."""
        return type(self)(self.what, where=where, expected=self.expected, fix=self.fix)

    def inside(self, where: str) -> Self:
        """Return the same mistake with its place inside ``where``, which may name it already."""
        return self.at(f"{where}: {self.where}" if self.where and self.where not in where else where)

    def line(self) -> str:
        """Return the message as one line."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        if self.expected:
            text += f"; expected {self.expected}"
        if self.fix:
            text += f"; {self.fix}"
        return printable(" ".join(text.split()))


class DamagedFileError(UserError):
    """A stored file is not what its writer wrote (truncated, altered, foreign, or without its header)."""


def one_line(error: BaseException) -> str:
    """Return what went wrong as one line for a record: a user's mistake in its own words, else a defect and its place.

    Of the place only the file's name: where the package is installed must not show in a result.
    """
    if isinstance(error, UserError):
        return error.line()
    trace = traceback.extract_tb(error.__traceback__)
    place = f" at {Path(trace[-1].filename).name}:{trace[-1].lineno}" if trace else ""
    return printable(" ".join(f"{type(error).__name__}{place}: {error}".split()))
