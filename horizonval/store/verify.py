"""Look for everything in an archive that should not be so, and for everything that should be there and is not.

Bytes are compared with addresses, so that a file under a wrong name is recognised by what it holds::

    damaged     at an entry's place, but not what was added there; a link, a folder, a FIFO or a device included
    misplaced   an intact entry under a name that is not its own
    missing     not at its place, and not misplaced, though the index or somebody else names it
    duplicate   a copy of an intact entry, or the same pixels and truth as another entry
    foreign     anything else that is no entry
    leftover    of an interrupted write
    unreadable  a folder that may not be looked into, or a file that may not be read: nobody knows what is there
    index       a row of the index that is not what the header says
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from horizonval.core import atomic, files
from horizonval.core.errors import UserError, command_line, printable
from horizonval.core.progress import Progress, Silent
from horizonval.store import exr
from horizonval.store.entry import INDEX_PREFIX, StoreEntry, describe, is_address, place
from horizonval.store.index import NAME, Index

Problem = Literal[
    "damaged", "misplaced", "missing", "duplicate", "foreign", "leftover", "unreadable", "index", "unfinished", "older"
]


@dataclass(frozen=True)
class StoreFinding:
    """One thing that should not be so; ``message`` is one line, ``address`` the entry that is concerned, if any."""

    path: Path
    problem: Problem
    message: str
    address: str = ""


@dataclass(frozen=True)
class _File:
    """A file of the folder: its digest, and why it is not an intact file of ours (empty if it is one)."""

    path: Path
    digest: str
    reason: str
    readable: bool = True


def verify(root: Path, named: Mapping[str, str] | None = None, progress: Progress | None = None) -> list[StoreFinding]:
    """Read everything below ``root`` and return what is wrong, in the order of paths; nothing is changed.

    Only regular files are opened and no link is followed; whatever else lies there is a finding.

    Parameters
    ----------
    root : Path
    named : mapping of str to str, optional
        Addresses that somebody counts on, and who that is; those of the index are added.
    progress : Progress, optional
    """
    findings, known = _known(root)
    paths, unreadable = _walk(root)
    findings += unreadable
    expected = dict.fromkeys(known, "the index") | dict(named or {})
    intact: dict[str, StoreEntry] = {}
    strays: list[_File] = []
    listener = progress or Silent()
    listener.start(len(paths), 0)
    for path in paths:
        listener.done(printable(path.name))
        if path.parent == root and path.name.startswith(INDEX_PREFIX):
            continue
        if atomic.is_temporary(path):
            findings.append(
                StoreFinding(path, "leftover", f"{_shown(path, root)}: left by an interrupted write; delete it")
            )
            continue
        file = _looked_at(path)
        if _is_place(path, root) and file.digest == path.stem and not file.reason:
            entry = describe(path)
            if entry.kind != "damaged":
                intact[path.stem] = entry
                continue
            file = replace(file, reason="its header says what no writer of ours writes")
        strays.append(file)
    home: dict[str, Path] = {}
    for file in strays:
        findings.append(_stray(file, root, intact, expected, home))
    findings += _same_content(root, intact, expected)
    findings += _stale_rows(root, intact, known)
    bytes_at = {file.digest: file.path for file in strays if not file.reason}
    accounted = {f.address for f in findings if f.problem in ("damaged", "misplaced", "unreadable")}
    closed = {f.path for f in unreadable}
    for address, who in expected.items():
        if address not in intact and address not in accounted and is_address(address):
            where = place(root, address)
            if closed & {root, where.parent}:
                continue
            hint = f"; its bytes lie at {_shown(bytes_at[address], root)}" if address in bytes_at else ""
            message = f"{_shown(where, root)}: not there, though {who} names it{hint}"
            findings.append(StoreFinding(where, "missing", message, address))
    return sorted(findings, key=lambda finding: finding.path)


def _walk(root: Path) -> tuple[list[Path], list[StoreFinding]]:
    """Return, in order, everything that is no folder or lies where an entry should, and the folders that stay closed.

    A link to a folder is not followed, for what it leads to is none of ours.
    """
    paths: list[Path] = []
    closed: list[StoreFinding] = []

    def refused(error: OSError) -> None:
        if isinstance(error, FileNotFoundError):
            return
        path = Path(os.fsdecode(error.filename))
        closed.append(StoreFinding(path, "unreadable", f"{_shown(path, root)}: cannot be listed: {error.strerror}"))

    for folder, folders, names in os.walk(root, onerror=refused):
        paths += [Path(folder, name) for name in names]
        inside = [Path(folder, name) for name in folders]
        paths += [path for path in inside if path.is_symlink() or _is_place(path, root)]
    return sorted(paths), closed


def _shown(path: Path, root: Path) -> str:
    return printable(path.relative_to(root).as_posix())


def _is_place(path: Path, root: Path) -> bool:
    return path.suffix == ".exr" and is_address(path.stem) and path == place(root, path.stem)


def _looked_at(path: Path) -> _File:
    try:
        digest = files.sha256_of(path, links=False)
    except UserError as error:
        return _File(path, "", error.what, readable=not isinstance(error, files.UnreadableFileError))
    try:
        return _File(path, digest, _damage(path))
    except UserError as error:
        return _File(path, digest, error.what)


def _damage(path: Path) -> str:
    """Return why a file is not what a writer of ours wrote, or nothing; it may be raised as well."""
    kind = exr.kind(path)
    if kind == "foreign":
        return "an EXR file, but not written by horizonval"
    if kind == "image":
        exr.read_image(path)
    else:
        exr.read_frame(path)
    return ""


def _stray(
    file: _File, root: Path, intact: Mapping[str, StoreEntry], expected: Mapping[str, str], home: dict[str, Path]
) -> StoreFinding:
    """Say what a file is that is no intact entry at its place.

    ``home`` has the files that were told to be misplaced entries; this one is added if it is one.
    """
    path, shown = file.path, _shown(file.path, root)
    if not file.readable:
        return StoreFinding(path, "unreadable", f"{shown}: {file.reason}", path.stem if _is_place(path, root) else "")
    if file.reason or not file.digest:
        if _is_place(path, root):
            return StoreFinding(path, "damaged", f"{shown}: {file.reason}", path.stem)
        return StoreFinding(path, "foreign", f"{shown}: does not belong here: {file.reason}")
    proper = _shown(place(root, file.digest), root)
    if _is_place(path, root) and path.stem in expected:
        message = f"{shown}: its bytes are not those of its address, but those of {proper}"
        return StoreFinding(path, "damaged", message, path.stem)
    if file.digest in intact:
        return StoreFinding(path, "duplicate", f"{shown}: a copy of {proper}", file.digest)
    if file.digest in home:
        return StoreFinding(path, "duplicate", f"{shown}: a copy of {_shown(home[file.digest], root)}", file.digest)
    home[file.digest] = path
    return StoreFinding(path, "misplaced", f"{shown}: belongs at {proper}", file.digest)


def _same_content(root: Path, intact: Mapping[str, StoreEntry], expected: Mapping[str, str]) -> list[StoreFinding]:
    """Tell entries whose pixels and truth are those of another one, compressed otherwise; one that is named stays."""
    groups: dict[str, list[str]] = {}
    for address, entry in intact.items():
        groups.setdefault(entry.content, []).append(address)
    findings = []
    for addresses in groups.values():
        first, *others = sorted(addresses, key=lambda address: (address not in expected, address))
        for address in others:
            path = place(root, address)
            message = f"{_shown(path, root)}: the pixels and truth of {_shown(place(root, first), root)} once more"
            findings.append(StoreFinding(path, "duplicate", message, address))
    return findings


def _known(root: Path) -> tuple[list[StoreFinding], dict[str, StoreEntry]]:
    index = Index(root)
    try:
        return [], index.known() or {}
    except UserError as error:
        fix = f"; {error.fix}" if error.fix else ""
        return [StoreFinding(index.path, "index", f"{NAME}: {error.what}{fix}")], {}


def _stale_rows(root: Path, intact: Mapping[str, StoreEntry], known: Mapping[str, StoreEntry]) -> list[StoreFinding]:
    stale = [address for address, entry in known.items() if address in intact and intact[address] != entry]
    stale += [address for address in known if not is_address(address)]
    if not stale:
        return []
    message = (
        f"{NAME}: {len(stale)} rows are not what the headers say, such as that of {stale[0]}; "
        f"run {command_line('archive', 'reindex', root)}"
    )
    return [StoreFinding(root / NAME, "index", message)]
