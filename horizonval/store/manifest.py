"""What a finished folder of results holds: ``manifest.json`` has the digest of every file, and is written last.

It is withdrawn before anything in the folder changes. So a folder with a manifest is whole, and one without was cut off
(or is being worked on): then only what has a seal of its own can be checked. Frames and images are not in it; they are
named by their digests, and :mod:`horizonval.store.verify` looks after them.

Findings, beside those of an archive::

    unfinished  there is no manifest
    older       a folder of a version that sealed nothing; nothing else of it is looked at
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from horizonval.core import atomic, files, sealed
from horizonval.core.errors import DamagedFileError, UserError, printable
from horizonval.core.progress import Progress, Silent
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.index import Index
from horizonval.store.verify import StoreFinding

NAME = "manifest.json"
SCHEMA = 1
HEADS = (NAME, "run.json", "night.json")
"""Files by any of which a folder is known for one of results."""

_RECORDS = ("cases", "state", "stability", "information")
"""Rooms whose records say their own names: those of cases that are no part of the suite any more may stay there."""
_ROOMS = {*_RECORDS, "report", ".work"}
_LOCK = re.compile(r"(\.work/)?\.lock(-\d+-of-\d+)?")
_KNOWN = re.compile(
    r"(run|summary|timings(-\d+-of-\d+)?|study|study-plan|study-costs|study-information|night|verdict|stability/result)\.json"
    r"|results\.parquet|designs\.csv|junit\.xml|index\.html|history\.jsonl|(report|\.work)/.*"
)
"""What the folder of a run that was cut off may hold beside its records."""


def is_results_folder(root: Path) -> bool:
    """Whether a folder is one of results, by the names in it."""
    return any(files.kind_at(root / name) for name in HEADS)


def write_manifest(root: Path, paths: Iterable[Path]) -> None:
    """Write down what a folder holds: files of it that are there, those that are not left out."""
    there = (path for path in paths if files.kind_at(path) == "a file")
    _write(root, {_name(path, root): _digest(path) for path in there})


def amend_manifest(root: Path, paths: Iterable[Path]) -> None:
    """Write down that files of a finished folder were made again, or removed; nothing where there is no manifest."""
    try:
        entries = _entries(root)
    except UserError:
        return
    if entries is None:
        return
    before = dict(entries)
    for path in paths:
        entries.pop(_name(path, root), None)
        if files.kind_at(path) == "a file":
            entries[_name(path, root)] = _digest(path)
    if entries != before:
        _write(root, entries)


def amend_index(index: Index) -> None:
    """Write down that the index of a finished run's archive was made again, or has caught up, if it has."""
    if index.written:
        amend_manifest(index.root.parent, [index.path])
        index.written = False


def withdraw_manifest(root: Path) -> None:
    """Take the manifest away before the folder changes."""
    path = root / NAME
    if files.kind_at(path) == "a folder":
        path.rmdir()
    else:
        path.unlink(missing_ok=True)


def verify_folder(root: Path, progress: Progress | None = None) -> list[StoreFinding]:
    """Return what is wrong in a folder of results but for its archive, in the order of paths; nothing is changed."""
    findings: list[StoreFinding] = []
    entries: dict[str, str] | None = None
    try:
        entries = _entries(root)
        if entries is None:
            if _is_older(root):
                what = (
                    "of an earlier version, which sealed nothing; its suite, run into this folder again, makes it anew"
                )
                return [StoreFinding(root, "older", f"{printable(root.name)}: {what}")]
            findings.append(_finding(root / NAME, root, "unfinished", "not there; the run is to be finished"))
    except UserError as error:
        findings.append(_finding(root / NAME, root, "damaged", error.what))
    paths = list(_walk(root, entries or {}, findings))
    listener = progress or Silent()
    listener.start(len(paths), 0)
    for path in paths:
        listener.done(printable(path.name))
        name = _name(path, root)
        if name == NAME:
            continue
        if atomic.is_temporary(path):
            findings.append(_finding(path, root, "leftover", "left by an interrupted write; delete it"))
            continue
        problem = _problem(path, name, entries)
        if problem:
            kind: str = "foreign" if problem == _FOREIGN else "damaged"
            findings.append(_finding(path, root, kind, problem))
    seen = {_name(path, root) for path in paths} | {NAME}
    for name in sorted(set(entries or {}) - seen):
        if not any(name.startswith(f"{other}/") for other in seen):
            problem = _problem(root / name, name, entries) if files.kind_at(root / name) else ""
            if problem:
                findings.append(_finding(root / name, root, "damaged", problem))
            elif not files.kind_at(root / name):
                findings.append(_finding(root / name, root, "missing", "not there, though the manifest names it"))
    return sorted(findings, key=lambda finding: finding.path)


_FOREIGN = "does not belong here"


def _problem(path: Path, name: str, entries: Mapping[str, str] | None) -> str:
    """Return what is wrong with something that lies in a folder, or nothing."""
    try:
        if _LOCK.fullmatch(name):
            return "the file of a lock is empty" if files.read_bytes(path, largest=1 << 20, links=False) else ""
        if entries is not None and name in entries:
            return "" if _digest(path) == entries[name] else "altered since the folder was finished"
        room, _, rest = name.rpartition("/")
        if room in _RECORDS and rest.endswith(".json") and name != "stability/result.json":
            return "" if read_json(path).get("case") == path.stem else _FOREIGN
        if entries is not None or not _KNOWN.fullmatch(name):
            return _FOREIGN
        if path.suffix in (".json", ".parquet", ".npz"):
            bound = path.name if path.suffix == ".json" else ""
            sealed.check(files.read_bytes(path, largest=1 << 34, links=False), path, bound)
        else:
            files.open_file(path, links=False).close()
    except UserError as error:
        return error.what
    return ""


def _walk(root: Path, entries: Mapping[str, str], findings: list[StoreFinding]) -> Iterator[Path]:
    """Yield everything but folders of ours, which are entered, and the archive; what stays closed is a finding."""

    def refused(error: OSError) -> None:
        findings.append(_finding(Path(os.fsdecode(error.filename)), root, "unreadable", f"{error.strerror}"))

    rooms = _ROOMS | {parent.as_posix() for name in entries for parent in Path(name).parents}
    for folder, folders, names in os.walk(root, onerror=refused):
        if Path(folder) == root and "archive" in folders:
            folders.remove("archive")
        for name in sorted(folders):
            path = Path(folder, name)
            if path.is_symlink() or _name(path, root) not in rooms:
                folders.remove(name)
                yield path
        yield from (Path(folder, name) for name in sorted(names))


def _is_older(root: Path) -> bool:
    """Whether the head of a folder is that of an earlier version: good JSON without a seal."""
    for path in (root / name for name in HEADS[1:]):
        try:
            read_json(path)
        except sealed.UnsealedFileError:
            try:
                # A damaged seal keeps one half of its key's name; other keys have neither.
                prefix, _, word = sealed.KEY.partition(":")
                return not any(key.startswith(prefix) or key.endswith(word) for key in read_json(path, bound=False))
            except UserError:
                return False
        except UserError:
            return False
    return False


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
    return files.sha256_of(path, links=False)


def _name(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def _finding(path: Path, root: Path, problem: str, what: str) -> StoreFinding:
    return StoreFinding(path, problem, f"{printable(_name(path, root))}: {what}")  # type: ignore[arg-type]


def files_of_run(folder: RunFolder) -> list[Path]:
    """Return what the folder of every run holds in the end, but for the records of its cases and its pages."""
    timings = sorted(folder.root.glob("timings-*-of-*.json"))
    index = sorted(folder.archive.glob("index.sqlite")) if files.kind_at(folder.archive) == "a folder" else []
    return [folder.suite, folder.summary, folder.results, folder.timings, *timings, *index]
