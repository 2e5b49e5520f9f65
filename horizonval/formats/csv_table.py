"""A table of numbers as text: a line of column names, then one of values for each row; ``#`` begins a remark.

A first column of times is kept as text.
"""

from __future__ import annotations

import csv
import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from horizonval.core import files
from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, excerpt

MAX_FILE_BYTES = 256 * 1024 * 1024
"""A day of states at 10 Hz is some 100 MB."""


@dataclass(frozen=True)
class CsvTable:
    """Columns by name, each of n rows; ``lines``: where the rows stand in the file."""

    path: Path
    texts: dict[str, list[str]]
    numbers: dict[str, FloatArray]
    lines: list[int]

    def together(self, *names: str) -> FloatArray:
        """Return some columns side by side, shape (n, k)."""
        return np.stack([self.numbers[name] for name in names], axis=1)

    def place(self, row: int, column: str) -> str:
        """Return where a value stands, for messages."""
        return f"{self.path}: line {self.lines[row]}, column {column}"


def read_csv(
    path: Path, *alternatives: tuple[str, ...], texts: tuple[str, ...] = (), like: re.Pattern[str] | None = None
) -> CsvTable:
    """Return the table in a file; UserError names file, line and column.

    ``alternatives`` are the sets of columns that it may have, in any order. The first that fits is read, without other
    columns. ``texts`` are those of them that are not numbers. Columns that are given twice, belong to another set, or
    match ``like`` and belong to none are refused, since they may be meant as others.
    """
    expected = " or ".join(", ".join(names) for names in alternatives)
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=f"a table of {expected}")
    try:
        reader = csv.reader(text.splitlines(), strict=True)
        rows = [(reader.line_num, row) for row in reader if row and not row[0].lstrip().startswith("#")]
    except csv.Error as error:
        raise UserError(f"not a CSV file: {error}", where=str(path), expected="comma-separated text") from None
    header = [name.strip() for name in rows[0][1]] if rows else []
    wanted = next((names for names in alternatives if set(names) <= set(header)), None)
    if wanted is None:
        found = ", ".join(excerpt(name) for name in header) or "nothing"
        raise UserError(f"columns {found}", where=str(path), expected=expected)
    twice = next((name for name in header if name in wanted and header.count(name) > 1), None)
    if twice is not None:
        raise UserError(f"column {twice} is given twice", where=str(path), expected=expected)
    others = {name for names in alternatives for name in names} - set(wanted)
    stray = next((n for n in header if n in others or (like and n not in wanted and like.match(n))), None)
    if stray is not None:
        raise UserError(
            f"column {excerpt(stray)}, which does not go with {', '.join(wanted)}",
            where=str(path),
            expected=expected,
            fix="correct its name, or leave it out",
        )
    if len(rows) < 2:
        raise UserError("no rows", where=str(path), expected="a line of values for each row")
    lines = [line for line, _ in rows[1:]]
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise UserError(f"{len(row)} fields", where=f"{path}: line {line}", expected=f"{len(header)}")
    at = {name: header.index(name) for name in wanted}
    numbers = {}
    for name in wanted:
        if name not in texts:
            numbers[name] = np.array([_number(row[at[name]], path, line, name) for line, row in rows[1:]])
    words = {name: [row[at[name]].strip() for _, row in rows[1:]] for name in wanted if name in texts}
    return CsvTable(path, words, numbers, lines)


def _number(field: str, path: Path, line: int, column: str) -> float:
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UserError(
            f'found "{excerpt(field)}"', where=f"{path}: line {line}, column {column}", expected="a finite number"
        )
    return value
