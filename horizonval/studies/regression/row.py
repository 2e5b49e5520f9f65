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
ANGLES = ("nadir_error_arcsec", "roll_error_arcsec", "pitch_error_arcsec")
ERRORS = (*ANGLES, "altitude_error_km")
CLAIMED = ("nees_nadir_total", "without_sigma", "sigma_total_arcsec")
"""Columns about the claimed covariance, which baselines of earlier versions do not have, as the altitude."""
COLUMNS = (
    "scene", "band", "replicate", "estimator", "image", "status", "reason", "false_valid", *ERRORS, *CLAIMED,
    "table", "due", "bound_arcsec",
)  # fmt: skip
"""Stored columns; ``scene`` is the case, ``image`` the image's address, ``due`` whether it must be answered."""
LARGEST_ARCSEC = 180 * 3600.0
LARGEST_NEES = 1e32
"""Squared error of 180 deg over the smallest variance that counts as one."""


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
        found: dict[str, Any] = {"status": row.status, "reason": row.reason, "false_valid": row.false_valid}
        for name in CLAIMED:
            value = getattr(row, name)
            found[name] = float(f"{value:.6g}") if isinstance(value, float) else value
        where = {"image": image, "table": table, "due": row.is_due, "bound_arcsec": row.bound_arcsec}
        return cls.from_dict({**about, **found, **rounded, **where})

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Return the row of :meth:`to_dict`. Raises ``ValueError``: a missing or unknown column, or no such value."""
        rest = dict(data)
        wrong = sorted({*COLUMNS} - {*CLAIMED, "altitude_error_km"} - {*rest} | {*rest} - {*COLUMNS})
        if wrong:
            raise ValueError(f"column {wrong[0]!r} is {'unknown' if wrong[0] in rest else 'missing'}")
        case, image, due = (rest.pop(name) for name in ("scene", "image", "due"))
        if not isinstance(due, bool):
            raise ValueError(f"due = {due!r} is not true or false")
        rest["sigma_nadir_arcsec"] = rest.pop("sigma_total_arcsec", None)
        made = cls(case=case, camera="", image_address=image, expected=str(Outcome.VALID), borderline=not due, **rest)
        return made.against(made.bound_arcsec)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.status not in set(Outcome):
            raise ValueError(f"status = {self.status!r} is no outcome")
        if type(self.replicate) is not int or self.replicate < 0:
            raise ValueError(f"replicate = {self.replicate!r} is not a whole number")
        if not isinstance(self.table, str):
            raise ValueError(f"table = {self.table!r} is not text")
        limits = {**dict.fromkeys((*ANGLES, "bound_arcsec"), LARGEST_ARCSEC), "nees_nadir_total": LARGEST_NEES}
        for name, limit in limits.items():
            if abs(getattr(self, name) or 0.0) > limit * (1 + 1e-9):
                raise ValueError(f"{name} = {getattr(self, name):g} is beyond {limit:g}")
        for name in ("nadir_error_arcsec", "bound_arcsec", "nees_nadir_total", "sigma_nadir_arcsec"):
            if (getattr(self, name) or 0.0) < 0.0:
                raise ValueError(f"{name} = {getattr(self, name):g} is below 0")

    @property
    def states_claim(self) -> bool:
        """Whether the claimed covariance is known, or known to be missing; not in baselines of earlier versions."""
        return self.nees_nadir_total is not None or self.without_sigma

    @property
    def states_altitude(self) -> bool:
        """Whether sigma and altitude of a claim are known; not in baselines of earlier versions."""
        return self.sigma_total_arcsec is not None

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
    """Return the rows of :func:`to_columns`. Raises ``ValueError``: no such columns, or two rows of one answer."""
    plain: dict[str, Sequence[Any]] = {}
    for name, stored in columns.items():
        column = stored
        if isinstance(stored, dict):
            words, at = stored.get("words"), stored.get("at")
            if not isinstance(words, list) or not isinstance(at, list):
                raise ValueError(f"column {name!r} has no words")
            if any(i is not None and (type(i) is not int or not 0 <= i < len(words)) for i in at):
                raise ValueError(f"column {name!r} has an index without a word")
            column = [None if i is None else words[i] for i in at]
        if not isinstance(column, list):
            raise ValueError(f"column {name!r} is no list")
        plain[name] = column
    if len({len(column) for column in plain.values()}) > 1:
        raise ValueError("the columns differ in length")
    rows = [
        ReplicateRow.from_dict(dict(zip(plain, values, strict=True))) for values in zip(*plain.values(), strict=True)
    ]
    seen = set()
    for row in rows:
        if row.key in seen:
            raise ValueError(f"two rows of {', '.join(map(str, row.key))}")
        seen.add(row.key)
    return rows
