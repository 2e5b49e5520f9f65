"""Results in files: each whole or not at all, each with the digest of everything that it depends on.

A record is a JSON object in a file of its own. It says its identity, so that one that was made of something else, or by
other code, is known for what it is; and it is sealed, so that one that was altered is never taken for a result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.store.folder import intact_json, write_json

Record = dict[str, Any]


def keep(path: Path, identity: str, record: Mapping[str, Any], *, sort_keys: bool = True) -> None:
    """Write a record with its identity; its keys sorted, or in the order that they have."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {**record, "identity": identity}, indent=None, sort_keys=sort_keys)


def kept(path: Path, identity: str) -> Record | None:
    """Return a finished record of this identity; None if there is none, or one that says why there is no result.

    A record that is damaged is none, and that is said.
    """
    record: Record | None = intact_json(path)
    if record is None or record.get("identity") != identity or record.get("error") is not None:
        return None
    return record


def take_over(source: Path, target: Path, rooms: Iterable[str], wanted: Callable[[Path], bool]) -> None:
    """Copy the files of another folder that ``target`` does not have, below some of its sub-folders.

    They are looked at like the folder's own: what is damaged or of other code is made again. Only regular files are
    copied, and none to where a link leads out of ``target``.
    """
    for room in rooms:
        for path in sorted((source / room).rglob("*")):
            place = target / path.relative_to(source)
            if files.kind_at(path) != "a file" or not wanted(path) or files.kind_at(place):
                continue
            if files.is_inside(path, source / room) and files.is_inside(place, target / room):
                place.parent.mkdir(parents=True, exist_ok=True)
                atomic.copy_file(path, place)
