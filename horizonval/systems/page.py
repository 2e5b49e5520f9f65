"""The pages of the published systems: ``<X>.json``, ``<X>.md`` and pictures of one system, and the first page.

All are made of the rows of :mod:`horizonval.systems.entries`, one for each figure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.code import code_version
from horizonval.report.plots import png
from horizonval.store.folder import read_json, write_json
from horizonval.systems.entries import Cell, Result, Row, Status, system

SCHEMA = 2
PICTURE_DPI = 120
LEGEND = """\
Reproduced: measured, and within what is said to make it fail. Bounded: ours is on the better side, or agrees under \
sizes or a reading that the source does not give. Contradicted: measured, and not so. Not determinable: the source \
says too little for any measurement to decide."""
FIRST = """\
# Published systems, reproduced

Made by `horizonval reproduce all --out DIR`. Every figure that a source prints is judged on the system's page: how we \
read it, what we measure, what would make it fail. Only what can be missed has a criterion."""


def write_system(letter: str, result: Result, folder: Path, seed: int) -> dict[str, Any]:
    """Write a system's JSON file, page and pictures; return the JSON. ``ValueError``: an entry is not measured."""
    source = system(letter)
    if missing := {*source.entry} - {*result.values} - {key for key, one in source.entry.items() if not one.limits}:
        raise ValueError(f"system {letter}: not measured: {', '.join(sorted(missing))}")
    unmeasured: dict[str, Any] = dict.fromkeys(source.entry)
    rows = list(source.rows(unmeasured | dict(result.values), result.notes))
    if len({row.name for row in rows}) < len(rows):
        raise ValueError(f"system {letter} has two rows of one name")
    content = {
        "schema": SCHEMA,
        "system": letter,
        "title": source.title,
        "source": source.source,
        "version": code_version(),
        "seed": seed,
        "settings": dict(result.settings),
        "choices": list(source.choices),
        "rows": [row.plain() for row in rows],
        "tables": [{"title": t.title, "columns": [*t.columns], "rows": [[*r] for r in t.rows]} for t in result.tables],
        "figures": [f"{letter}-{name}.png" for name in result.figures],
    }
    page = system_page(letter, result, rows, seed)
    folder.mkdir(parents=True, exist_ok=True)
    for name, draw in result.figures.items():
        atomic.write_bytes(folder / f"{letter}-{name}.png", png(draw, PICTURE_DPI))
    for path in folder.glob(f"{letter}-*.png"):
        if path.name.removeprefix(f"{letter}-").removesuffix(".png") not in result.figures:
            path.unlink()
    atomic.write_text(folder / f"{letter}.md", page)
    write_json(folder / f"{letter}.json", content, bound=False)
    return content


def system_page(letter: str, result: Result, rows: Sequence[Row], seed: int) -> str:
    """Return one system's page in Markdown."""
    source = system(letter)
    parts = [f"# {letter}: {source.title}", f"{source.source}.", source.summary.format(**result.values).strip()]
    for name in result.figures:
        caption = source.figure[name]
        # Brackets would end the picture's text.
        text = caption.split(". ")[0].rstrip(".").translate(str.maketrans("[]", "()"))
        parts += [f"![{text}]({letter}-{name}.png)", caption]
    printed: list[tuple[Cell, ...]] = []
    ours: list[tuple[Cell, ...]] = []
    for key, group in groupby(rows, lambda row: row.key):
        of, entry = list(group), source.entry[key]
        unit = f" {entry.unit}" if entry.unit else ""
        measured = ", ".join(number(row.measured) for row in of) + unit + (f" ({of[0].note})" if of[0].note else "")
        if entry.printed is None:
            ours.append((entry.what, measured, entry.criterion, _count([row.status for row in of]), entry.reading))
            continue
        figures = of if isinstance(entry.printed, tuple) else of[:1]
        shown = ", ".join(as_printed(row.published) for row in figures)
        shown += "" if isinstance(entry.printed, str) else unit
        printed.append(
            (
                entry.what,
                entry.where,
                shown,
                entry.reading,
                measured,
                entry.criterion,
                f"**{_count([row.status for row in of])}**",
            )
        )
    heads = ("printed", "where", "figure", "our reading", "measured", "would fail", "status")
    parts += ["## What the source prints", markdown(heads, printed), LEGEND]
    if source.choices:
        parts += ["## Chosen after a result was seen", "\n".join(f"- {choice}" for choice in source.choices)]
    if ours:
        parts += ["## Our figures", markdown(("figure", "measured", "would miss", "", "what it shows"), ours)]
    for table in result.tables:
        parts += [f"## {table.title}", *([table.caption] if table.caption else []), markdown(table.columns, table.rows)]
    end = f"Made by `horizonval reproduce {letter} --seed {seed} --out DIR`; all figures are also in"
    return "\n\n".join([*parts, f"{end} [{letter}.json]({letter}.json)."]) + "\n"


def write_first_page(folder: Path) -> Path:
    """Write ``README.md`` of all systems whose JSON file is in the folder; return its path."""
    found = (read_json(path, bound=False) for path in sorted(folder.glob("[A-G].json")))
    path = folder / "README.md"
    atomic.write_text(path, first_page([content for content in found if content is not None]))
    return path


def first_page(contents: Sequence[dict[str, Any]]) -> str:
    """Return the page over all systems, from the contents of their JSON files."""
    judged = [row["holds"] for content in contents for row in content["rows"] if row["holds"] is not None]
    parts = [FIRST, f"{sum(judged)} of {len(judged)} criteria are met."]
    for content in contents:
        name, rows = content["system"], content["rows"]
        holds = [row["holds"] for row in rows if row["holds"] is not None]
        parts += [f"## [{name}: {content['title']}]({name}.md)"]
        counts = f"{len(rows)} figures; {sum(holds)} of {len(holds)} criteria are met. Seed {content['seed']}."
        parts.append(f"{content['source']}. {counts}")
        statuses = _count([row["status"] for row in rows if row["published"] is not None])
        parts.append(f"Of what the source prints: {statuses}.")
        missed = (row for row in rows if row["holds"] is False)
        lines = [_missed(list(of)) for _, of in groupby(missed, lambda row: str(row["key"]))]
        parts += ["Missed:", "\n".join(lines)] if lines else []
    return "\n\n".join(parts) + "\n"


def _missed(rows: Sequence[dict[str, Any]]) -> str:
    """Return a line on the rows of one entry that are missed."""
    names = [rows[0]["name"], *(row["name"].rpartition(": ")[2] for row in rows[1:])]
    figures = (f"{name}: {number(row['measured'])}" for name, row in zip(names, rows, strict=True))
    line = f"- {', '.join(figures)} {rows[0]['unit']}".rstrip()
    printed = dict.fromkeys(as_printed(row["published"]) for row in rows if row["published"] is not None)
    return line + (f" (printed: {', '.join(printed)})" if printed else "") + f". {rows[0]['why']}"


def printed_rows(content: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a system's table for a terminal; a name that is too long has a line of its own."""
    yield f"{content['system']}: {content['title']}"
    width = min(72, max((len(row["name"]) for row in content["rows"]), default=0))
    yield f"  {'':{width}}  {'published':>12}  {'measured':>12}"
    for row in content["rows"]:
        verdict = {None: "", True: "ok", False: "MISSED"}[row["holds"]]
        published, measured = as_printed(row["published"]), number(row["measured"])
        name = row["name"]
        if len(name) > width:
            yield f"  {name}"
            name = ""
        yield f"  {name:{width}}  {published:>12}  {measured:>12}  {row['unit']:8} {verdict}".rstrip()


def markdown(heads: Sequence[str], lines: Sequence[Sequence[Cell]]) -> str:
    """Return a table."""
    cells = [[*heads], *([number(cell) for cell in line] for line in lines)]
    text = ["| " + " | ".join(c.replace("|", "\\|").replace("\n", " ") for c in line) + " |" for line in cells]
    return "\n".join([text[0], "|" + "---|" * len(heads), *text[1:]])


def number(cell: Cell) -> str:
    """Return a cell as text: four significant digits."""
    if cell is None:
        return "–"
    if isinstance(cell, str | int):
        return str(cell)
    cell += 0.0  # no minus before a zero
    if cell != 0.0 and not 1e-3 <= abs(cell) < 1e6:
        return f"{cell:.2e}"
    return f"{cell:.4g}" if abs(cell) < 1000 else f"{cell:.0f}"


def as_printed(cell: Cell) -> str:
    """Return a published figure as text, with all digits of the source."""
    return f"{cell:.7g}" if isinstance(cell, float) else number(cell)


def _count(statuses: Sequence[str]) -> str:
    """Return statuses in words, with their numbers if there are several."""
    counts = Counter(statuses)
    words = [(counts[status], str(status)) for status in Status if status and counts[status]]
    return words[0][1] if len(statuses) == 1 and words else ", ".join(f"{n} {word}" for n, word in words)
