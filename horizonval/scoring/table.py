"""The table of results: one row per case and estimator, stored as Parquet.

Columns and types are those of :data:`horizonval.scoring.row.COLUMNS`. The same rows give the same bytes, in whatever
order they come: rows are sorted, and nothing of the clock or the machine is stored. The file is sealed
(:mod:`horizonval.core.sealed`): whoever reads it here reads what was written.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import duckdb

from horizonval.core import atomic, files, sealed
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.scoring.row import COLUMNS, Row

LARGEST_TABLE = 1 << 34
"""Size of a table [bytes]."""

_PATTERN = re.compile(r"[*?\[]")
"""What DuckDB does not take for itself in a path."""


def write_results(rows: Iterable[Row], path: Path) -> Path:
    """Write rows to a Parquet file; the file appears whole or not at all."""
    ordered = sorted(rows, key=lambda row: row.sort_key)
    columns = ", ".join(f'unnest(${i + 1}::{c.sql_type}[]) AS "{c.name}"' for i, c in enumerate(COLUMNS))
    # One thread keeps row order and row groups, hence the bytes, independent of the machine.
    with atomic.temporary_in(path.parent, path.name) as temporary, duckdb.connect(config={"threads": 1}) as connection:
        values = [[getattr(row, column.name) for row in ordered] for column in COLUMNS]
        connection.execute(f"CREATE TABLE results AS SELECT {columns}", values)
        where = str(temporary.absolute()).replace("'", "''")
        seal = f"{{'{sealed.KEY}': '{sealed.BLANK}'}}"
        connection.execute(f"COPY results TO '{where}' (FORMAT parquet, COMPRESSION zstd, KV_METADATA {seal})")
        atomic.write_bytes(path, sealed.fill_in(temporary.read_bytes()))
    return path


def open_results(path: Path, connection: duckdb.DuckDBPyConnection) -> duckdb.DuckDBPyRelation:
    """Return the rows of a file as a relation, after a look at its seal.

    Raises
    ------
    UserError
        There is no such file, or it is no regular one.
    DamagedFileError
        The file is not what was written, or not readable as Parquet.
    """
    data = files.read_bytes(path, largest=LARGEST_TABLE, expected="results.parquet of a run")
    try:
        sealed.check(data, path)
    except DamagedFileError as error:
        raise type(error)(error.what, where=str(path), fix="make the run again") from None
    try:
        return connection.read_parquet(_literal(path), hive_partitioning=False)
    except duckdb.Error as error:
        raise _unreadable(error, path) from error


def _literal(path: Path) -> str:
    """Return a path as DuckDB takes it for itself and not for a pattern."""
    text = path.absolute().as_posix()
    if "\\" in text and _PATTERN.search(text):
        raise UserError(
            "a path with a backslash and one of *?[ cannot be opened as a table",
            where=str(path),
            fix="give the folder another name",
        )
    return _PATTERN.sub(r"[\g<0>]", text)


def _unreadable(error: duckdb.Error, path: Path) -> DamagedFileError:
    return DamagedFileError(f"cannot be read as Parquet ({str(error).splitlines()[0]})", where=str(path))


def read_results(path: Path) -> list[Row]:
    """Read rows back, in the stored order.

    Raises
    ------
    UserError
        There is no such file, or its columns are not ours.
    DamagedFileError
        The file is not what was written, or not readable as Parquet.
    """
    with duckdb.connect(config={"threads": 1}) as connection:
        relation = open_results(path, connection)
        try:
            names, records = relation.columns, relation.fetchall()
        except duckdb.Error as error:
            raise _unreadable(error, path) from error
    # A table from before a column was kept has none of it; all others must be ours, in our order.
    known = [column.name for column in COLUMNS if column.name in names or not column.optional]
    if names != known:
        different = sorted(set(names) ^ set(known))
        raise UserError(
            f"columns differ: {different or 'order'}",
            where=str(path),
            expected="the columns of this version",
            fix="make the run again",
        )
    try:
        return [Row.from_dict(dict(zip(names, record, strict=True))) for record in records]
    except ValueError as error:
        raise DamagedFileError(f"not a row of results ({error})", where=str(path)) from error
