"""Rows, claims and pages of the reproductions; the committed pages; kept work."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from matplotlib.figure import Figure as MplFigure
from pydantic import ValidationError

from horizonval.core.errors import UserError
from horizonval.store.folder import read_json
from horizonval.systems import pages
from horizonval.systems import run as run_module
from horizonval.systems.page import printed_rows, write_first_page
from horizonval.systems.pages import write_reproduction
from horizonval.systems.published import PageText, PrintedTable, Published, page_text, published
from horizonval.systems.quick import ROWS, SYSTEMS, chosen, experiment
from horizonval.systems.result import Claim, ComparisonRow, Figure, Reproduction, Status, Table
from horizonval.systems.task_cache import TaskCache, rng_of

PAGES = Path(__file__).parents[3] / "results" / "published"
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
CONDITIONS = {
    "E": {"start", "length", "step", "noise_rounding", "stations"},
    "G": {"altitude", "raised", "inclination"},
}
"""Conditions of the experiment that the sources print: there is nothing to judge."""
COUNTS = {
    "A": {"published set-ups that the published method answers": 5},
    "B": {"hardware in the loop: RMS over that of the perfect bench": 19.8},
    "E": {"published proposed figures matched or beaten": 18},
}
"""Published figures, by the row's start, that we counted or divided from printed figures that have claims."""


def content_of(system: str) -> dict[str, Any]:
    return json.loads((PAGES / f"{system}.json").read_text())


def numbers_in(text: str) -> list[float]:
    return [float(found) for found in NUMBER.findall(text)]


def judges(claim: dict[str, str], figure: float | str) -> bool:
    """Whether a claim's printed figures hold this one, which may be rounded to two digits there."""
    if isinstance(figure, str):
        return figure in claim["printed"] or numbers_in(figure)[:1] == numbers_in(claim["printed"])[:1] != []
    return any(math.isclose(figure, one, rel_tol=0.025, abs_tol=1e-12) for one in numbers_in(claim["printed"]))


def unclaimed_rows(system: str, content: dict[str, Any]) -> Iterator[str]:
    """Yield the rows whose published figure is in no claim."""
    for row in content["rows"]:
        figure = row["published"]
        if figure is None:
            continue
        counted = [value for name, value in COUNTS.get(system, {}).items() if row["name"].startswith(name)]
        if counted != [figure] and not any(judges(claim, figure) for claim in content["claims"]):
            yield f"{row['name']}: {figure}"


def unclaimed_entries(system: str, content: dict[str, Any]) -> Iterator[str]:
    """Yield what the source prints and no claim of the same place judges."""
    source = published(system)
    for key, entry in (*source.figures.items(), *source.tables.items()):
        if key not in CONDITIONS.get(system, ()) and not any(entry.where in c["where"] for c in content["claims"]):
            yield f"{key}: {entry.where}"
    for key, table in source.tables.items():
        own = [claim for claim in content["claims"] if table.where in claim["where"]]
        figures = {f"{name} {i}": one for name, each in table.printed.items() for i, one in enumerate(each)}
        figures |= {f"{name} {kind}": one for name, each in table.errors.items() for kind, one in each.items()}
        for name, figure in figures.items():
            if figure is not None and not any(judges(claim, figure) for claim in own):
                yield f"table {key}, {name}: {figure}"


@pytest.mark.parametrize("system", ROWS)
def test_every_printed_figure_belongs_to_a_claim(system: str) -> None:
    content = content_of(system)
    assert list(unclaimed_rows(system, content)) == []
    assert list(unclaimed_entries(system, content)) == []
    assert list(unclaimed_entries(system, {**content, "claims": []}))


@pytest.mark.parametrize("system", ROWS)
def test_claims_are_complete_and_on_the_page(system: str) -> None:
    content, page = content_of(system), (PAGES / f"{system}.md").read_text()
    assert len({claim["what"] for claim in content["claims"]}) == len(content["claims"])
    for claim in content["claims"]:
        assert set(claim) == {"what", "where", "printed", "reading", "measured", "fails", "status"}
        assert all(isinstance(text, str) and text.strip() for text in claim.values()), claim["what"]
        assert claim["status"] in list(Status)
        lines = [line for line in page.splitlines() if claim["what"] in line and claim["printed"] in line]
        assert any(claim["status"] in line for line in lines), claim["what"]


@pytest.mark.parametrize("system", ROWS)
def test_committed_pages_are_made_of_the_committed_numbers(system: str) -> None:
    """Rows and tables; summaries and figures need the run."""
    content = content_of(system)
    keys = [field.name for field in dataclasses.fields(ComparisonRow)]
    rows = tuple(ComparisonRow(*(row[key] for key in keys)) for row in content["rows"])
    captions = {table.title: table.caption for table in page_text(system).tables.values()}
    tables = tuple(
        Table(t["title"], tuple(t["columns"]), tuple(map(tuple, t["rows"])), captions.get(t["title"], ""))
        for t in content["tables"]
    )
    claims = tuple(Claim(**{**claim, "status": Status(claim["status"])}) for claim in content["claims"])
    result = Reproduction(
        system,
        content["title"],
        content["source"],
        rows,
        tables,
        settings=content["settings"],
        claims=claims,
        choices=tuple(content["choices"]),
    )
    committed = (PAGES / f"{system}.md").read_text()
    head, *sections = pages.page(result, content["seed"]).split("\n## ")
    assert committed.startswith(head.split("\n\n\n")[0])
    for section in sections:
        # a caption with numbers of the run is not in the JSON file
        assert section.split("\n\n")[-1] in committed
        assert section.split("\n")[0] in committed


def test_a_row_is_made_of_its_text_and_the_numbers_of_the_run() -> None:
    texts = {"rms": {"name": "rms at {px} px", "unit": "deg", "why": "Of {n} frames: {ratio:.0%}."}}
    text = PageText.model_validate({"system": "A", "title": "a method", "rows": texts})
    row = text.row("rms", 0.25, "small", limit=1.0, px=50, n=3, ratio=0.5)
    assert row == ComparisonRow("rms at 50 px", "small", 0.25, "deg", "Of 3 frames: 50%.", limit=1.0)
    with pytest.raises(KeyError, match="n"):
        text.row("rms", 0.25, px=50)


def test_a_figure_lost_in_print_is_none_and_a_misspelt_key_is_refused() -> None:
    table = {"where": "table 1", "settings": {"roll_deg": 5.0}, "units": {"roll": "deg"}}
    table["printed"] = {"roll": [1.0, "lost"]}
    assert [read["roll"] for _, read in PrintedTable.model_validate(table).columns()] == [1.0, None]
    with pytest.raises(ValidationError):
        Published.model_validate({"source": "x", "figure": {}})
    with pytest.raises(TypeError, match="exact"):
        published("C").number("exact")


def _draw() -> MplFigure:
    figure = MplFigure(figsize=(2, 1))
    figure.subplots().plot([0, 1], [0, 1])
    return figure


def _result(measured: float = 0.03, **changed: Any) -> Reproduction:
    return replace(
        Reproduction(
            system="B",
            title="a method",
            source="Somebody 2001",
            rows=(
                ComparisonRow("rms", 0.038, measured, "deg", "alike", limit=0.038),
                ComparisonRow("entry | one", 1.0, 1.05, "deg", "quantised", limit=0.0708, against=1.0),
                ComparisonRow("reach", "20", 25.0, "deg", "further", limit=20.0, at_least=True),
                ComparisonRow("lost", None, 5.0, "arcsec", "did not survive"),
            ),
            tables=(Table("Errors", ("what", "value"), (("x", 1.25), ("y", None))),),
            figures=(Figure("map", "A map [deg]. More of it", _draw),),
        ),
        **changed,
    )


def test_a_bar_counts_departure_from_zero_from_a_figure_or_from_below():
    assert [row.holds for row in _result().rows] == [True, True, True, None]
    assert ComparisonRow("x", 1.0, 1.08, "deg", "", limit=0.0708, against=1.0).holds is False
    assert ComparisonRow("x", 1.0, -25.0, "deg", "", limit=20.0, at_least=True).holds is False


def test_json_page_and_picture_say_the_same_in_the_same_bytes(tmp_path):
    content = write_reproduction(_result(), tmp_path / "one", seed=3)
    assert read_json(tmp_path / "one" / "B.json", bound=False) == content
    row = content["rows"][1]
    assert (row["published"], row["measured"], row["unit"], row["why"]) == (1.0, 1.05, "deg", "quantised")
    page = (tmp_path / "one" / "B.md").read_text()
    assert "entry \\| one" in page
    # brackets would end the picture's text
    assert "![A map (deg)](B-map.png)" in page
    assert (tmp_path / "one" / "B-map.png").read_bytes().startswith(b"\x89PNG")
    write_reproduction(_result(), tmp_path / "two", seed=3)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()
    missed = write_reproduction(_result(0.05), tmp_path / "two", seed=3)
    assert any("MISSED" in line for line in printed_rows(missed))
    assert "Missed" in write_first_page(tmp_path / "two").read_text()


def test_a_figure_that_is_no_number_is_a_defect(tmp_path):
    with pytest.raises(ValueError, match="rms"):
        write_reproduction(_result(math.nan), tmp_path, seed=0)


def test_published_figures_keep_the_digits_of_their_source_and_columns_their_place(tmp_path):
    row = ComparisonRow("roll", 3.0052, 2.96985, "deg", "a step less", limit=0.0708, against=3.0052)
    content = write_reproduction(_result(rows=(row, replace(row, name="long " * 20))), tmp_path, seed=0)
    assert "| roll | 3.0052 | 2.97 | deg | at most 0.0708 from 3.0052: met |" in (tmp_path / "B.md").read_text()
    lines = [line for line in printed_rows(content) if "3.0052" in line]
    assert len(lines) == 2
    assert len({line.index("3.0052") for line in lines}) == 1


def test_letters_are_chosen_in_any_case_and_every_system_has_its_experiment():
    assert chosen([]) == list(SYSTEMS)
    assert chosen(["d", "A"]) == ["A", "D"]
    with pytest.raises(UserError, match="'X'"):
        chosen(["X"])
    assert all(callable(experiment(letter).reproduce) for letter in SYSTEMS)


def test_random_numbers_belong_to_seed_and_names():
    draws = [rng_of(*who).standard_normal() for who in ((0, "a"), (1, "a"), (0, "b"), (0, "a", "b"))]
    assert len(set(draws)) == 4
    assert rng_of(0, "a").standard_normal() == draws[0]


def _ordered(item):
    return {"b": 1, "a": 2}


def _square(item):
    if item["x"] == 13:
        raise ValueError("thirteen")
    with Path(item["log"]).open("a") as log:
        log.write("x")
    return {"square": item["x"] ** 2}


@pytest.mark.slow
def test_what_is_done_is_kept_when_another_item_fails(tmp_path):
    log = tmp_path / "log"
    items = {str(x): {"x": x, "log": str(log)} for x in (2, 13, 3)}
    shop = TaskCache(tmp_path / "work", workers=2)
    for _ in range(2):
        with pytest.raises(RuntimeError, match="thirteen"):
            shop.each("squares", _square, items)
    assert len(log.read_text()) == 2, "each good item was worked on once"
    del items["13"]
    assert shop.each("squares", _square, items) == {"2": {"square": 4}, "3": {"square": 9}}
    items["2"]["x"] = 5
    assert shop.each("squares", _square, items)["2"] == {"square": 25}, "another item, another result"
    # The order of keys is that of the function, also of what is read back.
    for _ in range(2):
        assert list(shop.each("orders", _ordered, {"one": {}})["one"]) == ["b", "a"]


def test_a_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(UserError, match="is not empty"):
        next(run_module.reproduce_systems(["C"], tmp_path))


def test_a_second_run_in_the_same_folder_is_refused_and_leftovers_of_a_killed_one_go(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "experiment", lambda letter: SimpleNamespace(reproduce=lambda cache: _result()))
    monkeypatch.setattr(run_module, "write_quick", lambda *_: None)
    out = tmp_path / "pages"
    left = out / run_module.WORK / "ab" / ".abc.json.1.tmp"
    left.parent.mkdir(parents=True)
    left.write_text("{")
    first = run_module.reproduce_systems(["B"], out)
    assert next(first)["system"] == "B"
    assert not left.exists()
    with pytest.raises(UserError, match="another run"):
        next(run_module.reproduce_systems(["B"], out))
    first.close()
    assert [one["seed"] for one in run_module.reproduce_systems(["B"], out, seed=7)] == [7]
    assert "Seed 7" in (out / "README.md").read_text()
