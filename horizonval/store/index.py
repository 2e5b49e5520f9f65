"""Index of an archive: a table of what the headers say, in an SQLite file beside the entries.

It answers what an archive holds without opening every file, and it remembers what was there, so that a file that is
gone is missed. Everything in it comes from the headers (:func:`horizonval.store.entry.describe`): a lost index is
built again, and an index that lags behind catches up, with the same rows.

Every writer adds its row in a transaction of its own, and SQLite lets one process write at a time: two runs that add at
once lose nothing. A row that cannot be written (a disc without write permission, a lock held for long) is left out:
the entry is what counts, and whoever reads the index next finds that the row is missing and adds it.

SQLite does not notice every damage of its file: a block of zeros may be a row of other values, or no row. So each row
has a digest of its values and the table the sum of them, which reading compares. An index that is damaged, or that is
no regular file, is made again by whoever would add to it, which is logged; what it knew of files that were gone by
then is lost with it.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.core.errors import DamagedFileError, UserError, command_line, printable
from horizonval.core.progress import Progress, Silent
from horizonval.store.entry import INDEX_PREFIX, StoreEntry, describe, places

NAME = f"{INDEX_PREFIX}sqlite"
VERSION = 2
"""Of the table; an index of another version is made anew."""
PATIENCE_S = 10.0
"""How long to wait for another process that is writing: a transaction takes milliseconds."""

_NO_DAMAGE = {
    sqlite3.SQLITE_PERM,
    sqlite3.SQLITE_BUSY,
    sqlite3.SQLITE_LOCKED,
    sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_IOERR,
    sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN,
}
"""SQLite's errors that speak of the system and not of the file's content."""

_LOG = logging.getLogger("horizonval")
_BESIDE = ("-journal", "-wal", "-shm")
"""What SQLite keeps beside a file while it writes."""

_COLUMNS = [f.name for f in fields(StoreEntry)]
_INTEGERS = {"size_bytes", "schema", "width", "height"}
_TABLE = "CREATE TABLE entries ({}, row_digest INTEGER NOT NULL) WITHOUT ROWID".format(
    ", ".join(
        f'"{name}" {"INTEGER" if name in _INTEGERS else "TEXT"} NOT NULL{" PRIMARY KEY" if name == "address" else ""}'
        for name in _COLUMNS
    )
)
_TOTAL = "CREATE TABLE total (count INTEGER NOT NULL, row_digests INTEGER NOT NULL)"
"""One row: of how many rows the table is, and the sum of their digests, modulo :data:`_MODULUS`."""
_MODULUS = 2**62
_INSERT = f"INSERT OR REPLACE INTO entries VALUES ({', '.join('?' * (len(_COLUMNS) + 1))})"


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

    def sql(self) -> tuple[str, list[str]]:
        """Return the condition and its values."""
        terms, values = [], []
        for column, wanted, operator in (
            ("kind", self.kind, "="),
            ("scene", self.scene, "GLOB"),
            ("camera", self.camera, "GLOB"),
            ("head", self.head, "GLOB"),
            ("seed", self.seed, "="),
            ("epoch_utc", None if self.since is None else _instant(self.since, "--since"), ">="),
            ("epoch_utc", None if self.until is None else _instant(self.until, "--until"), "<="),
        ):
            if wanted is not None:
                terms.append(f"{column} {operator} ?")
                values.append(wanted)
        if self.band is not None:
            terms.append("instr(',' || bands || ',', ',' || ? || ',') > 0")
            values.append(self.band)
        return " AND ".join(terms) or "TRUE", values


class Index:
    """The index of the archive at ``root``; made when it is needed, or else (``read_only``) only used.

    ``written`` tells whether this object has changed the file.
    """

    def __init__(self, root: Path, *, read_only: bool = False) -> None:
        self.root, self.read_only, self.written = root, read_only, False
        self.path = root / NAME

    def record(self, entry: StoreEntry) -> None:
        """Add or replace a row; where that is impossible, leave it to :meth:`update`."""
        with contextlib.suppress(sqlite3.Error, UserError), self._open() as connection:
            _put(connection, [entry])

    def forget(self, addresses: Iterable[str]) -> None:
        """Drop rows whose files were removed on purpose."""
        try:
            with self._reported(), self._open() as connection:
                _drop(connection, list(addresses))
        except DamagedFileError as error:
            self._make_again(error, None)

    def known(self) -> dict[str, StoreEntry] | None:
        """Return every row by address, as they stand; None where there is no index.

        Raises
        ------
        DamagedFileError
            The index is not what was written, or no regular file.
        UserError
            It cannot be used: without permission, or locked for long.
        """
        if not files.kind_at(self.path):
            return None
        with self._reported(), self._open(write=False) as connection:
            if not _is_current(connection):
                return None
            _check(connection)
            return {entry.address: entry for entry in _select(connection)}

    def update(self, progress: Progress | None = None) -> None:
        """Add the rows of entries that are not in the index; nothing is dropped, and no index made of no entries.

        A damaged index is made again.
        """
        try:
            self._catch_up(progress)
        except DamagedFileError as error:
            self._make_again(error, progress)

    def _make_again(self, error: DamagedFileError, progress: Progress | None) -> None:
        count = self.rebuild(progress)
        _LOG.warning(
            "horizonval: %s: %s; it was made again from the headers of %d entries, and what was gone before is not "
            "missed any more",
            printable(error.where),
            error.what,
            count,
        )

    def _catch_up(self, progress: Progress | None) -> None:
        known = self.known()
        new = [path for path in places(self.root) if known is None or path.stem not in known]
        if not new and (known is not None or not files.kind_at(self.path)):
            return
        entries = list(_described(new, progress))
        with self._reported(), self._open() as connection:
            _put(connection, entries)

    def rebuild(self, progress: Progress | None = None) -> int:
        """Make the index anew from the headers alone and return the number of its rows."""
        entries = {entry.address: entry for entry in _described(places(self.root), progress)}
        if self._is_broken():
            self._replace(entries)
            return len(entries)
        with self._reported(), self._open() as connection:
            # The lock is ours now; what came while the headers were read is read here, and nothing comes after.
            late = [path for path in places(self.root) if path.stem not in entries]
            entries |= {entry.address: entry for entry in _described(late, None)}
            connection.execute("DELETE FROM entries")
            connection.execute("UPDATE total SET count = 0, row_digests = 0")
            _put(connection, [entries[address] for address in sorted(entries)])
        return len(entries)

    def _replace(self, entries: Mapping[str, StoreEntry]) -> None:
        """Put a new file in the place of one that cannot be used; what others add meanwhile is caught up with later."""
        try:
            with atomic.temporary_in(self.root) as temporary:
                index = Index(self.root)
                index.path = temporary
                with self._reported(), index._open() as connection:
                    _put(connection, [entries[address] for address in sorted(entries)])
                for ending in _BESIDE:
                    # What was half done to the old file must not be done to the new one.
                    self._beside(ending).unlink(missing_ok=True)
                atomic.move(temporary, self.path)
                self.written = True
        except OSError as error:
            raise UserError(f"the index cannot be written: {error.strerror}", where=str(self.path)) from None

    def _beside(self, ending: str) -> Path:
        return self.path.with_name(self.path.name + ending)

    def select(self, wanted: Filter | None = None, progress: Progress | None = None) -> list[StoreEntry]:
        """Return the entries that a filter leaves, in the order of addresses, those of files that are gone included.

        The index catches up first. On a medium that cannot be written it does so in memory.
        """
        if not self.root.is_dir():
            return []
        in_memory = self.read_only
        with contextlib.suppress(UserError):
            if not in_memory:
                in_memory = True
                self.update(progress)
                in_memory = not files.kind_at(self.path)
        with self._reported(), self._in_memory(progress) if in_memory else self._open(write=False) as connection:
            entries = list(_select(connection, wanted))
        there = {path.stem for path in places(self.root)}
        entries = [entry if entry.address in there else replace(entry, kind="missing") for entry in entries]
        if wanted in (None, Filter()):
            # What may not be read has no row, and is not to be overlooked.
            unknown = there.difference(entry.address for entry in entries)
            entries += [StoreEntry(address, "damaged", 0) for address in unknown]
            entries.sort(key=lambda entry: entry.address)
        return entries

    @contextlib.contextmanager
    def _in_memory(self, progress: Progress | None) -> Iterator[sqlite3.Connection]:
        try:
            known = self.known() or {}
        except UserError:
            known = {}
        new = [path for path in places(self.root) if path.stem not in known]
        with contextlib.closing(sqlite3.connect(":memory:")) as connection:
            _make_tables(connection)
            _put(connection, [*known.values(), *_described(new, progress)])
            yield connection

    @contextlib.contextmanager
    def _open(self, *, write: bool = True) -> Iterator[sqlite3.Connection]:
        """Open the file; to write, inside one transaction that is committed at the end or undone.

        Reading may have to undo what a killed writer left half done, so it does not ask for less than writing does; on
        a read-only medium SQLite contents itself.
        """
        for ending in ("", *_BESIDE):
            # A FIFO would be waited for, and a link leads out of the archive.
            if (kind := files.kind_at(self._beside(ending))) not in ("a file", ""):
                raise DamagedFileError(f"the index is damaged (it is {kind})", where=str(self._beside(ending)))
        uri = f"{self.path.absolute().as_uri()}?mode={'rwc' if write else 'rw'}"
        with contextlib.closing(sqlite3.connect(uri, uri=True, timeout=PATIENCE_S, isolation_level=None)) as connection:
            connection.execute("PRAGMA trusted_schema = OFF")
            if not write:
                connection.execute("BEGIN")  # What is compared must be of one moment.
                yield connection
                return
            # A killed process leaves the file whole. A power cut may not, and then it is made again from the headers;
            # to wait for the disc at every addition would cost more than writing a small entry.
            connection.execute("PRAGMA synchronous = OFF")
            connection.execute("BEGIN IMMEDIATE")
            try:
                if not _is_current(connection):
                    connection.execute("DROP TABLE IF EXISTS entries")
                    connection.execute("DROP TABLE IF EXISTS total")
                    _make_tables(connection)
                yield connection
            except BaseException:
                connection.execute("ROLLBACK")
                raise
            connection.execute("COMMIT")
            self.written = True

    @contextlib.contextmanager
    def _reported(self) -> Iterator[None]:
        """Turn SQLite's errors into one line; what makes the file unreadable as an index is damage."""
        try:
            yield
        except (sqlite3.Error, TypeError, ValueError, AttributeError) as error:
            if getattr(error, "sqlite_errorcode", 0) & 0xFF in _NO_DAMAGE:
                raise UserError(f"the index cannot be used: {error}", where=str(self.path)) from None
            raise DamagedFileError(
                f"the index is damaged ({error})",
                where=str(self.path),
                fix=f"run {command_line('archive', 'reindex', self.path.parent)}",
            ) from None

    def _is_broken(self) -> bool:
        try:
            self.known()
        except DamagedFileError:
            return True
        return False


def _described(paths: list[Path], progress: Progress | None) -> Iterator[StoreEntry]:
    listener = progress or Silent()
    listener.start(len(paths), 0)
    for path in paths:
        with contextlib.suppress(OSError, UserError):  # Removed meanwhile, or not readable: nothing is known of it.
            yield describe(path)
        listener.done(path.name)


def _make_tables(connection: sqlite3.Connection) -> None:
    connection.execute(_TABLE)
    connection.execute(_TOTAL)
    connection.execute("INSERT INTO total VALUES (0, 0)")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def _is_current(connection: sqlite3.Connection) -> bool:
    """Whether the file is of this version; one that says so with other tables, or with triggers, is damaged."""
    if connection.execute("PRAGMA user_version").fetchone()[0] != VERSION:
        return False
    made = [sql for (sql,) in connection.execute("SELECT sql FROM sqlite_master ORDER BY name")]
    if made != [_TABLE, _TOTAL]:
        raise sqlite3.DatabaseError("other tables than those of an index")
    return True


def _check(connection: sqlite3.Connection) -> None:
    """Raise ``sqlite3.DatabaseError`` where the file, a row or the number of rows is not what was written."""
    (verdict,) = connection.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise sqlite3.DatabaseError(" ".join(str(verdict).split())[:100])
    count, total = 0, 0
    for *row, digest in connection.execute("SELECT * FROM entries"):
        if digest != _digest(row):
            raise sqlite3.DatabaseError("a row is not what was written")
        count, total = count + 1, (total + digest) % _MODULUS
    if connection.execute("SELECT * FROM total").fetchall() != [(count, total)]:
        raise sqlite3.DatabaseError("rows are missing, or too many")


def _put(connection: sqlite3.Connection, entries: Iterable[StoreEntry]) -> None:
    """Add or replace rows, and count them."""
    rows = {entry.address: _row(entry) for entry in entries}
    _drop(connection, list(rows))
    digests = [_digest(row) for row in rows.values()]
    connection.executemany(_INSERT, [(*row, digest) for row, digest in zip(rows.values(), digests, strict=True)])
    _count(connection, len(digests), sum(digests))


def _drop(connection: sqlite3.Connection, addresses: Sequence[str]) -> None:
    found = [
        digest
        for address in addresses
        for (digest,) in connection.execute("SELECT row_digest FROM entries WHERE address = ?", (address,))
    ]
    connection.executemany("DELETE FROM entries WHERE address = ?", [(address,) for address in addresses])
    _count(connection, -len(found), -sum(found))


def _count(connection: sqlite3.Connection, count: int, digests: int) -> None:
    change = "UPDATE total SET count = count + ?, row_digests = (row_digests + ?) % ?"
    if connection.execute(change, (count, digests % _MODULUS, _MODULUS)).rowcount != 1:
        raise sqlite3.DatabaseError("the number of rows is not there")


def _digest(row: Iterable[Any]) -> int:
    return int.from_bytes(hashlib.sha256(repr(list(row)).encode()).digest()[:7], "big")


def _row(entry: StoreEntry) -> tuple[Any, ...]:
    return astuple(replace(entry, bands=",".join(entry.bands)))  # type: ignore[arg-type]


def _select(connection: sqlite3.Connection, wanted: Filter | None = None) -> Iterator[StoreEntry]:
    condition, values = (wanted or Filter()).sql()
    columns = ", ".join(_COLUMNS)
    for row in connection.execute(f"SELECT {columns} FROM entries WHERE {condition} ORDER BY address", values):
        found = dict(zip(_COLUMNS, row, strict=True))
        found["bands"] = tuple(found["bands"].split(",")) if found["bands"] else ()
        yield StoreEntry(**found)


def _instant(text: str, where: str) -> str:
    try:
        instant = datetime.fromisoformat(text)
    except ValueError:
        raise UserError(f"found {text!r}", where=where, expected="a date or time, such as 2026-03-20T12:00") from None
    return (instant if instant.tzinfo else instant.replace(tzinfo=UTC)).astimezone(UTC).isoformat()
