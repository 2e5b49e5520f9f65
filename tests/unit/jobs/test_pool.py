"""Worker processes: crashes, turns, shares and signs of life."""

from __future__ import annotations

import itertools
import os
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from horizonval.jobs.pool import Execution, Turns, hush, parse_shard, run_in_processes, sign_of_life
from horizonval.jobs.progress import Terminal


@dataclass(frozen=True)
class Named:
    """The pool only hands cases through; names are all these tests need."""

    name: str


def _work(case: Named, folder: Path) -> str:
    with (folder / case.name).open("a") as file:
        file.write("x")
    if case.name == "deadly":
        os.kill(os.getpid(), signal.SIGKILL)
    if case.name == "once" and (folder / "once").stat().st_size == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if case.name == "slow":
        (folder / "pid").write_text(str(os.getpid()))
        time.sleep(60)
    return case.name.upper()


def _results(folder: Path, names: list[str]) -> dict[str, str | None]:
    return {case.name: result for case, result in run_in_processes(partial(_work, folder=folder), map(Named, names), 2)}


def test_a_killed_worker_costs_only_its_case(tmp_path):
    assert _results(tmp_path, ["a", "deadly", "b", "c"]) == {"a": "A", "b": "B", "c": "C", "deadly": None}


def test_a_case_whose_worker_died_gets_a_second_chance(tmp_path):
    assert _results(tmp_path, ["once", "a", "b"]) == {"once": "ONCE", "a": "A", "b": "B"}


def test_closing_ends_the_workers(tmp_path):
    threads = set(threading.enumerate())
    running = run_in_processes(partial(_work, folder=tmp_path), map(Named, ["a", "slow"]), 2)
    assert next(running)[1] == "A"
    deadline = time.monotonic() + 30
    while not (tmp_path / "pid").exists() or not (tmp_path / "pid").read_text():
        assert time.monotonic() < deadline
        time.sleep(0.05)
    running.close()
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
    # One that closes while the interpreter ends prints a traceback on Ctrl-C.
    assert set(threading.enumerate()) <= threads, "no thread of a pool is left"


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


def test_every_group_goes_to_one_worker_while_there_are_others():
    items = [f"{letter}{number}" for number in range(3) for letter in "abcd"]
    taken = _all_by(Turns(items, _group), [0, 1])
    assert taken == {0: ["a0", "a1", "a2", "c0", "c1", "c2"], 1: ["b0", "b1", "b2", "d0", "d1", "d2"]}


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


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("count", [0, 1, 4, 7, 16])
def test_every_item_belongs_to_one_shard_and_shards_are_even(n: int, count: int) -> None:
    items = [f"item {k}" for k in range(count)]
    shares = [Execution(shard=parse_shard(f"{i}/{n}")).share(items) for i in range(1, n + 1)]
    assert sorted(item for share in shares for item in share) == sorted(items), "each once, none left out"
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    assert all(share == sorted(share, key=items.index) for share in shares), "in the items' order"
    assert Execution().share(items) == items


def test_the_first_shard_has_the_first_item() -> None:
    assert [Execution(shard=(i, 3)).share("abc") for i in (1, 2, 3)] == [["a"], ["b"], ["c"]]


SLOW = """
import sys, time
from horizonval.cli import app
app.run_command_line = lambda arguments: time.sleep(20)
sys.argv = ["horizonval", "archive", "verify", "out"]
app.main()
"""


def test_a_line_comes_while_a_command_still_loads():
    """Long before the command has done anything, from the program itself."""
    with subprocess.Popen([sys.executable, "-c", SLOW], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert process.stderr.readline() == "horizonval: archive verify is getting ready\n"
        assert process.poll() is None
        process.kill()


@pytest.mark.parametrize("hushed", [False, True])
def test_who_has_said_something_needs_no_sign(capsys, hushed):
    with sign_of_life("here", 0.05):
        if hushed:
            hush()
        time.sleep(0.3)
    assert capsys.readouterr().err == ("" if hushed else "here\n")


def test_progress_is_a_sign_of_life(capsys):
    with Terminal("work", "frames") as terminal, sign_of_life("here", 0.5):
        terminal.start(3, 0)
        time.sleep(0.8)
        terminal.left(400.0)
        terminal.done("first")
    first, second = capsys.readouterr().err.splitlines()
    assert first == "work: 3 frames"
    assert second.startswith("[1/3] first")
    assert second.endswith("about 7 min left")
