"""Items of a group go to one worker, one after another; nobody is idle beside a long group."""

from __future__ import annotations

import itertools
import os
import random
from functools import partial
from pathlib import Path

from horizonval.jobs.pool import Turns, run_in_processes


def _group(item: str) -> str:
    return item[0]


def _all_by(turns: Turns[str], order: list[int]) -> dict[int, list[str]]:
    taken: dict[int, list[str]] = {worker: [] for worker in sorted(set(order))}
    for worker in itertools.cycle(order):
        item = turns.take(worker)
        if item is not None:
            taken[worker].append(item)
        elif not len(turns):
            return taken
    raise AssertionError


def test_alone_a_worker_takes_group_after_group_in_the_order_of_their_first_items():
    assert _all_by(Turns(["b1", "a1", "b2", "c1", "a2"], _group), [0]) == {0: ["b1", "b2", "a1", "a2", "c1"]}


def test_every_group_goes_to_one_worker_while_there_are_others():
    items = [f"{letter}{number}" for number in range(3) for letter in "abcd"]
    taken = _all_by(Turns(items, _group), [0, 1])
    assert taken == {0: ["a0", "a1", "a2", "c0", "c1", "c2"], 1: ["b0", "b1", "b2", "d0", "d1", "d2"]}


def test_the_last_item_of_a_group_stays_with_its_worker():
    turns = Turns(["a1", "a2"], _group)
    assert (turns.take(0), turns.take(1), turns.take(0)) == ("a1", None, "a2")


def test_nothing_is_lost_or_taken_twice():
    for seed in range(50):
        draw = random.Random(seed)
        items = [f"{draw.choice('abc')}{number}" for number in range(draw.randrange(30))]
        taken = _all_by(Turns(items, _group), [draw.randrange(3) for _ in range(20)] + [0])
        assert sorted(itertools.chain(*taken.values())) == sorted(items)


def test_what_is_put_back_or_left_by_a_worker_comes_first():
    turns = Turns(["a1", "a2", "b1", "c1"], _group)
    turns.put_back(0, str(turns.take(0)))
    turns.take(1)
    assert turns.take(0) == "a1"
    turns.release()
    assert len(turns) == 2
    assert _all_by(turns, [7]) == {7: ["a2", "c1"]}


def _process(item: str, folder: Path) -> int:
    if item == "a1" and not (folder / "died").exists():
        (folder / "died").touch()
        os._exit(1)
    return os.getpid()


def test_a_group_is_made_in_one_process(tmp_path: Path):
    (tmp_path / "died").touch()
    items = [f"{letter}{number}" for number in range(2) for letter in "abcdef"]
    made = dict(run_in_processes(partial(_process, folder=tmp_path), items, 2, renderer=False, group=_group))
    assert sorted(made) == sorted(items)
    assert all(made[f"{letter}0"] == made[f"{letter}1"] for letter in "abcdef")


def test_a_worker_that_dies_costs_nothing_of_its_group(tmp_path: Path):
    items = [f"{letter}{number}" for number in range(3) for letter in "ab"]
    made = dict(run_in_processes(partial(_process, folder=tmp_path), items, 2, renderer=False, group=_group))
    assert sorted(made) == sorted(items)
    assert None not in made.values()
