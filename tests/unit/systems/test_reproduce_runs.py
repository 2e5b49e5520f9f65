"""Runs of the experiments: letters, cached tasks, folders."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.store.folder import write_json
from horizonval.systems import run as run_module
from horizonval.systems.quick import SYSTEMS, chosen, experiment
from horizonval.systems.task_cache import TaskCache, rng_of


def test_letters_are_chosen_in_any_case_and_every_system_has_its_experiment() -> None:
    assert chosen([]) == list(SYSTEMS)
    assert chosen(["d", "A"]) == ["A", "D"]
    with pytest.raises(UserError, match="'X'"):
        chosen(["X"])
    modules = [experiment(letter) for letter in SYSTEMS]
    assert all(callable(one.reproduce) and callable(one.quick) for one in modules)


def test_random_numbers_belong_to_seed_and_names() -> None:
    draws = [rng_of(*who).standard_normal() for who in ((0, "a"), (1, "a"), (0, "b"), (0, "a", "b"))]
    assert len(set(draws)) == 4
    assert rng_of(0, "a").standard_normal() == draws[0]


def _ordered(item: JsonObject) -> JsonObject:
    return {"b": 1, "a": 2}


def _square(item: JsonObject) -> JsonObject:
    if item["x"] == 13:
        raise ValueError("thirteen")
    with Path(item["log"]).open("a") as log:
        log.write("x")
    return {"square": item["x"] ** 2}


@pytest.mark.slow
def test_what_is_done_is_kept_when_another_item_fails(tmp_path: Path) -> None:
    log = tmp_path / "log"
    items: dict[str, JsonObject] = {str(x): {"x": x, "log": str(log)} for x in (2, 13, 3)}
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


def test_a_foreign_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(UserError, match="is not empty"):
        next(run_module.reproduce_systems(["C"], tmp_path))


def _written(letter: str, result: object, folder: Path, seed: int) -> dict[str, Any]:
    content = {"system": letter, "title": "a method", "source": "somebody", "rows": [], "seed": seed}
    write_json(folder / f"{letter}.json", content, bound=False)
    return content


def test_a_second_run_in_the_same_folder_is_refused_and_leftovers_of_a_killed_one_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_module, "experiment", lambda letter: SimpleNamespace(reproduce=lambda cache: None))
    monkeypatch.setattr(run_module, "write_system", _written)
    monkeypatch.setattr(run_module, "write_quick", lambda *_: None)
    out = tmp_path / "pages"
    left = out / run_module.WORK / "ab" / ".abc.json.1.tmp"
    left.parent.mkdir(parents=True)
    left.write_text("{")
    first: Any = run_module.reproduce_systems(["B"], out)
    assert next(first)["system"] == "B"
    assert not left.exists()
    with pytest.raises(UserError, match="another run"):
        next(run_module.reproduce_systems(["B"], out))
    first.close()
    assert [one["seed"] for one in run_module.reproduce_systems(["B"], out, seed=7)] == [7]
    assert "Seed 7" in (out / "README.md").read_text()
