"""What the sources print (``published.toml``) and the texts of the pages (``page/text.toml``), for every system.

``published.toml`` holds the printed figures with their units and the place of each; nothing in it is ours.
The pages (:mod:`horizonval.systems.pages`) compare it with our measurements.

Rows, tables and figures of a system are made here alone, so that the experiments hold numbers and no prose. Texts have
fields of :meth:`str.format`, filled with the numbers of the run. A page's summary is a template beside it,
``page/page.md.jinja``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict

from horizonval.systems.result import Cell, Claim, ComparisonRow, Figure, Reproduction, Status, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure

LOST = "lost"
"""Stands in a table for a figure that did not survive."""


def _or_lost(value: Any) -> Any:
    return None if value == LOST else value


Printed = Annotated[float | None, BeforeValidator(_or_lost)]


class _PublishedModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PrintedFigure(_PublishedModel):
    """One printed figure, or a printed condition of an experiment.

    ``value``: as printed, a text without a number; ``where``: table, figure, equation or part of the source.
    """

    value: int | float | str
    unit: str = ""
    where: str


class PrintedTable(_PublishedModel):
    """One printed table.

    ``where``: number or caption in the source; ``settings``: by quantity with unit, one value or one per column;
    ``printed``: figures by quantity, None where one is lost, empty where all are; ``units``: of the printed quantities;
    ``errors``: printed ``mean`` and ``deviation`` of errors by quantity, where given.
    """

    where: str
    settings: dict[str, float | tuple[float, ...]]
    printed: dict[str, tuple[Printed, ...]]
    units: dict[str, str]
    errors: dict[str, dict[Literal["mean", "deviation"], float]] = {}

    def columns(self) -> Iterator[tuple[dict[str, float], dict[str, float | None]]]:
        """Yield the settings and the printed figures of every column."""
        columns = [*self.printed.values(), *(v for v in self.settings.values() if isinstance(v, tuple))]
        for i in range(len(columns[0])):
            settings = {name: v[i] if isinstance(v, tuple) else v for name, v in self.settings.items()}
            yield settings, {name: figures[i] for name, figures in self.printed.items()}


class Published(_PublishedModel):
    """What one source (authors, title, year) prints."""

    source: str
    figures: dict[str, PrintedFigure] = {}
    tables: dict[str, PrintedTable] = {}

    def number(self, key: str) -> float:
        """Return a printed figure that is a number; raises ``TypeError`` for a text."""
        value = self.figures[key].value
        if isinstance(value, str):
            raise TypeError(f"{key} is printed as {value!r}")
        return float(value)


def read_toml(system: str, name: str) -> dict[str, Any]:
    """Return the content of a file in a system's package, by the system's letter."""
    file = resources.files(__package__) / system.lower() / name
    return tomllib.loads(file.read_text(encoding="utf-8"))


@cache
def published(system: str) -> Published:
    """Return what a system's source prints, by the system's letter."""
    return Published.model_validate(read_toml(system, "published.toml"))


class _TextModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class RowText(_TextModel):
    """A row's name, its unit, and why published and measured differ."""

    name: str
    unit: str = ""
    why: str


class ClaimText(_TextModel):
    """A claim's name, our reading of what is printed, what is measured, and what would make it fail."""

    what: str
    where: str = ""
    reading: str
    measured: str
    fails: str


class TableText(_TextModel):
    """A table's title, the heads of its columns, and what is said under the title."""

    title: str
    columns: tuple[str, ...]
    caption: str = ""


class PageText(_TextModel):
    """All texts of one system's page.

    ``rows``, ``tables``, ``claims``: by key; ``choices``: made after a result was seen; ``figures``: captions by name;
    ``phrases``: sentence parts and table cells that depend on the outcome.
    """

    system: str
    title: str
    rows: dict[str, RowText]
    tables: dict[str, TableText] = {}
    claims: dict[str, ClaimText] = {}
    choices: tuple[str, ...] = ()
    figures: dict[str, str] = {}
    phrases: dict[str, str] = {}

    def row(
        self,
        key: str,
        measured: float,
        published: float | str | None = None,
        /,
        *,
        limit: float | None = None,
        against: float | None = None,
        at_least: bool = False,
        **fields: Any,
    ) -> ComparisonRow:
        """Return a row of published and measured; see :class:`horizonval.systems.result.ComparisonRow`."""
        text = self.rows[key]
        name, unit, why = (part.format(**fields) for part in (text.name, text.unit, text.why))
        return ComparisonRow(name, published, measured, unit, why, limit, against, at_least)

    def claim(
        self, key: str, printed: float | str, status: Status, /, *, figure: str | None = None, **fields: Any
    ) -> Claim:
        """Return a judged claim.

        ``key``: of the text, and of the printed figure or table unless ``figure`` or the text names it; ``printed``: as
        printed, with the unit if it is a text.
        """
        text = self.claims[key]
        what, reading, measured, fails = (
            part.format(**fields) for part in (text.what, text.reading, text.measured, text.fails)
        )
        source = published(self.system)
        where = text.where or (source.figures | source.tables)[figure or key].where
        shown = printed if isinstance(printed, str) else f"{printed:.7g} {source.figures[figure or key].unit}".strip()
        return Claim(what, where, shown, reading, measured, fails, status)

    def table(self, key: str, lines: Iterable[Iterable[Cell]], /, **fields: Any) -> Table:
        """Return a table of the page with these lines."""
        text = self.tables[key]
        columns = tuple(column.format(**fields) for column in text.columns)
        rows = tuple(tuple(line) for line in lines)
        return Table(text.title.format(**fields), columns, rows, text.caption.format(**fields))

    def figure(self, key: str, draw: Callable[[], MplFigure], /, **fields: Any) -> Figure:
        """Return a figure of the page, named by its key."""
        return Figure(key, self.figures[key].format(**fields), draw)

    def phrase(self, key: str, /, **fields: Any) -> str:
        """Return a phrase."""
        return self.phrases[key].format(**fields)

    def reproduction(
        self,
        *,
        rows: Iterable[ComparisonRow],
        tables: Iterable[Table],
        figures: Iterable[Figure],
        settings: dict[str, Any],
        claims: Iterable[Claim] = (),
        **summary: Any,
    ) -> Reproduction:
        """Return the whole page; ``summary`` are the fields of the system's ``page/page.md.jinja``."""
        return Reproduction(
            system=self.system,
            title=self.title,
            source=published(self.system).source,
            template=f"{self.system.lower()}/page/page.md.jinja",
            summary=summary,
            rows=tuple(rows),
            tables=tuple(tables),
            figures=tuple(figures),
            settings=settings,
            claims=tuple(claims),
            choices=self.choices,
        )


@cache
def page_text(system: str) -> PageText:
    """Return the texts of a system's page, by the system's letter."""
    return PageText.model_validate({"system": system} | read_toml(system, "page/text.toml"))
