"""Entries of published systems: judgement, the page and the JSON file made of them, the committed files."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from matplotlib.figure import Figure as MplFigure
from pydantic import ValidationError

from horizonval.store.folder import read_json
from horizonval.systems import page
from horizonval.systems.entries import Entry, Result, System, Table, system
from horizonval.systems.page import first_page, printed_rows, write_first_page, write_system
from horizonval.systems.quick import SYSTEMS

PAGES = Path(__file__).parents[3] / "results" / "published"


@pytest.mark.parametrize(
    ("criterion", "printed", "measured", "status"),
    [
        ({"at_most": 0.04}, 0.04, 0.04, "reproduced"),
        ({"at_most": 0.04, "good": "bounded"}, 0.04, 0.01, "bounded"),
        ({"at_most": 0.04}, "small", 0.05, "contradicted"),
        ({"at_least": 2.0}, None, 2.0, "met"),
        ({"at_least": 2.0}, None, 1.9, "missed"),
        ({"within": 0.1}, 1.0, 0.89, "contradicted"),
        ({"factor": 2.0}, 1.0, 0.5, "reproduced"),
        ({"factor": 2.0}, 1.0, 2.1, "contradicted"),
        ({}, "wide", None, "not determinable"),
        ({}, None, 3.0, ""),
    ],
)
def test_judgement(criterion, printed, measured, status):
    (row,) = Entry(what="x", reading="y", printed=printed, **criterion).rows("x", measured)
    assert row.status == status
    assert row.holds is {"reproduced": True, "bounded": True, "met": True, "": None, "not determinable": None}.get(
        status, False
    )


def test_a_list_has_a_row_for_each_figure_and_what_cannot_be_is_refused():
    entry = Entry(what="rms", reading="y", printed=(1.0, 2.0), within=(0.1, 0.2), labels=("roll", "pitch"))
    rows = list(entry.rows("rms", [1.0, 2.3]))
    assert [(row.name, row.published, row.status) for row in rows] == [
        ("rms: roll", 1.0, "reproduced"),
        ("rms: pitch", 2.0, "contradicted"),
    ]
    for wrong in ([1.0], [1.0, math.nan], 1.0):
        with pytest.raises(ValueError, match="rms"):
            list(entry.rows("rms", wrong))
    with pytest.raises(ValueError, match="printed number"):
        list(Entry(what="x", reading="y", printed="small", within=1.0).rows("x", 0.0))
    with pytest.raises(ValidationError):
        Entry(what="x", reading="y", at_mots=1.0)


def _draw() -> MplFigure:
    figure = MplFigure(figsize=(2, 1))
    figure.subplots().plot([0, 1], [0, 1])
    return figure


def test_page_and_json_say_the_same_in_the_same_bytes(tmp_path, monkeypatch):
    data = {
        "title": "a method",
        "source": "Somebody 2001",
        "summary": "Error {rms:.2f} deg, tilts {tilt[1]:.1f} deg.",
        "entry": {
            "rms": {"what": "entry | one", "printed": 3.0052, "unit": "deg", "reading": "r", "at_most": 0.038},
            "tilt": {"what": "tilt", "printed": [1.0, 2.0], "reading": "r", "within": 0.5, "labels": ["a", "b"]},
            "wide": {"what": "range", "printed": "wide", "where": "end", "reading": "no number"},
            "ours": {"what": "of ours", "reading": "r"},
        },
        "figure": {"map": "A map [deg]. More of it"},
    }
    source = System.model_validate(data)
    monkeypatch.setattr(page, "system", lambda letter: source)
    table = Table("Errors", ("what", "value"), (("x", 1.25), ("y", None)))
    result = Result({"rms": 0.05, "tilt": [1.0, 2.2], "ours": 5.0}, {"map": _draw}, [table], {"rms": "of 3"})
    content = write_system("B", result, tmp_path / "one", seed=3)
    assert read_json(tmp_path / "one" / "B.json", bound=False) == content
    text = (tmp_path / "one" / "B.md").read_text()
    assert "Error 0.05 deg, tilts 2.2 deg." in text
    assert "| entry \\| one |  | 3.0052 deg | r | 0.05 deg (of 3) | above 0.038 deg | **contradicted** |" in text
    assert "| tilt |  | 1, 2 | r | 1, 2.2 | farther from the figure than 0.5 | **2 reproduced** |" in text
    assert "| range | end | wide | no number | – |  | **not determinable** |" in text
    assert "![A map (deg)](B-map.png)" in text
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "B-old.png").write_bytes(b"")
    write_system("B", result, tmp_path / "two", seed=3)
    assert {p.name: p.read_bytes() for p in (tmp_path / "one").iterdir()} == {
        p.name: p.read_bytes() for p in (tmp_path / "two").iterdir()
    }
    assert any("MISSED" in line for line in printed_rows(content))
    first = write_first_page(tmp_path / "two").read_text()
    assert "2 of 3 criteria are met" in first
    assert "- entry | one: 0.05 deg (printed: 3.0052). r" in first
    with pytest.raises(ValueError, match="not measured: tilt"):
        write_system("B", Result({"rms": 0.05}), tmp_path / "three", seed=3)


@pytest.mark.parametrize("letter", SYSTEMS)
def test_every_printed_figure_is_judged_in_the_committed_files(letter: str) -> None:
    """The files hold today's entries, and every picture that is there is on the page."""
    content = json.loads((PAGES / f"{letter}.json").read_text())
    values: dict[str, list[float | None]] = {}
    for row in content["rows"]:
        values.setdefault(row["key"], []).append(row["measured"])
    source = system(letter)
    assert [*values] == [*source.entry]
    for key, entry in source.entry.items():
        measured = values[key] if len(values[key]) > 1 or entry.labels else values[key][0]
        notes = {row["key"]: row["note"] for row in content["rows"]}
        again = list(entry.rows(key, None if values[key][0] is None else measured, notes[key]))
        assert [row.plain() for row in again] == [row for row in content["rows"] if row["key"] == key]
        assert entry.reading
        assert entry.where or entry.printed is None
    text = (PAGES / f"{letter}.md").read_text()
    assert sorted(content["figures"]) == sorted(path.name for path in PAGES.glob(f"{letter}-*.png"))
    assert all(name in text for name in content["figures"])


def test_the_committed_first_page_is_made_of_the_committed_numbers() -> None:
    contents = [json.loads((PAGES / f"{letter}.json").read_text()) for letter in SYSTEMS]
    assert first_page(contents) == (PAGES / "README.md").read_text()
