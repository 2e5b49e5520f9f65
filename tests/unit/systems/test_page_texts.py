"""The pages' texts and the printed figures: beside the code, not in it, and those of the committed pages."""

from __future__ import annotations

import ast
import dataclasses
import json
import re
import string
from pathlib import Path

import pytest
from pydantic import ValidationError

import horizonval.systems
from horizonval.systems import pages
from horizonval.systems.published import PageText, PrintedTable, Published, page_text, published
from horizonval.systems.quick import SYSTEMS
from horizonval.systems.result import Claim, ComparisonRow, Reproduction, Status, Table

HERE = Path(horizonval.systems.__file__).parent
PAGES = Path(__file__).parents[3] / "results" / "published"
LABEL_WORDS = 12
"""A string of more words than this is a sentence."""


def _pattern(template: str) -> re.Pattern[str]:
    """Return what a text may have become once its fields are filled."""
    parts = string.Formatter().parse(template)
    return re.compile("".join(re.escape(text) + ("" if field is None else "[^\n]*") for text, field, _, _ in parts))


@pytest.mark.parametrize("system", SYSTEMS)
def test_committed_rows_say_what_the_texts_say(system: str) -> None:
    texts = [[_pattern(part) for part in (t.name, t.unit, t.why)] for t in page_text(system).rows.values()]
    keys = ("name", "unit", "why")
    rows = json.loads((PAGES / f"{system}.json").read_text())["rows"]
    for row in rows:
        assert any(all(p.fullmatch(row[k]) for p, k in zip(text, keys, strict=True)) for text in texts), row["name"]


@pytest.mark.parametrize("system", SYSTEMS)
def test_committed_claims_say_what_the_texts_say_and_their_statuses_are_known(system: str) -> None:
    content = json.loads((PAGES / f"{system}.json").read_text())
    texts = page_text(system).claims.values()
    for claim in content.get("claims", ()):
        assert claim["status"] in list(Status)
        assert all(claim.values())
        assert any(_pattern(text.what).fullmatch(claim["what"]) for text in texts), claim["what"]
    assert len({claim["what"] for claim in content.get("claims", ())}) == len(content.get("claims", ()))
    for choice in content.get("choices", ()):
        assert choice in (PAGES / f"{system}.md").read_text()


@pytest.mark.parametrize("system", SYSTEMS)
def test_committed_pages_show_every_caption(system: str) -> None:
    page = (PAGES / f"{system}.md").read_text()
    text = page_text(system)
    assert page.startswith(f"# {system}: {text.title}\n\n{published(system).source}.\n\n")
    titles = [part for table in text.tables.values() for part in (table.title, table.caption)]
    for caption in [*text.figures.values(), *titles]:
        assert _pattern(caption).search(page), caption


@pytest.mark.parametrize("system", SYSTEMS)
def test_committed_pages_are_made_of_the_committed_numbers(system: str) -> None:
    """Rows and tables; summaries and figures need the run."""
    content = json.loads((PAGES / f"{system}.json").read_text())
    keys = [field.name for field in dataclasses.fields(ComparisonRow)]
    rows = tuple(ComparisonRow(*(row[key] for key in keys)) for row in content["rows"])
    captions = {table.title: table.caption for table in page_text(system).tables.values()}
    tables = tuple(
        Table(t["title"], tuple(t["columns"]), tuple(map(tuple, t["rows"])), captions.get(t["title"], ""))
        for t in content["tables"]
    )
    claims = tuple(Claim(**{**claim, "status": Status(claim["status"])}) for claim in content.get("claims", ()))
    result = Reproduction(
        system,
        content["title"],
        content["source"],
        rows,
        tables,
        settings=content["settings"],
        claims=claims,
        choices=tuple(content.get("choices", ())),
    )
    committed = (PAGES / f"{system}.md").read_text()
    head, *sections = pages.page(result, content["seed"]).split("\n## ")
    assert committed.startswith(head.split("\n\n\n")[0])
    for section in sections:
        # a caption with numbers of the run is not in the JSON file
        assert section.split("\n\n")[-1] in committed
        assert section.split("\n")[0] in committed


def test_the_committed_first_page_is_made_of_the_committed_numbers() -> None:
    contents = [json.loads((PAGES / f"{system}.json").read_text()) for system in SYSTEMS]
    assert pages.first_page(contents) == (PAGES / "README.md").read_text()


def test_a_row_is_made_of_its_text_and_the_numbers_of_the_run() -> None:
    texts = {"rms": {"name": "rms at {px} px", "unit": "deg", "why": "Of {n} frames: {ratio:.0%}."}}
    text = PageText.model_validate({"system": "A", "title": "a method", "rows": texts})
    row = text.row("rms", 0.25, "small", limit=1.0, px=50, n=3, ratio=0.5)
    assert row == ComparisonRow("rms at 50 px", "small", 0.25, "deg", "Of 3 frames: 50%.", limit=1.0)
    with pytest.raises(KeyError, match="n"):
        text.row("rms", 0.25, px=50)


def test_python_holds_no_sentence() -> None:
    """Docstrings apart: what people read on the pages stands in the systems' text files."""
    sentences = []
    for system in SYSTEMS:
        for path in (HERE / system.lower()).rglob("*.py"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
            parts = {id(v) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for v in node.values}
            for node in ast.walk(tree):
                if isinstance(node, ast.JoinedStr):
                    words = " ".join(str(v.value) for v in node.values if isinstance(v, ast.Constant))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs | parts:
                    words = node.value
                else:
                    continue
                if len(words.split()) > LABEL_WORDS:
                    sentences.append(f"{path.relative_to(HERE)}:{node.lineno}: {words}")
    assert not sentences


@pytest.mark.parametrize("system", SYSTEMS)
def test_printed_figures_say_where_they_stand(system: str) -> None:
    source = published(system)
    assert source.figures or source.tables
    for entry in [*source.figures.values(), *source.tables.values()]:
        assert entry.where
    for table in source.tables.values():
        assert set(table.units) == set(table.printed)
        assert len({len(figures) for figures in table.printed.values()}) <= 1


def test_a_figure_lost_in_print_is_none_and_a_misspelt_key_is_refused() -> None:
    table = {"where": "table 1", "settings": {"roll_deg": 5.0}, "units": {"roll": "deg"}}
    table["printed"] = {"roll": [1.0, "lost"]}
    assert [read["roll"] for _, read in PrintedTable.model_validate(table).columns()] == [1.0, None]
    with pytest.raises(ValidationError):
        Published.model_validate({"source": "x", "figure": {}})
    with pytest.raises(TypeError, match="exact"):
        published("C").number("exact")
