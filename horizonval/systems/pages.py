"""The book of the reproductions: for every system a JSON file for machines and a Markdown page for people.

Both are made of the same :class:`Reproduction`; the book's first page gathers the rows that have a bar.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg

from horizonval.core import atomic
from horizonval.core.code import code_version
from horizonval.report.figures.plots import house_style
from horizonval.store.folder import read_json, write_json
from horizonval.systems.result import Cell, Figure, Reproduction, Row, Table

SCHEMA = 1
PICTURE_DPI = 120


def write_reproduction(result: Reproduction, folder: Path, seed: int) -> dict[str, Any]:
    """Write ``<X>.json``, ``<X>.md`` and the figures of one system; return the JSON's content.

    Raises
    ------
    ValueError
        A measured figure that is not finite: a defect of the experiment.
    """
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
        "rows": [_plain_row(row) for row in result.rows],
        "tables": [
            {"title": t.title, "columns": list(t.columns), "rows": [list(r) for r in t.rows]} for t in result.tables
        ],
        "figures": [_picture_name(letter, figure) for figure in result.figures],
    }
    for figure in result.figures:
        atomic.write_bytes(folder / _picture_name(letter, figure), _picture(figure))
    atomic.write_text(folder / f"{letter}.md", _page(result, seed))
    write_json(folder / f"{letter}.json", content)
    return content


def write_first_page(folder: Path) -> Path:
    """Write ``README.md`` of all systems whose JSON file lies in the folder; return its path."""
    lines = [
        "# Published systems, reproduced",
        "",
        "Made by `horizonval reproduce all --out DIR`. Every figure is measured in that run; the pages give all of",
        "them, with the reason for what differs.",
        "",
    ]
    for path in sorted(folder.glob("[A-E].json")):
        content = read_json(path)
        if content is None:
            continue
        letter = content["system"]
        held = [row for row in content["rows"] if row["holds"] is not None]
        kept = sum(row["holds"] for row in held)
        lines += [
            f"## [{letter}: {content['title']}]({letter}.md)",
            "",
            f"{content['source']}. {len(content['rows'])} rows; {kept} of {len(held)} bars are met. "
            f"Seed {content['seed']}.",
            "",
        ]
        missed = [row for row in held if not row["holds"]]
        if missed:
            lines += ["Missed:", ""]
            lines += [
                f"- {row['name']}: {_number(row['measured'])} {row['unit']} ({_bar(row)}). {row['why']}"
                for row in missed
            ]
            lines.append("")
    page = folder / "README.md"
    atomic.write_text(page, "\n".join(lines).rstrip() + "\n")
    return page


def printed_rows(content: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a system's table for a terminal; a name that is too long has a line of its own."""
    yield f"{content['system']}: {content['title']}"
    width = min(72, max((len(row["name"]) for row in content["rows"]), default=0))
    yield f"  {'':{width}}  {'published':>12}  {'measured':>12}"
    for row in content["rows"]:
        verdict = {None: "", True: "ok", False: "MISSED"}[row["holds"]]
        published, measured = _as_printed(row["published"]), _number(row["measured"])
        name = row["name"]
        if len(name) > width:
            yield f"  {name}"
            name = ""
        yield f"  {name:{width}}  {published:>12}  {measured:>12}  {row['unit']:8} {verdict}".rstrip()


def _plain_row(row: Row) -> dict[str, Any]:
    return {
        "name": row.name,
        "published": row.published,
        "measured": float(row.measured),
        "unit": row.unit,
        "why": row.why,
        "limit": row.limit,
        "against": row.against,
        "at_least": row.at_least,
        "holds": row.holds,
    }


def _bar(row: dict[str, Any]) -> str:
    sign = "at least" if row["at_least"] else "at most"
    of = "" if row["against"] is None else f" from {_as_printed(row['against'])}"
    return f"{sign} {_number(row['limit'])}{of}"


def _page(result: Reproduction, seed: int) -> str:
    parts = [f"# {result.system}: {result.title}", f"{result.source}.", result.summary]
    for figure in result.figures:
        parts.append(f"![{_alt(figure)}]({_picture_name(result.system, figure)})\n\n{figure.caption}")
    parts += ["## Published and measured", _rows(result.rows)]
    for table in result.tables:
        parts += [f"## {table.title}", *([table.caption] if table.caption else []), _table(table)]
    name = f"{result.system}.json"
    made = f"Made by `horizonval reproduce {result.system} --seed {seed} --out DIR`"
    parts.append(f"{made}; all rows are also in [{name}]({name}).")
    return "\n\n".join(parts) + "\n"


def _rows(rows: Sequence[Row]) -> str:
    lines = [["", "published", "measured", "unit", "bar", "why"]]
    for row in rows:
        plain = _plain_row(row)
        bar = "" if row.holds is None else f"{_bar(plain)}: {'met' if row.holds else '**missed**'}"
        lines.append([row.name, _as_printed(row.published), _number(row.measured), row.unit, bar, row.why])
    return _markdown(lines)


def _table(table: Table) -> str:
    return _markdown([list(table.columns), *([_number(cell) for cell in row] for row in table.rows)])


def _markdown(lines: Sequence[Sequence[str]]) -> str:
    text = [[cell.replace("|", "\\|").replace("\n", " ") for cell in line] for line in lines]
    head = "| " + " | ".join(text[0]) + " |"
    return "\n".join([head, "|" + "---|" * len(text[0]), *("| " + " | ".join(line) + " |" for line in text[1:])])


def _number(cell: Cell) -> str:
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


def _as_printed(cell: Cell) -> str:
    """Return a published figure as text, with all digits of the source."""
    return f"{cell:.7g}" if isinstance(cell, float) else _number(cell)


def _alt(figure: Figure) -> str:
    """Return the caption's first sentence; brackets would end the picture's text."""
    return figure.caption.split(". ")[0].rstrip(".").replace("[", "(").replace("]", ")")


def _picture_name(letter: str, figure: Figure) -> str:
    return f"{letter}-{figure.name}.png"


def _picture(figure: Figure) -> bytes:
    with house_style():
        drawn = figure.draw()
        for axes in drawn.axes:
            if axes.images:
                # The house's grid is for curves; over a picture it would be taken for a part of it.
                axes.grid(visible=False)
        FigureCanvasAgg(drawn)
        stream = io.BytesIO()
        drawn.savefig(stream, format="png", dpi=PICTURE_DPI, metadata={"Software": None})
    return stream.getvalue()
