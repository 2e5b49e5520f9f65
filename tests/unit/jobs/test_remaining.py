"""The time left is told from what was expected and measured, not from a mean over the first items."""

from __future__ import annotations

import heapq
import time

import numpy as np
import pytest

from horizonval.core import progress
from horizonval.jobs.engine import ExpectedTime, Remaining, SpentTime
from horizonval.renderer.backend import compiling_counted

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
