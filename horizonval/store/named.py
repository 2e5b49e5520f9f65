"""Which entries of an archive the results of a run name, and the removal of those that none names."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.core.errors import DamagedFileError, UserError, excerpt
from horizonval.store.entry import is_address, places
from horizonval.store.folder import RunFolder, read_json
from horizonval.store.store import Store

_NAMING = {"frame", "truth_frame", "image", "images", "frame_address", "image_address"}
"""Keys of records that hold addresses."""


@dataclass(frozen=True)
class Garbage:
    """Files that may go: entries that nothing names, and what interrupted writes left."""

    files: tuple[Path, ...]
    kept: int

    @property
    def size_bytes(self) -> int:
        """Return what their removal sets free."""
        return sum(path.lstat().st_size for path in self.files)


def run_folder_of(archive: Path) -> RunFolder | None:
    """Return the run that an archive belongs to, if there is one."""
    folder = RunFolder(archive.parent)
    return folder if archive.name == folder.archive.name and folder.suite.is_file() else None


def archive_of(folder: RunFolder, head: Mapping[str, Any]) -> Path:
    """Return the archive of a run; of a rescored run, by its ``run.json``, that of the images. It need not exist.

    Raises ``DamagedFileError`` if ``run.json`` names something that is no archive.
    """
    elsewhere = head.get("archive")
    if elsewhere is None:
        return folder.archive
    root = folder.root / str(elsewhere)
    kind = files.kind_at(root, links=True)
    if not isinstance(elsewhere, str) or kind not in ("a folder", "") or (kind and not Store(root).is_one()):
        raise DamagedFileError(f"names {excerpt(str(elsewhere))!r}, which is no archive", where=str(folder.suite))
    return root


def open_archive(folder: Path, *, follow: bool = True) -> Store:
    """Return the archive that a folder is or holds; ``UserError`` if there is none.

    With ``follow`` a folder of rescored results gives the archive of their images, read-only.
    """
    head: dict[str, Any] = {}
    if follow:
        with contextlib.suppress(UserError):  # A damaged one names nothing; `verify` tells that it is.
            head = read_json(RunFolder(folder).suite) or {}
    inside = archive_of(RunFolder(folder), head)
    root = inside if inside.is_dir() else folder
    expected = "an archive, or the folder of a run"
    if not root.is_dir():
        kind = files.kind_at(root, links=True)
        raise UserError(f"is {kind}" if kind else "no such folder", where=str(folder), expected=expected)
    store = Store(root, read_only=inside.parent != folder)
    if root.resolve().name != "archive" and not store.is_one():
        raise UserError("holds no archive", where=str(folder), expected=expected)
    return store


def archive_of_results(folder: Path) -> Store | None:
    """Return the archive of a folder of results, whatever its files say; None where it has none."""
    run = RunFolder(folder)
    try:
        elsewhere = isinstance((read_json(run.suite) or {}).get("archive"), str)
    except UserError:
        elsewhere = False
    if run.archive.is_dir() or (named_addresses(run) and not elsewhere):
        return Store(run.archive)
    return open_archive(folder) if elsewhere else None


def named_addresses(folder: RunFolder, *, strict: bool = False) -> dict[str, str]:
    """Return the addresses that the results of a run name, each with the result.

    ``strict``, for deletion: ``DamagedFileError`` for an unreadable file, and every digest counts as an address.
    """
    named: dict[str, str] = {}
    for room, what in ((folder.state, "the rendered frame"), (folder.cases, "the case")):
        for path in sorted(room.glob("*.json")):
            try:
                content = read_json(path) or {}
            except UserError as error:
                if strict:
                    raise DamagedFileError(
                        f"{error.what}, so that nobody knows which entries it names",
                        where=str(path),
                        fix="make the run again, or delete this file",
                    ) from None
                continue
            named |= dict.fromkeys(_addresses(content, strict), f"{what} {path.stem!r}")
    return named


def _addresses(record: dict[str, Any], everywhere: bool) -> Iterator[str]:
    """Yield the addresses in a record; ``everywhere`` takes whatever looks like one, other digests included."""
    waiting: list[tuple[bool, Any]] = [(everywhere, record)]
    while waiting:
        counts, value = waiting.pop()
        if isinstance(value, dict):
            waiting += [(counts or key in _NAMING, v) for key, v in value.items()]
        elif isinstance(value, list):
            waiting += [(counts, v) for v in value]
        elif counts and isinstance(value, str) and is_address(value):
            yield value


def garbage(folder: RunFolder) -> Garbage:
    """Return the files of a run's archive that no result names. The caller holds the folder's lock.

    Raises ``UserError`` if a result cannot be read or is missing, or the archive is a link, which other runs may use.
    """
    root = folder.archive
    if root.is_symlink():
        raise UserError("is a link: other runs may use it", where=str(root), expected="an archive of one run")
    manifest = read_json(folder.root / "manifest.json") or {}
    for name in manifest.get("files", ()):
        if name.startswith(("cases/", "state/")) and files.kind_at(folder.root / name) != "a file":
            raise UserError(
                "is missing, but the manifest names it; which entries it uses is unknown",
                where=str(folder.root / name),
                fix="make the run again",
            )
    named = named_addresses(folder, strict=True)
    entries = places(root)
    unnamed = [path for path in entries if path.stem not in named]
    return Garbage((*unnamed, *atomic.leftovers(root)), len(entries) - len(unnamed))


def remove(found: Garbage, folder: RunFolder) -> None:
    """Remove garbage, its rows in the index and the folders it leaves empty. Call with the lock still held."""
    store = Store(folder.archive)
    for path in found.files:
        if not files.is_inside(path, store.root):
            raise UserError("a link on the way leads out of the archive", where=str(path), fix="remove the link")
        try:
            path.unlink(missing_ok=True)
            if path.parent != store.root and not any(path.parent.iterdir()):
                path.parent.rmdir()
        except OSError as error:
            raise UserError(f"cannot be removed: {error.strerror}", where=str(path)) from None
    store.index.forget(path.stem for path in found.files)
