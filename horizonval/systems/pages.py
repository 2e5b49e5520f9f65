"""The pages of the reproductions: for every system a JSON file for machines and a Markdown page for people.

Both are made of the same :class:`Reproduction`; the first page gathers the rows that have a bar. Templates lie here and
in the systems' folders.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from horizonval.core import atomic
from horizonval.core.code import code_version
from horizonval.report.plots import png
from horizonval.store.folder import write_json
from horizonval.systems.result import Cell, ComparisonRow, Figure, Reproduction, Table


def page(result: Reproduction, seed: int) -> str:
    """Return one system's page."""
    heads = ["", "published", "measured", "unit", "bar", "why"]
    rows = [
        heads,
        *([r.name, as_printed(r.published), number(r.measured), r.unit, _met(r), r.why] for r in result.rows),
    ]
    claims = [
        ["printed", "where", "figure", "our reading", "measured", "would fail if", "status"],
        *([c.what, c.where, c.printed, c.reading, c.measured, c.fails, f"**{c.status}**"] for c in result.claims),
    ]
    template = _environment().get_template(result.template)
    return template.render(result=result, rows=rows, claims=claims, seed=seed, **result.summary)


def number(cell: Cell) -> str:
    """Return a cell as text: four significant digits."""
    if cell is None:
        return "–"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, int):
        return str(cell)
    cell += 0.0  # no minus before a zero
    if cell != 0.0 and not 1e-3 <= abs(cell) < 1e6:
        return f"{cell:.2e}"
    return f"{cell:.4g}" if abs(cell) < 1000 else f"{cell:.0f}"


def as_printed(cell: Cell) -> str:
    """Return a published figure as text, with all digits of the source."""
    return f"{cell:.7g}" if isinstance(cell, float) else number(cell)


def picture_name(system: str, figure: Figure) -> str:
    """Return the file name of a picture."""
    return f"{system}-{figure.name}.png"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("horizonval.systems", package_path=""),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    environment.filters |= {
        "format_as": format,
        "alt": _alt,
        "bar": _bar,
        "lines": _lines,
        "markdown": _markdown,
        "number": number,
        "paragraphs": _paragraphs,
    }
    environment.globals["picture_name"] = picture_name
    return environment


def _met(row: ComparisonRow) -> str:
    return "" if row.holds is None else f"{_bar(row.plain())}: {'met' if row.holds else '**missed**'}"


def _bar(row: dict[str, Any]) -> str:
    """Return the bar of a row as in the JSON file."""
    sign = "at least" if row["at_least"] else "at most"
    of = "" if row["against"] is None else f" from {as_printed(row['against'])}"
    return f"{sign} {number(row['limit'])}{of}"


def _lines(table: Table) -> list[list[str]]:
    return [list(table.columns), *([number(cell) for cell in row] for row in table.rows)]


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    """Return a table, the first line being its head."""
    text = [[cell.replace("|", "\\|").replace("\n", " ") for cell in line] for line in lines]
    head = "| " + " | ".join(text[0]) + " |"
    return "\n".join([head, "|" + "---|" * len(text[0]), *("| " + " | ".join(line) + " |" for line in text[1:])])


def _paragraphs(text: str) -> str:
    """Return a template's wrapped text with every paragraph on one line."""
    return "\n\n".join(" ".join(part.split()) for part in text.strip().split("\n\n"))


def _alt(figure: Figure) -> str:
    """Return the caption's first sentence; brackets would end the picture's text."""
    return figure.caption.split(". ")[0].rstrip(".").replace("[", "(").replace("]", ")")


SCHEMA = 1
PICTURE_DPI = 120


def write_reproduction(result: Reproduction, folder: Path, seed: int) -> dict[str, Any]:
    """Write ``<X>.json``, ``<X>.md`` and figures of one system; return the JSON; ``ValueError`` if not finite."""
    letter = result.system
    names = [row.name for row in result.rows]
    if len(set(names)) < len(names):
        raise ValueError(f"system {letter} has two rows of one name")
    if wrong := [row.name for row in result.rows if not math.isfinite(row.measured)]:
        raise ValueError(f"system {letter}: not a number: {wrong[0]}")
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "schema": SCHEMA,
        "system": letter,
        "title": result.title,
        "source": result.source,
        "version": code_version(),
        "seed": seed,
        "settings": result.settings,
        "claims": [claim.plain() for claim in result.claims],
        "choices": list(result.choices),
        "rows": [row.plain() for row in result.rows],
        "tables": [
            {"title": t.title, "columns": list(t.columns), "rows": [list(r) for r in t.rows]} for t in result.tables
        ],
        "figures": [picture_name(letter, figure) for figure in result.figures],
    }
    for figure in result.figures:
        atomic.write_bytes(folder / picture_name(letter, figure), png(figure.draw, PICTURE_DPI))
    atomic.write_text(folder / f"{letter}.md", page(result, seed))
    write_json(folder / f"{letter}.json", content, bound=False)
    return content
