"""The pages of the reproductions: for every system a JSON file for machines and a Markdown page for people.

Both are made of the same :class:`Reproduction`; the book's first page gathers the rows that have a bar.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.code import code_version
from horizonval.report.plots import png
from horizonval.store.folder import read_json, write_json
from horizonval.systems import markdown
from horizonval.systems.result import Reproduction

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
        "claims": [claim.plain() for claim in result.claims],
        "choices": list(result.choices),
        "rows": [row.plain() for row in result.rows],
        "tables": [
            {"title": t.title, "columns": list(t.columns), "rows": [list(r) for r in t.rows]} for t in result.tables
        ],
        "figures": [markdown.picture_name(letter, figure) for figure in result.figures],
    }
    for figure in result.figures:
        atomic.write_bytes(folder / markdown.picture_name(letter, figure), png(figure.draw, PICTURE_DPI))
    atomic.write_text(folder / f"{letter}.md", markdown.page(result, seed))
    write_json(folder / f"{letter}.json", content, bound=False)
    return content


def write_first_page(folder: Path) -> Path:
    """Write ``README.md`` of all systems whose JSON file lies in the folder; return its path."""
    contents = [
        content for path in sorted(folder.glob("[A-G].json")) if (content := read_json(path, bound=False)) is not None
    ]
    path = folder / "README.md"
    atomic.write_text(path, markdown.first_page(contents))
    return path


def printed_rows(content: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a system's table for a terminal; a name that is too long has a line of its own."""
    yield f"{content['system']}: {content['title']}"
    width = min(72, max((len(row["name"]) for row in content["rows"]), default=0))
    yield f"  {'':{width}}  {'published':>12}  {'measured':>12}"
    for row in content["rows"]:
        verdict = {None: "", True: "ok", False: "MISSED"}[row["holds"]]
        published, measured = markdown.as_printed(row["published"]), markdown.number(row["measured"])
        name = row["name"]
        if len(name) > width:
            yield f"  {name}"
            name = ""
        yield f"  {name:{width}}  {published:>12}  {measured:>12}  {row['unit']:8} {verdict}".rstrip()
