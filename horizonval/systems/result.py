"""What the reproduction of a published system gives: rows of published against measured, tables, figures.

Everything here is plain data (but for the figures' drawing functions), so that the JSON file, the readable page and
the printed table all say the same.

A *claim* is what the source prints, with our reading of it and what became of it; a *row* is a measured figure, with a
bar where there is something that it can miss. A bar that the truth itself passes, or chance, is none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

Cell = str | int | float | None


class Status(StrEnum):
    """What became of a printed figure.

    ``REPRODUCED``: measured within what is said to make it fail. ``BOUNDED``: ours lies on the better side of it, or
    agrees under sizes or a reading that the source does not give. ``CONTRADICTED``: measured, and not so.
    ``NOT_DETERMINABLE``: the source says too little for any measurement to decide.
    """

    REPRODUCED = "reproduced"
    BOUNDED = "bounded"
    CONTRADICTED = "contradicted"
    NOT_DETERMINABLE = "not determinable"


@dataclass(frozen=True)
class Claim:
    """One printed figure, or one printed table's figures of a kind, judged.

    ``what``: unique within the system; ``where``: page, table, figure or part of the source; ``printed``, ``reading``,
    ``measured``: as printed, as we read it, and ours with its unit; ``fails``: what would contradict it.
    """

    what: str
    where: str
    printed: str
    reading: str
    measured: str
    fails: str
    status: Status

    def plain(self) -> dict[str, str]:
        """Return the claim as in the JSON file."""
        return {
            "what": self.what,
            "where": self.where,
            "printed": self.printed,
            "reading": self.reading,
            "measured": self.measured,
            "fails": self.fails,
            "status": str(self.status),
        }


@dataclass(frozen=True)
class ComparisonRow:
    """One published figure compared with ours.

    ``name``: figure and conditions, unique within the system; ``published``: as printed, or a text such as ``"< 1"``,
    None if lost; ``measured``: of this run; ``why``: one sentence on the difference or agreement; ``limit``: largest
    ``|measured|`` (with ``against``, largest departure) that counts as reproduced; ``against``: reference of
    ``measured``, None for zero; ``at_least``: ``measured`` must reach ``limit`` instead.
    """

    name: str
    published: float | str | None
    measured: float
    unit: str
    why: str
    limit: float | None = None
    against: float | None = None
    at_least: bool = False

    @property
    def holds(self) -> bool | None:
        """Whether the limit is met; None without one."""
        if self.limit is None:
            return None
        departure = self.measured - (self.against or 0.0)
        return bool(departure >= self.limit if self.at_least else abs(departure) <= self.limit)

    def plain(self) -> dict[str, Any]:
        """Return the row as in the JSON file."""
        return {
            "name": self.name,
            "published": self.published,
            "measured": float(self.measured),
            "unit": self.unit,
            "why": self.why,
            "limit": self.limit,
            "against": self.against,
            "at_least": self.at_least,
            "holds": self.holds,
        }


@dataclass(frozen=True)
class Table:
    """A table for the page: as published where ``columns`` say so, with ours beside."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    caption: str = ""


@dataclass(frozen=True)
class Figure:
    """A picture for the page; ``name`` is its file's stem, ``draw`` makes it (a matplotlib figure, at its own size)."""

    name: str
    caption: str
    draw: Callable[[], MplFigure]


@dataclass(frozen=True)
class Reproduction:
    """One system's experiment, reproduced.

    ``system``: letter A to G; ``settings``: of the renders, for the JSON file; ``template``: of the page, from this
    folder; ``summary``: numbers in the template's summary, by name; ``claims``: every printed figure of the source;
    ``choices``: made after a result was seen, which therefore prove nothing.
    """

    system: str
    title: str
    source: str
    rows: tuple[ComparisonRow, ...]
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()
    settings: dict[str, Any] = field(default_factory=dict)
    template: str = "page/layout.md.jinja"
    summary: Mapping[str, Any] = field(default_factory=dict)
    claims: tuple[Claim, ...] = ()
    choices: tuple[str, ...] = ()
