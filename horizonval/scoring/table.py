"""The table of results: one row per case and estimator, stored as Parquet.

Columns and types are those of :data:`horizonval.scoring.row.COLUMNS`. The same rows give the same bytes, in whatever
order they come: rows are sorted, and nothing of the clock or the machine is stored.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import duckdb

from horizonval.core import atomic
from horizonval.core.errors import DamagedFileError, UserError
from horizonval.scoring.row import COLUMNS, Row


def write_results(rows: Iterable[Row], path: Path) -> Path:
    """Write rows to a Parquet file; the file appears whole or not at all."""
    ordered = sorted(rows, key=lambda row: row.sort_key)
    columns = ", ".join(f'unnest(${i + 1}::{c.sql_type}[]) AS "{c.name}"' for i, c in enumerate(COLUMNS))
    # One thread keeps row order and row groups, hence the bytes, independent of the machine.
    with atomic.replacing(path) as temporary, duckdb.connect(config={"threads": 1}) as connection:
        values = [[getattr(row, column.name) for row in ordered] for column in COLUMNS]
        connection.execute(f"CREATE TABLE results AS SELECT {columns}", values)
        connection.table("results").write_parquet(str(temporary), compression="zstd")
    return path


def read_results(path: Path) -> list[Row]:
    """Read rows back, in the stored order.

    Raises
    ------
    UserError
        There is no such file, or its columns are not ours.
    DamagedFileError
        The file is not readable as Parquet.
    """
    if not path.is_file():
        raise UserError("no such file", where=str(path), expected="results.parquet of a run")
    try:
        with duckdb.connect(config={"threads": 1}) as connection:
            relation = connection.read_parquet(str(path))
            names = relation.columns
            records = relation.fetchall()
    except duckdb.Error as error:
        first_line = str(error).splitlines()[0]
        raise DamagedFileError(f"cannot be read as Parquet ({first_line})", where=str(path)) from error
    known = [column.name for column in COLUMNS]
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
