"""Rows, pages and kept work of the reproductions."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from matplotlib.figure import Figure as MplFigure

from horizonval.core.errors import UserError
from horizonval.store.folder import read_json
from horizonval.systems import run as run_module
from horizonval.systems.pages import printed_rows, write_first_page, write_reproduction
from horizonval.systems.quick import SYSTEMS, chosen, experiment
from horizonval.systems.result import ComparisonRow, Figure, Reproduction, Table
from horizonval.systems.task_cache import TaskCache, rng_of


def _draw() -> MplFigure:
    figure = MplFigure(figsize=(2, 1))
    figure.subplots().plot([0, 1], [0, 1])
    return figure


def _result(measured: float = 0.03) -> Reproduction:
    return Reproduction(
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
        figures=(Figure("map", "A map. More of it", _draw),),
    )


def test_a_bar_counts_departure_from_zero_from_a_figure_or_from_below():
    held = [row.holds for row in _result().rows]
    assert held == [True, True, True, None]
    assert ComparisonRow("x", 1.0, 1.08, "deg", "", limit=0.0708, against=1.0).holds is False
    assert ComparisonRow("x", 1.0, -25.0, "deg", "", limit=20.0, at_least=True).holds is False


def test_json_and_page_say_the_same(tmp_path):
    content = write_reproduction(_result(), tmp_path, seed=3)
    assert read_json(tmp_path / "B.json", bound=False) == content
    row = content["rows"][1]
    assert (row["published"], row["measured"], row["unit"], row["why"]) == (1.0, 1.05, "deg", "quantised")
    page = (tmp_path / "B.md").read_text()
    assert "entry \\| one" in page
    assert "(B-map.png)" in page
    assert (tmp_path / "B-map.png").read_bytes().startswith(b"\x89PNG")
    assert "4" in write_first_page(tmp_path).read_text()
    assert any("MISSED" in line for line in printed_rows(write_reproduction(_result(0.05), tmp_path, seed=3)))
    assert "Missed" in write_first_page(tmp_path).read_text()


def test_the_same_result_gives_the_same_bytes(tmp_path):
    for name in ("one", "two"):
        write_reproduction(_result(), tmp_path / name, seed=3)
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes()


def test_a_figure_that_is_no_number_is_a_defect(tmp_path):
    with pytest.raises(ValueError, match="rms"):
        write_reproduction(_result(math.nan), tmp_path, seed=0)


def test_letters_are_chosen_in_any_case_and_unknown_ones_named():
    assert chosen([]) == list(SYSTEMS)
    assert chosen(["d", "A"]) == ["A", "D"]
    with pytest.raises(UserError, match="'X'"):
        chosen(["X"])


@pytest.mark.parametrize("letter", SYSTEMS)
def test_every_system_has_its_experiment(letter):
    assert callable(experiment(letter))


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
    with pytest.raises(UserError, match="something else"):
        next(run_module.reproduce_systems(["C"], tmp_path))


def test_a_second_run_in_the_same_folder_is_refused_and_leftovers_of_a_killed_one_go(tmp_path, monkeypatch):
    monkeypatch.setattr(run_module, "experiment", lambda letter: lambda cache: _result())
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


def test_published_figures_keep_the_digits_of_their_source(tmp_path):
    row = ComparisonRow("roll", 3.0052, 2.96985, "deg", "a step less", limit=0.0708, against=3.0052)
    content = write_reproduction(replace(_result(), rows=(row,)), tmp_path, seed=0)
    assert "| roll | 3.0052 | 2.97 | deg | at most 0.0708 from 3.0052: met |" in (tmp_path / "B.md").read_text()
    assert any("3.0052" in line for line in printed_rows(content))


def test_a_long_name_does_not_push_the_figures_out_of_their_columns(tmp_path):
    rows = (ComparisonRow("short", 1.0, 1.0, "deg", ""), ComparisonRow("long " * 20, 1.0, 1.0, "deg", ""))
    lines = list(printed_rows(write_reproduction(replace(_result(), rows=rows), tmp_path, seed=0)))
    assert len({len(line) for line in lines if line.endswith("deg")}) == 1


def test_pictures_have_a_text_that_brackets_do_not_end(tmp_path):
    figure = Figure("map", "A map [deg]. More", _draw)
    write_reproduction(replace(_result(), figures=(figure,)), tmp_path, seed=0)
    assert "![A map (deg)](B-map.png)" in (tmp_path / "B.md").read_text()
