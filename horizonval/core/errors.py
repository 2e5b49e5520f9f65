"""Errors that a user can correct, with advice.

Every mistake of a user is a :class:`UserError`; the command line prints it as one line and exits with status 2. Any
other exception is a defect of this package.
"""

from __future__ import annotations

import contextlib
import shlex
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, Self


def printable(text: str) -> str:
    r"""Return text as one line that a terminal can show; control characters and invalid bytes are escaped as in Python.

    >>> printable("a\x1b[2Jb\n\udcffä")
    'a\\x1b[2Jb\\n\\udcffä'
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def excerpt(text: str, most: int = 40) -> str:
    """Return the beginning of a word of a user's file, for a message; a whole line is nobody's to show."""
    return text if len(text) <= most else f"{text[:most]}..."


def command_line(*words: object) -> str:
    """Return a command line as it can be typed, quoted for a shell.

    >>> command_line("archive", "ls", "my folder")
    "`horizonval archive ls 'my folder'`"
    """
    return f"`horizonval {shlex.join(str(word) for word in words)}`"


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

    @property
    def mistakes(self) -> tuple[UserError, ...]:
        """All mistakes that were found at once, this one first."""
        return (self,)

    def lines(self) -> list[str]:
        """Return the message of every mistake, each as one line."""
        return [self.line()]

    def at(self, where: str) -> Self:
        """Return the same mistake at another place: that of the file that the user wrote."""
        return type(self)(self.what, where=where, expected=self.expected, fix=self.fix)

    def inside(self, where: str) -> Self:
        """Return the same mistake with its place inside ``where``, which may name it already."""
        return self.at(f"{where}: {self.where}" if self.where and self.where not in where else where)

    def line(self) -> str:
        """Return the message as one line, no part of it longer than anyone reads."""
        where, what, expected, fix = (excerpt(part, most) for part, most in zip(self._parts(), _LONGEST, strict=True))
        text = f"{where}: {what}" if where else what
        if expected:
            text += f"; expected {expected}"
        if fix:
            text += f"; {fix}"
        return printable(text)

    def _parts(self) -> list[str]:
        return [" ".join(part.split()) for part in (self.where, self.what, self.expected, self.fix)]


_LONGEST = (1000, 500, 1000, 500)
"""Characters of where, what, expected and fix that a line shows."""


MOST_MISTAKES = 20
"""Largest number of mistakes in one message; further ones are counted."""


class SeveralMistakesError(UserError):
    """Several mistakes at once: as a :class:`UserError` it is the first; ``more`` is a line about omitted ones."""

    def __init__(self, mistakes: Sequence[UserError], more: str = "") -> None:
        self._mistakes, self._more = tuple(mistakes), more
        first = self._mistakes[0]
        super().__init__(first.what, where=first.where, expected=first.expected, fix=first.fix)

    @property
    def mistakes(self) -> tuple[UserError, ...]:
        """All mistakes that were found at once, in their order."""
        return self._mistakes

    def lines(self) -> list[str]:
        """Return the message of every mistake, each as one line, and last how many more there are."""
        return [mistake.line() for mistake in self._mistakes] + ([self._more] if self._more else [])

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def at(self, where: str) -> Self:
        """Return the same mistakes, all of them at another place."""
        return type(self)([mistake.at(where) for mistake in self._mistakes], self._more)

    def inside(self, where: str) -> Self:
        """Return the same mistakes, the place of each inside ``where``."""
        return type(self)([mistake.inside(where) for mistake in self._mistakes], self._more)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._mistakes, self._more)


def several(mistakes: Sequence[UserError], more: int = 0) -> UserError:
    """Return one or several mistakes as one error: the first :data:`MOST_MISTAKES` and a count with ``more`` others."""
    more += max(0, len(mistakes) - MOST_MISTAKES)
    if len(mistakes) == 1 and not more:
        return mistakes[0]
    rest = f"and {more} more problem{'s' if more > 1 else ''}" if more else ""
    return SeveralMistakesError(mistakes[:MOST_MISTAKES], rest)


class MistakeCollector:
    """Collects up to ``most`` mistakes to report them together; equal mistakes are reported once, with a count."""

    def __init__(self, most: int = 200) -> None:
        self._most, self._seen = most, 0
        self._first: dict[tuple[str, str, str], UserError] = {}
        self._times: Counter[tuple[str, str, str]] = Counter()
        self._told: UserError | None = None

    @contextlib.contextmanager
    def caught(self, place: str = "") -> Iterator[None]:
        """Keep a mistake that is made in the block; ``place`` is the part of its place that tells it from others."""
        try:
            yield
        except UserError as error:
            if error is self._told:
                raise
            for mistake in error.mistakes:
                key = (mistake.where.replace(place, ""), mistake.what, mistake.expected)
                self._first.setdefault(key, mistake)
                self._times[key] += 1
            self._seen += 1
            if self._seen >= self._most:
                self.tell()

    def tell(self) -> None:
        """Raise what was kept, if anything was."""
        if self._first:
            self._told = several([self._counted(key) for key in self._first])
            raise self._told

    def _counted(self, key: tuple[str, str, str]) -> UserError:
        mistake, times = self._first[key], self._times[key]
        if times == 1:
            return mistake
        least = "at least " if self._seen >= self._most else ""
        what = f"{mistake.what} (so in {least}{times} places)"
        return UserError(what, where=mistake.where, expected=mistake.expected, fix=mistake.fix)


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


def misfit(error: Exception) -> str:
    """Return what is wrong with content that is intact and yet not what this version writes, without Python's words."""
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, KeyError) and error.args:
        return f"has no {printable(excerpt(str(error.args[0])))!r}"
    return "has another form, as another version writes it"


def nearest(name: str, names: Iterable[str]) -> list[str]:
    """Return all of ``names``, the most similar to ``name`` first (capitals do not count); ties in given order."""
    name_lower = name.lower()
    return sorted(names, key=lambda n: -SequenceMatcher(None, name_lower, n.lower()).ratio())


def one_of(name: object, names: Iterable[str]) -> str:
    """Return what is expected in a name's place: ``"one of"`` all ``names``, the most similar first."""
    return f"one of {', '.join(nearest(str(name), names))}"
