"""A table of numbers as text: a line of column names, then one of values for each row; ``#`` begins a remark.

A first column of times is kept as text.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Sequence
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
    """Columns by name, each of n rows; ``lines``: line numbers of the rows."""

    path: Path
    texts: dict[str, list[str]]
    numbers: dict[str, FloatArray]
    lines: list[int]

    def together(self, *names: str) -> FloatArray:
        """Return some columns side by side, shape (n, k)."""
        return np.stack([self.numbers[name] for name in names], axis=1)

    def place(self, row: int, column: str) -> str:
        """Return the position of a value, for messages."""
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
    header, rows = csv_rows(path, f"a table of {expected}")
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
    if not rows:
        raise UserError("no rows", where=str(path), expected="a line of values for each row")
    lines = [line for line, _ in rows]
    at = {name: header.index(name) for name in wanted}
    columns = {name: [row[at[name]] for _, row in rows] for name in wanted}
    numbers = {
        name: numbers_of(column, lambda k, name=name: f"{path}: line {lines[k]}, column {name}")  # type: ignore[misc]
        for name, column in columns.items()
        if name not in texts
    }
    return CsvTable(path, {name: columns[name] for name in wanted if name in texts}, numbers, lines)


def csv_rows(path: Path, expected: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the names in the first line of a table, and line number and fields of each row, without blanks around."""
    text = files.read_text(path, largest=MAX_FILE_BYTES, expected=expected)
    try:
        reader = csv.reader(text.splitlines(), strict=True, skipinitialspace=True)
        rows = [(reader.line_num, [field.strip() for field in row]) for row in reader]
    except csv.Error as error:
        raise UserError(f"not a CSV file: {error}", where=str(path), expected="comma-separated text") from None
    (_, header), *rows = [(line, row) for line, row in rows if any(row) and not row[0].startswith("#")] or [(1, [])]
    for line, row in rows:
        if len(row) != len(header):
            raise UserError(f"{len(row)} fields", where=f"{path}: line {line}", expected=f"{len(header)}")
    return header, rows


_NUMBER = re.compile(r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", re.ASCII)
LARGEST = 1e15
"""Bound of numbers: no quantity in these files comes near it, and squares remain finite."""
EXPECTED_NUMBER = f"a finite number below {LARGEST:g}"


def numbers_of(texts: Sequence[str], place: Callable[[int], str]) -> FloatArray:
    """Return decimal numbers; ``place`` names one by its index. UserError: see :func:`number_of`."""
    if all(map(_NUMBER.fullmatch, texts)):
        found = np.array(list(map(float, texts)))
        if (np.abs(found) < LARGEST).all():
            return found
    return np.array([number_of(text, place(k)) for k, text in enumerate(texts)])


def number_of(text: str, where: str, expected: str = EXPECTED_NUMBER) -> float:
    """Return a decimal number; UserError for anything else (``nan`` and ``1_000`` included)."""
    found = float(text) if _NUMBER.fullmatch(text) else math.nan
    if not abs(found) < LARGEST:
        raise UserError(f'found "{excerpt(text)}"', where=where, expected=expected)
    return found
