"""Files that appear whole or not at all, also through a crash or a power cut.

What is written goes to a temporary file in the same folder, to the disk, and only then to its name. A process that is
killed leaves a temporary file (see :func:`leftovers`), never half a result. Two processes that write the same name do
not disturb each other: the last one wins.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

SUFFIX = ".tmp"


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file completely or not at all; after an ``OSError`` an existing file is unchanged."""
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, its line ends as they are; otherwise as :func:`write_bytes`."""
    write_bytes(path, text.encode())


def copy_file(source: Path, path: Path) -> None:
    """Copy a file's content; otherwise as :func:`write_bytes`."""
    with replacing(path) as temporary:
        shutil.copyfile(source, temporary)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give an empty temporary file to write to; it becomes ``path`` when the block ends without an exception."""
    with temporary_in(path.parent, path.name) as temporary:
        yield temporary
        flush(temporary)
        move(temporary, path)


@contextlib.contextmanager
def temporary_in(folder: Path, name: str = "") -> Iterator[Path]:
    """Give an empty temporary file of a folder; if it is still there when the block ends, it is removed."""
    temporary = folder / f".{name}.{secrets.token_hex(8)}{SUFFIX}"
    temporary.touch(exist_ok=False)
    try:
        yield temporary
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


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
