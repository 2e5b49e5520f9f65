"""Workers: results whatever their number; a killed worker costs one case; none outlives the run."""

from __future__ import annotations

import os
import signal
import threading
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from horizonval.jobs.pool import run_in_processes


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
