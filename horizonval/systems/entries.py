"""Entries of ``published.toml``, an experiment's result, and the judgement; the package's text describes the format."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

Cell = str | int | float | None
Number = float | tuple[float, ...]
Values = Mapping[str, float | Sequence[float]]
"""Measured values by entry."""


class Status(StrEnum):
    """Judgement of a measured figure.

    Printed figures: ``BOUNDED`` is on the better side of the printed one, or agrees under sizes or a reading that the
    source does not give; ``NOT_DETERMINABLE``: the source says too little for any measurement to decide. Figures of
    ours: ``MET``, ``MISSED``, or ``NONE`` without a criterion.
    """

    REPRODUCED = "reproduced"
    BOUNDED = "bounded"
    CONTRADICTED = "contradicted"
    NOT_DETERMINABLE = "not determinable"
    MET = "met"
    MISSED = "missed"
    NONE = ""


HOLDS = {
    **dict.fromkeys((Status.REPRODUCED, Status.BOUNDED, Status.MET), True),
    **dict.fromkeys((Status.CONTRADICTED, Status.MISSED), False),
}


class Entry(BaseModel):
    """One printed figure, one list of them, one printed statement, or one figure of ours."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    what: str
    printed: float | tuple[float, ...] | str | None = None
    unit: str = ""
    where: str = ""
    reading: str
    at_most: Number | None = None
    at_least: Number | None = None
    within: Number | None = None
    factor: Number | None = None
    fails: str = ""
    good: Literal["reproduced", "bounded"] = "reproduced"
    labels: tuple[str, ...] = ()

    @property
    def criterion(self) -> str:
        """What makes the entry fail, in words."""
        unit = f" {self.unit}" if self.unit else ""
        parts = [
            f"{words} {_joined(limit)}{unit}"
            for words, limit in (
                ("above", self.at_most),
                ("below", self.at_least),
                ("farther from the figure than", self.within),
            )
            if limit is not None
        ]
        if self.factor is not None:
            parts.append(f"beyond a factor of {_joined(self.factor)} of the figure")
        return ". ".join([*parts, self.fails] if self.fails else parts)

    @property
    def limits(self) -> tuple[Number | None, ...]:
        """The numbers that make the entry fail; without any of them it is not judged."""
        return tuple(limit for limit in (self.at_most, self.at_least, self.within, self.factor) if limit is not None)

    def rows(self, key: str, value: float | Sequence[float] | None, note: str = "") -> Iterator[Row]:
        """Yield one row for every figure; ``ValueError``: a count or a value that cannot be."""
        many = isinstance(value, Sequence) or isinstance(self.printed, tuple)
        measured = list(value) if isinstance(value, Sequence) else [value]
        count = len(self.printed) if isinstance(self.printed, tuple) else len(measured)
        if value is None:
            measured *= count
        if len(measured) != count or (many and len(self.labels) != count):
            raise ValueError(f"{key}: {len(measured)} values, {len(self.labels)} labels for {count} figures")
        for i, one in enumerate(measured):
            printed = self.printed[i] if isinstance(self.printed, tuple) else self.printed
            name = f"{self.what}: {self.labels[i]}" if many else self.what
            status = self._status(key, i, printed, one)
            yield Row(
                key, name, printed, None if one is None else float(one), self.unit, self.where, self.reading,
                self.criterion, note, status, HOLDS.get(status),
            )  # fmt: skip

    def _status(self, key: str, i: int, printed: float | str | None, measured: float | None) -> Status:
        limits = (self.at_most, self.at_least, self.within, self.factor)
        most, least, within, factor = (limit[i] if isinstance(limit, tuple) else limit for limit in limits)
        if not self.limits:
            return Status.NONE if printed is None else Status.NOT_DETERMINABLE
        if measured is None or not math.isfinite(measured):
            raise ValueError(f"{key}: not a number: {measured}")
        fails = (most is not None and measured > most) or (least is not None and measured < least)
        if within is not None:
            fails |= abs(measured - _number(key, printed)) > within
        if factor is not None:
            ratio = measured / _number(key, printed)
            fails |= not 1.0 / factor <= ratio <= factor
        if printed is None:
            return Status.MISSED if fails else Status.MET
        return Status.CONTRADICTED if fails else Status(self.good)


def _number(key: str, printed: float | str | None) -> float:
    if not isinstance(printed, float):
        raise ValueError(f"{key}: `within` and `factor` need a printed number")
    return printed


def _joined(number: Number) -> str:
    return ", ".join(f"{one:.4g}" for one in (number if isinstance(number, tuple) else (number,)))


@dataclass(frozen=True)
class Row:
    """One figure as in the JSON file; ``why``: the reading, ``holds``: None where nothing is judged."""

    key: str
    name: str
    published: float | str | None
    measured: float | None
    unit: str
    where: str
    why: str
    fails: str
    note: str
    status: Status
    holds: bool | None

    def plain(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self) | {"status": str(self.status)}


class System(BaseModel):
    """What one source prints, and the texts of the page."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    title: str
    source: str
    summary: str
    choices: tuple[str, ...] = ()
    given: dict[str, Any] = {}
    entry: dict[str, Entry]
    figure: dict[str, str] = {}

    def rows(self, values: Mapping[str, Any], notes: Mapping[str, str] | None = None) -> Iterator[Row]:
        """Yield the rows of some entries, measured or None; ``KeyError``: no such entry."""
        for key, value in values.items():
            yield from self.entry[key].rows(key, value, (notes or {}).get(key, ""))


@cache
def system(letter: str) -> System:
    """Return what is in a system's ``published.toml``, by its letter."""
    file = resources.files(__package__) / letter.lower() / "published.toml"
    return System.model_validate(tomllib.loads(file.read_text(encoding="utf-8")))


@dataclass(frozen=True)
class Table:
    """A further table of the page."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Result:
    """What an experiment measured.

    ``figures``: drawing functions by picture, in the page's order, each with a caption in ``published.toml``;
    ``settings``: for the JSON file.
    """

    values: Values
    figures: Mapping[str, Callable[[], MplFigure]] = field(default_factory=dict)
    tables: Sequence[Table] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
