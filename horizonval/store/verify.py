"""Everything wrong in an archive or a folder of results.

An entry of an archive is named by the digest of its bytes. For the rest of a folder of results ``manifest.json`` has
one digest per file; it is written last, and removed before anything in the folder changes. So a folder with a manifest
is complete, and one without was interrupted (or is in use): then only sealed files (:mod:`horizonval.core.sealed`) can
be checked. The index of the archive is sealed and may change at any time, so the manifest has its name alone.
Findings::

    damaged     changed since it was written; also a link, a folder, a FIFO or a device
    missing     not there, though the manifest, the index or a result names it
    foreign     anything that does not belong there
    leftover    of an interrupted write
    unreadable  a folder or an entry without read permission
    index       the index cannot be used
    unfinished  there is no manifest

Only regular files are opened, no link is followed, and nothing is changed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from horizonval.core import atomic, files, sealed
from horizonval.core.errors import DamagedFileError, UserError, printable
from horizonval.core.progress import Progress, Silent
from horizonval.store import exr, index
from horizonval.store.entry import INDEX_PREFIX, describe, is_address, place
from horizonval.store.folder import RunFolder, read_json, write_json

NAME = "manifest.json"
SCHEMA = 2
HEADS = (NAME, "run.json", "night.json")
"""Files by any of which a folder is known for one of results."""

_RECORDS = ("cases", "state", "stability", "information")
"""Rooms of records, which are sealed with their names: those of cases that left the suite may stay there."""
_ROOMS = {*_RECORDS, "report", ".work"}
_LOCK = re.compile(r"(\.work/)?\.lock(-\d+-of-\d+)?")
_SEALED = (".json", ".parquet", ".npz")
_FOREIGN = "does not belong here"


@dataclass(frozen=True)
class Finding:
    """One thing that should not be so; ``message`` is one line, ``address`` the entry that is concerned, if any."""

    path: Path
    problem: Literal["damaged", "missing", "foreign", "leftover", "unreadable", "index", "unfinished"]
    message: str
    address: str = ""


def verify_archive(
    root: Path, named: Mapping[str, str] | None = None, progress: Progress | None = None
) -> list[Finding]:
    """Read everything below ``root`` and return what is wrong, in the order of paths.

    ``named`` maps addresses that must exist to who needs them; those of the index are added.
    """
    findings: list[Finding] = []
    expected: dict[str, str] = {}
    try:
        expected = dict.fromkeys(index.Index(root).known() or {}, "the index")
    except UserError as error:
        findings.append(_finding(root / index.NAME, root, "index", f"{error.what}; {error.fix}"))
    expected |= named or {}
    seen: set[Path] = set()
    for path in _walk(root, lambda folder: not _is_place(folder, root), findings, progress):
        if path.parent == root and path.name.startswith(INDEX_PREFIX):
            continue
        if not _is_place(path, root):
            findings.append(_finding(path, root, "foreign", _FOREIGN))
            continue
        seen.add(path)
        try:
            digest = files.sha256_of(path, links=False)
            exr.read(path)
            if digest != path.stem:
                raise DamagedFileError("its bytes are not those of its address")
            if describe(path).kind == "damaged":
                raise DamagedFileError("its header says what no writer of ours writes")
        except files.UnreadableFileError as error:
            findings.append(_finding(path, root, "unreadable", error.what, path.stem))
        except UserError as error:
            findings.append(_finding(path, root, "damaged", error.what, path.stem))
    closed = {finding.path for finding in findings if finding.problem == "unreadable"}
    for address, who in expected.items():
        if is_address(address) and (path := place(root, address)) not in seen and not closed & {root, path.parent}:
            findings.append(_finding(path, root, "missing", f"not there, though {who} names it", address))
    return sorted(findings, key=lambda finding: finding.path)


def is_results_folder(root: Path) -> bool:
    """Whether a folder is one of results, by the names in it."""
    return any(files.kind_at(root / name) for name in HEADS)


def files_of_run(folder: RunFolder) -> list[Path]:
    """Return what the folder of every run holds in the end, but for the records of its cases and its pages."""
    timings = sorted(folder.root.glob("timings-*-of-*.json"))
    return [folder.suite, folder.summary, folder.results, folder.timings, *timings, folder.archive / index.NAME]


def write_manifest(root: Path, paths: Iterable[Path]) -> None:
    """Write down what a folder holds: files of it that are there, those that are not left out."""
    _write(root, {_name(path, root): _digest(path) for path in paths if files.kind_at(path) == "a file"})


def amend_manifest(root: Path, paths: Iterable[Path]) -> None:
    """Write down that files of a finished folder were made again, or removed; nothing where there is no manifest."""
    try:
        before = _entries(root)
    except UserError:
        return
    if before is None:
        return
    paths = [*paths]
    kept = {name: digest for name, digest in before.items() if name not in {_name(path, root) for path in paths}}
    entries = kept | {_name(path, root): _digest(path) for path in paths if files.kind_at(path) == "a file"}
    if entries != before:
        _write(root, entries)


def withdraw_manifest(root: Path) -> None:
    """Take the manifest away before the folder changes."""
    path = root / NAME
    if files.kind_at(path) == "a folder":
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def verify_folder(root: Path, progress: Progress | None = None) -> list[Finding]:
    """Return what is wrong in a folder of results but for the entries of its archive, in the order of paths."""
    findings: list[Finding] = []
    entries: dict[str, str] | None = None
    try:
        entries = _entries(root)
        if entries is None:
            findings.append(_finding(root / NAME, root, "unfinished", "not there; the run is to be finished"))
    except UserError as error:
        findings.append(_finding(root / NAME, root, "damaged", error.what))
    rooms = _ROOMS | {parent.as_posix() for name in entries or {} for parent in Path(name).parents}
    rooms -= {"archive"}
    seen = {NAME, "archive"}
    for path in _walk(root, lambda folder: _name(folder, root) in rooms, findings, progress):
        name = _name(path, root)
        if name not in seen and (problem := _problem(path, name, entries)):
            findings.append(_finding(path, root, "foreign" if problem == _FOREIGN else "damaged", problem))
        seen.add(name)
    for name in sorted(set(entries or {}) - seen):
        if not files.kind_at(root / name):
            findings.append(_finding(root / name, root, "missing", "not there, though the manifest names it"))
    return sorted(findings, key=lambda finding: finding.path)


def _problem(path: Path, name: str, entries: Mapping[str, str] | None) -> str:
    """Return what is wrong with something that lies in a folder of results, or nothing."""
    try:
        if _LOCK.fullmatch(name):
            return "the file of a lock is empty" if files.read_bytes(path, largest=1 << 20, links=False) else ""
        if entries is not None and name in entries:
            return "" if _digest(path) == entries[name] else "altered since the folder was finished"
        if entries is not None and (name.rpartition("/")[0] not in _RECORDS or path.suffix != ".json"):
            return _FOREIGN
        files.ensure_file(path, links=False)
        if path.suffix in _SEALED:
            bound = path.name if path.suffix == ".json" else ""
            sealed.check(files.read_bytes(path, largest=1 << 34, links=False), path, bound)
    except UserError as error:
        return error.what
    return ""


def _walk(
    root: Path, enters: Callable[[Path], bool], findings: list[Finding], progress: Progress | None
) -> Iterator[Path]:
    """Yield what lies below a folder, in order, but for the folders that are entered, which are no links.

    Folders that stay closed and what interrupted writes left are findings.
    """

    def refused(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):
            path = Path(os.fsdecode(error.filename))
            findings.append(_finding(path, root, "unreadable", f"cannot be listed: {error.strerror}"))

    found = []
    for folder, folders, names in os.walk(root, onerror=refused):
        closed = [name for name in folders if Path(folder, name).is_symlink() or not enters(Path(folder, name))]
        folders[:] = [name for name in folders if name not in closed]
        found += [Path(folder, name) for name in (*names, *closed)]
    listener = progress or Silent()
    listener.start(len(found), 0)
    for path in sorted(found):
        listener.done(printable(path.name))
        if atomic.is_temporary(path):
            findings.append(_finding(path, root, "leftover", "left by an interrupted write; delete it"))
        else:
            yield path


def _is_place(path: Path, root: Path) -> bool:
    return path.suffix == ".exr" and is_address(path.stem) and path == place(root, path.stem)


def _entries(root: Path) -> dict[str, str] | None:
    content = read_json(root / NAME)
    if content is None:
        return None
    entries = content.get("files")
    if not isinstance(entries, dict) or not all(
        isinstance(digest, str) and not Path(name).is_absolute() and ".." not in Path(name).parts
        for name, digest in entries.items()
    ):
        raise DamagedFileError("names what is no file of the folder", where=str(root / NAME))
    return dict(entries)


def _write(root: Path, entries: Mapping[str, str]) -> None:
    write_json(root / NAME, {"schema": SCHEMA, "files": entries})


def _digest(path: Path) -> str:
    """Return a file's digest; of the archive's index nothing, which changes whenever somebody lists the archive."""
    return "" if path.parent.name == "archive" and path.name == index.NAME else files.sha256_of(path, links=False)


def _name(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def _finding(path: Path, root: Path, problem: str, what: str, address: str = "") -> Finding:
    return Finding(path, problem, f"{printable(_name(path, root))}: {what}", address)  # type: ignore[arg-type]
