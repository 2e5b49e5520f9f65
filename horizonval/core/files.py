"""The one way to open files of users and of results: regular files of bounded size only.

A FIFO waits for a writer that never comes, a device or a file of ``/proc`` may never end, and a link inside an archive
leads out of it. The kind of a path is checked before it is opened and again when it is open (it may have been
replaced); opening never waits. A refusal is a :class:`UnfitFileError`, one line like every mistake of a user.

A user's link to a regular file is allowed; folders of results have no links (``links=False``).
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import stat
import zipfile
import zlib
from collections.abc import Callable
from io import BufferedReader
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError

_READ_ONLY = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)
_NAME = re.compile(r"[A-Za-z0-9._-]+")
UNREADABLE_ARRAYS = (
    OSError,
    ValueError,
    EOFError,
    AttributeError,
    KeyError,
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What numpy raises of an archive of arrays that is damaged, or none."""
_KINDS = (
    (stat.S_ISREG, "a file"),
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISLNK, "a link"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class UnfitFileError(UserError):
    """What lies at a path cannot be read as a file: no regular file, too large, not there, not permitted."""


class MissingFileError(UnfitFileError):
    """Nothing lies at a path, or a link to nothing."""


class UnreadableFileError(UnfitFileError):
    """A regular file, perhaps, but the system does not let it be read."""


_inputs: set[tuple[int, int]] | None = None
"""Device and inode of every file that the running command has read; None outside of commands."""


def begin_command() -> None:
    """Remember from now on which files are read, for :func:`is_input`; what was read before is forgotten."""
    global _inputs
    _inputs = set()


def is_input(path: str | os.PathLike[str]) -> bool:
    """Whether the running command has read the file at a path, by whatever name: another spelling, a link, its case."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return False
    return (status.st_dev, status.st_ino) in (_inputs or ())


def is_same(path: str | os.PathLike[str], other: str | os.PathLike[str]) -> bool:
    """Whether two paths lead to the same file; not where one leads nowhere."""
    try:
        return os.path.samefile(path, other)
    except (OSError, ValueError):
        return False


def kind_at(path: str | os.PathLike[str], *, links: bool = False) -> str:
    """Return what is at a path, without opening it: of a link itself, or with ``links`` of its target.

    ``"a file"``, ``"a folder"``, ``"a link"``, ``"a FIFO"``, ``"a socket"``, ``"a device"``; empty if nothing is there
    or may be seen.
    """
    try:
        return _kind(os.stat(path, follow_symlinks=links).st_mode)
    except (OSError, ValueError):
        return ""


def check_parent(path: Path) -> None:
    """Raise ``UserError`` unless the folder that is to hold a path is there."""
    for folder in reversed(path.parents):
        if (kind := kind_at(folder, links=True)) not in ("a folder", ""):
            raise UserError(f"is {kind}", where=str(folder), expected="a folder")
    if not kind_at(path.parent, links=True):
        raise UserError("no such folder", where=str(path.parent), fix="create it first")


def check_folder(out: Path, *, ours: bool | None = None) -> None:
    """Raise ``UserError`` unless a folder is new or empty, or ``ours``: a user's files must not be overwritten.

    ``ours``: whether it holds a result that the command continues; None if the command never does.
    """
    check_parent(out)
    if out.exists() and not out.is_dir():
        raise UserError(f"is {kind_at(out, links=True)}", where=str(out), expected="a new or empty folder")
    if not ours and out.is_dir() and any(out.iterdir()):
        others = "" if ours is None else ", or one of this command"
        raise UserError("is not empty", where=str(out), expected=f"a new or empty folder{others}")


def is_name(text: object) -> bool:
    """Whether a text is the name of a file and of nothing else: letters, digits, dot, hyphen and underscore."""
    return isinstance(text, str) and _NAME.fullmatch(text) is not None and text not in (".", "..")


def is_inside(path: Path, root: Path) -> bool:
    """Whether a path is really below a folder: no link between them, and no ``..``, leads out of it."""
    return Path(os.path.realpath(path.parent)).is_relative_to(os.path.realpath(root))


def open_file(
    path: str | os.PathLike[str], *, expected: str = "a file", links: bool = True, largest: int | None = None
) -> BufferedReader:
    """Open a regular file for reading as binary, buffered; nothing waits.

    Parameters
    ----------
    path : path-like
    expected : str
        Expected content, for the message (``"a TOML file"``).
    links : bool
        Whether the path may be a link to a regular file.
    largest : int, optional
        Largest size [bytes].

    Raises
    ------
    MissingFileError
        Nothing is there.
    UnreadableFileError
        It cannot be read: no permission, or a broken disk.
    UnfitFileError
        No regular file, one without a known size (those of ``/proc``), or one that is too large.
    """
    try:
        # Opening alone may do something (a tape rewinds), so the look comes first.
        _check(os.stat(path, follow_symlinks=links), path, expected, largest)
        file = os.fdopen(os.open(path, _READ_ONLY | (0 if links else _NO_LINK)), "rb")
    except (OSError, ValueError) as error:
        raise _error_of(error, path, expected) from None
    try:
        status = os.fstat(file.fileno())
        _check(status, path, expected, largest)
        if not status.st_size and file.peek(1):
            raise UnfitFileError("is a file of the system, without a size", where=str(path), expected=expected)
    except (OSError, ValueError, UnfitFileError) as error:
        file.close()
        raise error if isinstance(error, UnfitFileError) else _error_of(error, path, expected) from None
    if _inputs is not None:
        _inputs.add((status.st_dev, status.st_ino))
    return file


def read_bytes(
    path: str | os.PathLike[str],
    *,
    largest: int,
    expected: str = "a file",
    links: bool = True,
    first: int | None = None,
) -> bytes:
    """Return what a regular file held when it was opened, or its ``first`` bytes; otherwise as :func:`open_file`."""
    with open_file(path, expected=expected, links=links, largest=largest) as file:
        try:
            return file.read(os.fstat(file.fileno()).st_size if first is None else first)
        except OSError as error:
            raise _error_of(error, path, expected) from None


def read_text(
    path: str | os.PathLike[str],
    *,
    largest: int,
    expected: str = "a text file",
    links: bool = True,
    encoding: str = "utf-8-sig",
) -> str:
    """Return the text of a regular file with its line ends.

    Raises as :func:`open_file`, and ``UnfitFileError`` for bytes that are not of the encoding, without showing them.
    """
    data = read_bytes(path, largest=largest, expected=expected, links=links)
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        name = "ASCII" if encoding == "ascii" else "UTF-8"
        raise UnfitFileError(
            f"not text (byte {error.start} is not {name})", where=str(path), expected=expected
        ) from None


_NO_JSON = {
    "Expecting value": "a value is missing",
    "Expecting property name": "a name in double quotes is missing",
    "Expecting ','": "a comma is missing",
    "Expecting ':'": "a colon is missing",
    "Extra data": "more text after the end",
    "Unterminated string": "a text without its closing quote",
    "Invalid control character": "a control character in a text",
    "Invalid \\": "an unknown escape in a text",
    "Illegal trailing comma": "a comma too many",
}
"""The parser's words, by their beginning, in ours."""


def json_mistake(error: json.JSONDecodeError) -> str:
    """Return what is wrong with JSON, without its place."""
    return next((words for start, words in _NO_JSON.items() if error.msg.startswith(start)), "a mistake")


def parse_json(
    text: str,
    path: str | os.PathLike[str],
    *,
    pairs: Callable[[list[tuple[str, Any]]], Any] | None = None,
    number: Callable[[str], Any] | None = None,
) -> Any:
    """Return JSON as plain data; a ``UserError`` names ``path`` and the position of the mistake, not the text.

    ``pairs`` makes an object of its keys and values, ``number`` a number of its text.
    """
    try:
        return json.loads(text, object_pairs_hook=pairs, parse_float=number, parse_int=number, parse_constant=number)
    except json.JSONDecodeError as error:
        what = f"not JSON: {json_mistake(error)} at line {error.lineno}, column {error.colno}"
    except RecursionError:
        what = "not JSON that is read here: nested too deeply"
    except ValueError:
        what = "not JSON that is read here: a number of thousands of digits"
    raise UserError(what, where=str(path))


def sha256_of(path: str | os.PathLike[str], *, expected: str = "a file", links: bool = True) -> str:
    """Return the hex digest of a regular file's bytes; otherwise as :func:`open_file`."""
    with open_file(path, expected=expected, links=links) as file:
        try:
            return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError as error:
            raise _error_of(error, path, expected) from None


def _kind(mode: int) -> str:
    return next((name for is_kind, name in _KINDS if is_kind(mode)), "no file")


def _check(status: os.stat_result, path: str | os.PathLike[str], expected: str, largest: int | None) -> None:
    kind = _kind(status.st_mode)
    if kind != "a file":
        raise UnfitFileError(f"is {kind}", where=str(path), expected=expected)
    if largest is not None and status.st_size > largest:
        raise _too_large(path, expected, largest)


def _too_large(path: str | os.PathLike[str], expected: str, largest: int) -> UnfitFileError:
    return UnfitFileError("is too large", where=str(path), expected=f"{expected} of at most {_size(largest)}")


def _size(n: int) -> str:
    unit, name = next((u, name) for u, name in ((2**30, "GiB"), (2**20, "MiB"), (2**10, "KiB"), (1, "B")) if n >= u)
    return f"{n / unit:g} {name}"


def _error_of(error: OSError | ValueError, path: str | os.PathLike[str], expected: str) -> UnfitFileError:
    """Return what the system said as one of ours."""
    number = error.errno if isinstance(error, OSError) else None
    if number in (errno.ENOENT, errno.ENOTDIR):
        what = "is a link to nothing" if kind_at(path) == "a link" else "no such file"
        return MissingFileError(what, where=str(path), expected=expected)
    if number == errno.ELOOP:
        # With O_NOFOLLOW also for a link that came between the look and the opening.
        return UnfitFileError("is a link that leads nowhere", where=str(path), expected=expected)
    if isinstance(error, ValueError):
        return UnfitFileError("is no path", where=repr(str(path)), expected=expected)
    return UnreadableFileError(f"cannot be read: {error.strerror or error}", where=str(path), expected=expected)


def ensure_file(path: Path, *, expected: str = "a file", links: bool = True) -> None:
    """Raise as :func:`open_file` would, for those who hand a path to a library that opens it by itself."""
    open_file(path, expected=expected, links=links).close()


LONGEST_FRAME_NAME = 150
"""Most characters of the name of a scene or frame. With the name of a head, the endings of files and the suffix of an
unfinished write, a file's name stays within 255 bytes, the limit of the usual file systems."""

LONGEST_NAME = 50
"""Most characters of a part of a name: a head, a band, a table of cases, an entry of a list."""

LONGEST_GENERATED_NAME = 120
"""Most characters of a name that a grid or a list of cases makes, before the number of an orbit's sample."""

_RESERVED = re.compile(r"(con|prn|aux|nul|com[0-9]|lpt[0-9])(\..*)?", re.IGNORECASE)
_DIGITS = 12


def usable_name(name: str) -> str:
    """Return a file name made of letters, digits, ``.``, ``_`` and ``-``.

    Raises ``ValueError`` for the name of a folder or a device, or an end with a dot, which some systems drop.
    """
    if name in (".", "..") or name.endswith("."):
        raise ValueError(f"the name {name!r} cannot be a file's: it must not end with a dot")
    if _RESERVED.fullmatch(name):
        raise ValueError(f"the name {name!r} cannot be a file's: some systems call a device so")
    return name


def shortened(name: str, longest: int) -> str:
    """Return a name of at most ``longest`` characters; of a longer one the beginning and a digest of all of it."""
    if len(name) <= longest:
        return name
    digest = hashlib.sha256(name.encode()).hexdigest()[:_DIGITS]
    return f"{name[: longest - _DIGITS - 1].rstrip('._-')}-{digest}"
