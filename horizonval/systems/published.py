"""What the published systems' sources print: ``published.toml`` of every system, in one form.

The file holds the printed figures with their units and the place where each stands; nothing in it is ours. What this
package measures stands beside them on the pages (:mod:`horizonval.systems.pages`).
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import resources
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict

LOST = "lost"
"""Stands in a table for a figure that did not survive."""


def _or_lost(value: Any) -> Any:
    return None if value == LOST else value


Printed = Annotated[float | None, BeforeValidator(_or_lost)]


class _PublishedModel(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class PrintedFigure(_PublishedModel):
    """One printed figure, or a printed condition of an experiment.

    Attributes
    ----------
    value : float or int or str
        As printed; a text where the source claims without a number.
    unit : str
    where : str
        Table, figure, equation or part of the source.
    """

    value: int | float | str
    unit: str = ""
    where: str


class PrintedTable(_PublishedModel):
    """One printed table.

    Attributes
    ----------
    where : str
        Its number or caption in the source.
    settings : dict
        By quantity (unit in the name), one value for all columns or one for each.
    printed : dict
        By quantity, the printed figures; None where one is lost. Empty where all of them are.
    units : dict
        Of the printed quantities.
    errors : dict
        By quantity: printed ``mean`` and ``deviation`` of its errors, in its unit, where the source gives them.
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
    """All that is kept of one source.

    Attributes
    ----------
    source : str
        Authors, title, year.
    figures : dict of PrintedFigure
    tables : dict of PrintedTable
    """

    source: str
    figures: dict[str, PrintedFigure] = {}
    tables: dict[str, PrintedTable] = {}

    def number(self, key: str) -> float:
        """Return a printed figure that is a number.

        Raises
        ------
        TypeError
            For one that is a text.
        """
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
