"""The engine: kept results, resumed work, and the time left."""

from __future__ import annotations

import heapq
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from horizonval.core import progress
from horizonval.core.progress import Silent
from horizonval.jobs import engine
from horizonval.jobs.engine import ExpectedTime, Record, Recorded, Remaining, SpentTime, do, stream
from horizonval.jobs.pool import Execution
from horizonval.jobs.progress import Stopwatch
from horizonval.renderer.backend import compiling_counted


class Squares(Recorded[int]):
    """Squares of numbers; 13 is a mistake, 17 kills its process, 19 takes for ever."""

    renders = False

    def __init__(self, folder: Path, code: str = "now") -> None:
        self.place, self.code = folder, code

    def name(self, item: int) -> str:
        return str(item)

    def path(self, item: int) -> Path:
        return self.place / f"{item}.json"

    def identity(self, item: int) -> str:
        return f"{item} {self.code}"

    def limit_s(self, item: int) -> float | None:
        return 1.0 if item == 19 else None

    def record(self, item: int, watch: Stopwatch) -> Record:
        with watch.stage("square"), (self.place / "made").open("a") as file:
            file.write(f"{item}\n")
        if item == 13:
            raise ValueError("bad\nluck")
        if item == 17:
            os.kill(os.getpid(), signal.SIGKILL)
        while item == 19:
            pass
        return {"square": item * item}


class Telling(Silent):
    def __init__(self) -> None:
        self.begun: list[tuple[int, int, str, str]] = []
        self.ended: dict[str, str | None] = {}

    def start(self, total: int, kept: int, *, unit: str = "", what: str = "") -> None:
        self.begun.append((total, kept, unit, what))

    def done(self, name: str, *, failed: str | None = None) -> None:
        self.ended[name] = failed


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Items are made in this process."""
    monkeypatch.setattr(engine, "run_in_processes", lambda work, items, *_, **__: ((one, work(one)) for one in items))


def made(folder: Path) -> list[int]:
    path = folder / "made"
    return [int(line) for line in path.read_text().split()] if path.exists() else []


@pytest.mark.usefixtures("here")
def test_what_is_kept_is_not_made_again(tmp_path: Path) -> None:
    first = do(Squares(tmp_path), [3, 1], Execution(1), Silent())
    assert {name: one.result["square"] for name, one in first.items() if one.result} == {"3": 9, "1": 1}
    assert all(set(one.seconds) == {"square"} for one in first.values())
    told = Telling()
    again = do(Squares(tmp_path), [2, 3, 1], Execution(1), told, unit="squares", what="arithmetic")
    assert list(again) == ["2", "3", "1"], "in the items' order"
    assert [dict(again[name].seconds) for name in ("3", "1")] == [{}, {}]
    assert (told.begun, told.ended) == ([(3, 2, "squares", "arithmetic")], {"2": None})
    assert sorted(made(tmp_path)) == [1, 2, 3]


@pytest.mark.usefixtures("here")
def test_other_code_or_damage_makes_it_again(tmp_path: Path) -> None:
    do(Squares(tmp_path), [3, 4], Execution(1), Silent())
    (tmp_path / "4.json").write_text('{"square": 1')
    do(Squares(tmp_path), [3, 4], Execution(1), Silent())
    assert made(tmp_path) == [3, 4, 4]
    do(Squares(tmp_path, "later"), [3, 4], Execution(1), Silent())
    assert made(tmp_path) == [3, 4, 4, 3, 4]


def test_what_goes_wrong_is_the_items_own_result(tmp_path: Path) -> None:
    told = Telling()
    done = do(Squares(tmp_path), [13, 2, 17, 19], Execution(2), told)
    assert done["2"].result == {"square": 4, "identity": "2 now"}
    assert str(done["13"].error).startswith("ValueError at test_engine.py:")
    assert str(done["13"].error).endswith(": bad luck")
    assert done["17"].error == "the worker process died (out of memory, or a crash)"
    assert done["19"].error == "the worker process died (out of memory, a crash, or more than 1 s)"
    assert told.ended == {name: one.error for name, one in done.items()}
    # What has no result is tried again.
    assert do(Squares(tmp_path), [13], Execution(1), Silent())["13"].error is not None


class Left(Telling):
    def __init__(self) -> None:
        super().__init__()
        self.seconds: list[float | None] = []

    def left(self, seconds: float | None) -> None:
        self.seconds.append(seconds)


@pytest.mark.usefixtures("here")
def test_the_time_left_comes_from_what_was_expected(tmp_path: Path) -> None:
    """The dear item is left: a mean over the cheap ones would say next to nothing."""
    told = Left()
    expected = {"1": ExpectedTime(1.0), "2": ExpectedTime(1.0), "3": ExpectedTime(1000.0)}
    list(stream(Squares(tmp_path), [1, 2, 3], Execution(1), told, on_start=lambda: expected))
    assert len(told.seconds) == 3
    assert told.seconds[-1] == 0.0
    assert told.seconds[1] is not None
    assert told.seconds[1] > 100.0


PROCESSES = 2


def simulated(
    expected: list[ExpectedTime], pace: float, rng: np.random.Generator, cached: bool
) -> list[tuple[float, str, SpentTime]]:
    """Return when every item ends, its name and what it took, on two processes that take items in order."""
    free = [(0.0, process) for process in range(PROCESSES)]
    fresh, made, ends = {0, 1}, set(), []
    for number, item in enumerate(expected):
        begin, process = heapq.heappop(free)
        once_s = 0.0 if cached else sum(s for key, s in item.once.items() if key not in made)
        made |= set(item.once)
        compiling = rng.uniform(1, 7) if process in fresh else 0.0
        seconds = pace * (item.seconds * rng.uniform(0.8, 1.3) + once_s) + compiling
        ends.append((begin + seconds, str(number), SpentTime(seconds, pace * once_s, compiling)))
        fresh.discard(process)
        heapq.heappush(free, (begin + seconds, process))
    return sorted(ends)


def told_after(
    count: int, expected: list[ExpectedTime], ends: list[tuple[float, str, SpentTime]]
) -> tuple[float, float]:
    """Return what is told after some items, and the truth."""
    remaining = Remaining({str(i): item for i, item in enumerate(expected)}, PROCESSES)
    for _, name, spent in ends[:count]:
        remaining.done(name, spent)
    told = remaining.seconds(ends[count - 1][0])
    assert told is not None
    return told, ends[-1][0] - ends[count - 1][0]


@pytest.mark.parametrize("cached", [False, True])
@pytest.mark.parametrize("pace", [0.7, 1.0, 3.0])
@pytest.mark.parametrize("order", ["cheap first", "dear first", "mixed"])
def test_after_2_of_26_the_rest_is_known_to_a_factor_of_two(order, pace, cached):
    """Frames of 2 to 30 s, tables of 10 s made once; a mean over the first two is off by up to a factor of eight."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        costs = np.sort(rng.uniform(2, 30, 26))
        costs = {"cheap first": costs, "dear first": costs[::-1], "mixed": rng.permutation(costs)}[order]
        expected = [ExpectedTime(float(c), {f"air {i % 3}": 10.0} if i % 2 else {}) for i, c in enumerate(costs)]
        told, true = told_after(2, expected, simulated(expected, pace, rng, cached))
        assert 0.5 < told / true < 2.0, (told, true)


def test_without_a_basis_there_is_no_figure():
    known = Remaining({"a": ExpectedTime(2.0), "b": ExpectedTime(2.0)}, 1)
    assert known.seconds(0.0) is None
    known.done("a", SpentTime(2.0))
    assert known.seconds(2.0) == pytest.approx(2.0)
    known.done("b", SpentTime(2.0))
    assert known.seconds(4.0) == 0.0
    unknown = Remaining(dict.fromkeys("abcdefgh"), None)
    for count, name in enumerate("abcde", 1):
        unknown.done(name, SpentTime(4.0))
        left = unknown.seconds(2.0 * count)
        assert (left is None) == (count < 3)
    # Two at a time, as the seconds that were spent while one passed tell.
    assert left == pytest.approx(3 * 4.0 / 2)


def test_what_is_made_once_is_counted(monkeypatch):
    times = iter([0.0, 5.0, 10.0, 12.0])
    monkeypatch.setattr(progress.time, "perf_counter", lambda: next(times))
    progress.taken_s()
    for _ in range(2):
        with progress.made_once("tables"):
            pass
    assert (progress.taken_s(), progress.taken_s()) == ({"tables": 7.0}, {})


def test_compiling_of_a_kernel_is_counted():
    import drjit
    import mitsuba

    mitsuba.set_variant("llvm_ad_mono")
    progress.taken_s()
    with compiling_counted():
        # Numbers that no kernel on the disk knows.
        drjit.eval(mitsuba.Float64([1.0, 2.0]) * time.time())
    assert progress.taken_s()[progress.COMPILING] > 0.0
    assert not drjit.flag(drjit.JitFlag.KernelHistory)
