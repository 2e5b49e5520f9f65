"""A row of a night: a suite's row for one noise sample, with its stored columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from horizonval.core.outcome import Outcome
from horizonval.scoring.row import Row

DIGITS = 4
"""Decimals of stored errors: 1e-4 arcsec, 3e-8 deg."""
ERRORS = ("nadir_error_arcsec", "roll_error_arcsec", "pitch_error_arcsec")
COLUMNS = (
    "scene", "band", "replicate", "estimator", "image", "status", "reason", "false_valid", *ERRORS,
    "table", "due", "bound_arcsec",
)  # fmt: skip
"""Stored columns; ``scene`` is the case, ``image`` the image's address, ``due`` whether it must be answered."""


@dataclass(frozen=True, kw_only=True)
class ReplicateRow(Row):
    """Answer of one estimator on one replicate of an image: a :class:`horizonval.scoring.row.Row`, stored columns only.

    ``image_address``: digest of the digital numbers. ``replicate``: seed of the noise. ``table``: the suite's table of
    the scene, its stratum. ``expected`` only says whether the image must be answered.
    """

    replicate: int = 0
    table: str = ""

    @classmethod
    def of(cls, row: Row, *, replicate: int, table: str, image: str) -> Self:
        """Return the row of a suite's row, its errors rounded to :data:`DIGITS`."""
        errors = {name: getattr(row, name) for name in ERRORS}
        rounded = {name: None if value is None else round(float(value), DIGITS) for name, value in errors.items()}
        about = {"scene": row.case, "band": row.band, "replicate": replicate, "estimator": row.estimator}
        found = {"status": row.status, "reason": row.reason, "false_valid": row.false_valid}
        where = {"image": image, "table": table, "due": row.is_due, "bound_arcsec": row.bound_arcsec}
        return cls.from_dict({**about, **found, **rounded, **where})

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the row of :meth:`to_dict`. Raises ``KeyError, TypeError``: a missing or unknown column."""
        rest = dict(data)
        case, image, due = (rest.pop(name) for name in ("scene", "image", "due"))
        made = cls(case=case, camera="", image_address=image, expected=str(Outcome.VALID), borderline=not due, **rest)
        return made.against(made.bound_arcsec)

    def to_dict(self) -> dict[str, Any]:
        """Return the stored columns as plain data."""
        own = {"scene": self.case, "image": self.image_address, "due": self.is_due}
        return {name: own[name] if name in own else getattr(self, name) for name in COLUMNS}

    def against(self, bound_arcsec: float | None, **about: Any) -> Self:
        """Return the row with another bound of its image; ``about``: other columns that change."""
        error = self.nadir_error_arcsec
        ratio = None if error is None or not bound_arcsec else error / bound_arcsec
        return replace(self, bound_arcsec=bound_arcsec, error_over_bound=ratio, **about)

    @property
    def key(self) -> tuple[str, str, int, str]:
        """Key of the corresponding rows of two nights."""
        return self.case, self.band, self.replicate, self.estimator


def summary_of(rows: Sequence[ReplicateRow]) -> dict[str, tuple[float, str, int]]:
    """Return value, unit and number of rows by figure, without figures that no row has."""
    due = [row for row in rows if row.is_due]
    errors = [row.nadir_error_arcsec for row in rows if row.nadir_error_arcsec is not None]
    over = [row.error_over_bound for row in rows if row.error_over_bound is not None]
    found = {}
    if due:
        found["availability"] = (100.0 * (sum(row.is_claim for row in due) / len(due)), "%", len(due))
    if rows:
        found["false claims"] = (100.0 * (sum(row.false_valid for row in rows) / len(rows)), "%", len(rows))
    if errors:
        found["median nadir error"] = (float(np.median(errors)), "arcsec", len(errors))
    if over:
        found["median error over bound"] = (float(np.median(over)), "1", len(over))
    return found


def to_columns(rows: Iterable[ReplicateRow]) -> dict[str, list[Any]]:
    """Return rows as columns; repeated texts are numbered, which saves nine tenths of the size."""
    listed = [row.to_dict() for row in rows]
    found: dict[str, Any] = {}
    for name in COLUMNS:
        values = [row[name] for row in listed]
        words = sorted({value for value in values if isinstance(value, str)})
        if words and len(words) * 2 < len(values):
            number = {word: i for i, word in enumerate(words)}
            found[name] = {"words": words, "at": [None if v is None else number[v] for v in values]}
        else:
            found[name] = values
    return found


def from_columns(columns: Mapping[str, Any]) -> list[ReplicateRow]:
    """Return the rows of :func:`to_columns`."""
    plain: dict[str, Sequence[Any]] = {}
    for name in COLUMNS:
        column = columns[name]
        if isinstance(column, dict):
            column = [None if i is None else column["words"][i] for i in column["at"]]
        plain[name] = column
    return [
        ReplicateRow.from_dict(dict(zip(COLUMNS, values, strict=True))) for values in zip(*plain.values(), strict=True)
    ]
