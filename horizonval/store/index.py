"""Index of an archive: the content of all headers, in a sealed JSON file in the archive.

It lists an archive without opening every file, and it remembers entries, so that missing files are noticed. All rows
come from headers (:func:`horizonval.store.entry.describe`) and never change, because an address is the digest of the
file. An index that is lost or out of date is completed; a damaged one is rebuilt from the headers, which is logged. If
two processes write it at once, the last one wins, and the next reader adds missing rows.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path

from horizonval.core import atomic, sealed
from horizonval.core.errors import DamagedFileError, UserError, command_line, printable
from horizonval.core.json_types import typed
from horizonval.core.progress import Progress, Silent
from horizonval.store.entry import INDEX_PREFIX, StoreEntry, describe, places
from horizonval.store.folder import read_json

NAME = f"{INDEX_PREFIX}json"

_LOG = logging.getLogger("horizonval")


@dataclass(frozen=True)
class Filter:
    """Which entries are wanted; what is None does not matter. Names may hold ``*`` and ``?``."""

    kind: str | None = None
    scene: str | None = None
    camera: str | None = None
    head: str | None = None
    band: str | None = None
    seed: str | None = None
    since: str | None = None
    until: str | None = None

    def of(self, entries: Iterable[StoreEntry]) -> list[StoreEntry]:
        """Return the entries that are wanted; ``UserError`` for a time that is none."""
        since = "" if self.since is None else _instant(self.since, "--since")
        until = None if self.until is None else _instant(self.until, "--until")
        patterns = {"scene": self.scene, "camera": self.camera, "head": self.head}
        return [
            entry
            for entry in entries
            if self.kind in (None, entry.kind)
            and self.seed in (None, entry.seed)
            and self.band in (None, *entry.bands)
            and since <= entry.epoch_utc
            and (until is None or entry.epoch_utc <= until)
            and all(one is None or fnmatchcase(getattr(entry, name), one) for name, one in patterns.items())
        ]


class Index:
    """The index of the archive at ``root``; made when it is needed, or else (``read_only``) only used."""

    def __init__(self, root: Path, *, read_only: bool = False) -> None:
        self.root, self.read_only = root, read_only
        self.path = root / NAME

    def known(self) -> dict[str, StoreEntry] | None:
        """Return rows by address, None without an index; ``DamagedFileError`` if it was changed."""
        fix = f"run {command_line('archive', 'reindex', self.root)}"
        try:
            content = read_json(self.path, fix=fix)
            if content is None:
                return None
            rows = [typed(StoreEntry(**{**row, "bands": tuple(row["bands"])})) for row in content["entries"]]
        except UserError as error:
            raise DamagedFileError(f"the index cannot be used ({error.what})", where=error.where, fix=fix) from None
        except (TypeError, KeyError):
            raise DamagedFileError("the index is of another version", where=str(self.path), fix=fix) from None
        return {row.address: row for row in rows}

    def update(self, progress: Progress | None = None) -> dict[str, StoreEntry]:
        """Add the rows of new entries and return all rows; an unwritable index stays, an empty one is not made."""
        known, damage = {}, None
        try:
            known = self.known() or {}
        except UserError as error:
            damage = error
        new = [path for path in places(self.root) if path.stem not in known]
        rows = known | _described(new, progress)
        if (new or damage) and not self.read_only and not self._write(rows) and damage:
            _LOG.warning(
                "horizonval: %s: %s; it was made again from the headers of %d entries, and what was gone before is not "
                "missed any more",
                printable(damage.where),
                damage.what,
                len(rows),
            )
        return rows

    def rebuild(self, progress: Progress | None = None) -> int:
        """Rebuild the index from the headers and return the number of rows; ``UserError`` if it cannot be written."""
        rows = _described(places(self.root), progress)
        if problem := self._write(rows):
            raise UserError(f"the index cannot be written: {problem}", where=str(self.path))
        return len(rows)

    def forget(self, addresses: Iterable[str]) -> None:
        """Drop rows whose files were removed on purpose."""
        gone, rows = {*addresses}, self.update()
        self._write({address: row for address, row in rows.items() if address not in gone})

    def select(self, wanted: Filter | None = None, progress: Progress | None = None) -> list[StoreEntry]:
        """Return the entries of a filter in the order of addresses, including missing files.

        The index is completed first. If it cannot be written, the headers are read each time.
        """
        there = {path.stem for path in places(self.root)}
        rows = self.update(progress)
        # What may not be read has no row, and is not to be overlooked.
        unknown = {address: StoreEntry(address, "damaged", 0) for address in there.difference(rows)}
        entries = (wanted or Filter()).of(sorted((rows | unknown).values(), key=lambda entry: entry.address))
        return [entry if entry.address in there else replace(entry, kind="missing") for entry in entries]

    def _write(self, rows: Mapping[str, StoreEntry]) -> str:
        """Write the index and return why it cannot be written, if so."""
        content = {"entries": [asdict(rows[address]) for address in sorted(rows)]}
        try:
            atomic.write_bytes(self.path, sealed.json_bytes(content, indent=None, name=NAME))
        except atomic.WriteError as error:
            return error.reason
        return ""


def _described(paths: list[Path], progress: Progress | None) -> dict[str, StoreEntry]:
    listener, entries = progress or Silent(), {}
    listener.start(len(paths), 0)
    for path in paths:
        with contextlib.suppress(OSError, UserError):  # Removed meanwhile, or not readable: nothing is known of it.
            entries[path.stem] = describe(path)
        listener.done(path.name)
    return entries


def _instant(text: str, where: str) -> str:
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise UserError(f"found {text!r}", where=where, expected="a date or time, such as 2026-03-20T12:00") from None
    return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).astimezone(UTC).isoformat()
