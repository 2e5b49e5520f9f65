"""Files that appear whole or not at all, also through a crash or a power cut.

What is written goes to a temporary file in the same folder, to the disk, and only then to its name. A process that is
killed leaves a temporary file (see :func:`leftovers`), never half a result. Two processes that write the same name do
not disturb each other: the last one wins. What the system refuses (no space, no permission, a read-only disk) is a
:class:`WriteError` that names the path, also where a library reports it in its own words.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from horizonval.core.errors import UserError
from horizonval.core.files import kind_at

SUFFIX = ".tmp"
_REFUSALS = ("ENOSPC", "EDQUOT", "EROFS", "EACCES", "EPERM", "EFBIG", "EIO", "EMFILE", "ENFILE")
"""What the system refuses a writer, as libraries quote it."""


class WriteError(UserError):
    """The system does not let a file or folder be written; ``reason`` is the system's text."""

    reason = ""

    @classmethod
    def of(cls, error: OSError, path: Path) -> WriteError:
        """Return what the system said about a path."""
        reason = error.strerror or str(error)
        if isinstance(error, FileNotFoundError):
            made = cls("no such folder", where=str(path.parent), fix="create it first")
        elif isinstance(error, FileExistsError | NotADirectoryError):
            places = (*reversed(path.parents), path)
            place, kind = next(((p, k) for p in places if (k := kind_at(p, links=True)) != "a folder"), (path, ""))
            made = cls(f"is {kind or 'no folder'}", where=str(place), expected="a folder")
        else:
            made = cls(f"cannot be written: {reason}", where=str(path))
        made.reason = reason
        return made


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file completely or not at all; after a :class:`WriteError` an existing file is unchanged."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, its line ends as they are; otherwise as :func:`write_bytes`."""
    write_bytes(path, text.encode())


def copy_file(source: Path, path: Path) -> None:
    """Copy a file's content; otherwise as :func:`write_bytes`."""
    with replacing(path) as temporary:
        shutil.copyfile(source, temporary)


def pour(source: Path, stream: Path) -> None:
    """Write a file's content into a device or a pipe; it may wait for the reader of a pipe."""
    try:
        with source.open("rb") as content, stream.open("wb") as out:
            shutil.copyfileobj(content, out)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise WriteError.of(error, stream) from error


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give an empty temporary file to write to; it becomes ``path`` when the block ends without an exception."""
    with temporary_in(path.parent, path.name) as temporary:
        yield temporary
        flush(temporary)
        move(temporary, path)


def make_folder(path: Path) -> None:
    """Make a folder and those above it, unless it exists; :class:`WriteError` if it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError.of(error, path) from error


@contextlib.contextmanager
def temporary_in(folder: Path, name: str = "") -> Iterator[Path]:
    """Give an empty temporary file of a folder; if it is still there when the block ends, it is removed."""
    temporary = folder / f".{name}.{secrets.token_hex(8)}{SUFFIX}"
    path = folder / name if name and not is_temporary(Path(name)) else folder
    try:
        temporary.touch(exist_ok=False)
        yield temporary
    except UserError:
        raise
    except Exception as error:
        if (refusal := _refusal(error, (temporary, folder / name))) is None:
            raise
        raise WriteError.of(refusal, path) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _refusal(error: Exception, written: tuple[Path, ...]) -> OSError | None:
    """Return why the system did not let a file be written; None for an error that is about something else."""
    if isinstance(error, OSError):
        return error if error.filename in (None, *map(str, written)) or error.filename in written else None
    words = str(error)
    numbers = (getattr(errno, name) for name in _REFUSALS if hasattr(errno, name))
    return next((OSError(number, os.strerror(number)) for number in numbers if os.strerror(number) in words), None)


def flush(path: Path) -> None:
    """Bring a written file to the disk."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def move(temporary: Path, path: Path) -> None:
    """Give a flushed temporary file its name, for good. Systems that cannot open folders do without the last word."""
    try:
        os.replace(temporary, path)
    except IsADirectoryError:
        # Something put a folder in the file's place. With nothing in it it may go; otherwise the system's error tells.
        path.rmdir()
        os.replace(temporary, path)
    with contextlib.suppress(OSError):
        descriptor = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def is_temporary(path: Path) -> bool:
    """Whether a file is one that an interrupted write left, by its name."""
    return path.name.startswith(".") and path.name.endswith(SUFFIX)


def leftovers(folder: Path, *, below: bool = True) -> list[Path]:
    """Return what interrupted writes left in a folder, and ``below`` it, in the order of paths; no link is followed."""
    if folder.is_symlink():
        return []
    paths = []
    for place, folders, names in os.walk(folder):
        if not below:
            folders.clear()
        paths += [path for name in names if is_temporary(path := Path(place, name)) and not path.is_symlink()]
    return sorted(path for path in paths if path.is_file())
