"""The English of the pages: ``page/text.toml`` of every system, and what is built of it and of numbers.

Rows, tables and figures of a system are made here alone, so that the experiments hold numbers and no prose. Texts have
fields of :meth:`str.format`, filled with the numbers of the run. A page's summary is a template beside it,
``page/page.md.jinja``. They lie apart from the code: a better word makes no result again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict

from horizonval.systems.published import published, read_toml
from horizonval.systems.result import Cell, Claim, ComparisonRow, Figure, Reproduction, Status, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure as MplFigure


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

    Attributes
    ----------
    system : str
        Its letter.
    title : str
        What the system is.
    rows, tables, claims : dict
        By key.
    choices : tuple of str
        What was chosen after a result had been seen.
    figures : dict of str
        Captions, by the figure's name.
    phrases : dict of str
        Parts of sentences, and cells of tables, that depend on the outcome.
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

        Parameters
        ----------
        key : str
            Of the text; also of the printed figure or table, unless ``figure`` names that, and unless the text says
            itself where it stands.
        printed : float or str
            As printed, with the unit if it is a text.
        status : Status
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
