"""The engine of suites, nights, studies and experiments: it makes items, stores each result, and resumes.

A :class:`Work` says how an item is made and where its result is stored. The engine reads the stored results, has the
rest made by processes of this machine or of a cluster, and yields every result as it comes. A failed item has its
failure as result. After an interruption the same call resumes.

The time left follows from the expected costs of the items, scaled by the ratio of measured to expected time. One-time
costs (compiling kernels, making a table) are counted separately.

A record is a JSON object in a file, written atomically. It is sealed and states the digest of its inputs and code, so
that outdated and altered results are recognised.
"""

from __future__ import annotations

import contextlib
import faulthandler
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

from horizonval.core import atomic, files
from horizonval.core.errors import UserError, one_line
from horizonval.core.progress import COMPILING, Progress, taken_s
from horizonval.jobs.cluster import run_on_cluster
from horizonval.jobs.pool import Execution, Results, run_in_processes
from horizonval.jobs.progress import Stopwatch
from horizonval.store.folder import intact_json, write_json

PRIOR_ITEMS = 0.1
"""Weight of the expected cost in the ratio of measured to expected time, in items."""
FEWEST_UNKNOWN = 3
"""Finished items before an estimate without expected times."""


@dataclass(frozen=True)
class ExpectedTime:
    """Expected time of an item.

    ``seconds``: without one-time costs. ``once``: one-time costs [s] by name, shared by all items.
    """

    seconds: float
    once: Mapping[str, float] = field(default_factory=dict)

    def __add__(self, other: ExpectedTime) -> ExpectedTime:
        """Return the time of two parts of one item."""
        return ExpectedTime(self.seconds + other.seconds, {**self.once, **other.once})


@dataclass(frozen=True)
class SpentTime:
    """Time that an item took: the total, and its one-time and compiling parts."""

    seconds: float
    once_s: float = 0.0
    compiling_s: float = 0.0


class Remaining:
    """Estimate of the time left.

    ``expected``: by item, or None. ``processes``: number in parallel; None if unknown, then the elapsed time counts.
    """

    def __init__(self, expected: Mapping[str, ExpectedTime | None], processes: int | None) -> None:
        known = [one.seconds for one in expected.values() if one is not None and one.seconds > 0]
        self._known = len(known) == len(expected)
        self._expected = {
            name: one if self._known and one is not None else ExpectedTime(1.0) for name, one in expected.items()
        }
        self._left = dict(self._expected)
        self._processes = processes
        self._mean = sum(known) / len(known) if self._known and known else 0.0
        self._net = self._pace = 0.0
        self._once_spent = self._once_expected = 0.0
        self._made: set[str] = set()
        self._finished, self._spent = 0, 0.0

    def done(self, name: str, spent: SpentTime) -> None:
        """Update the estimate with a finished item."""
        item = self._left.pop(name, None)
        if item is None:
            return
        self._finished += 1
        self._spent += spent.seconds
        self._net += max(spent.seconds - spent.once_s - spent.compiling_s, 0.0)
        self._pace += item.seconds
        self._once_spent += spent.once_s
        self._once_expected += sum(seconds for key, seconds in item.once.items() if key not in self._made)
        self._made |= set(item.once)

    def seconds(self, elapsed_s: float) -> float | None:
        """Return the seconds left, ``elapsed_s`` after the start; None if unknown."""
        if not self._left:
            return 0.0
        if self._finished < (1 if self._known else FEWEST_UNKNOWN):
            return None
        prior = PRIOR_ITEMS * self._mean
        pace = (self._net + prior) / (self._pace + prior)
        once: dict[str, float] = {}
        for item in self._left.values():
            once |= {key: seconds for key, seconds in item.once.items() if key not in self._made}
        # If others found one-time work done (on disk, from an earlier run), the rest will too.
        share = self._once_spent / self._once_expected if self._once_expected else 1.0
        longest = max(item.seconds for item in self._left.values())
        total = pace * sum(item.seconds for item in self._left.values()) + share * sum(once.values())
        at_once = self._spent / max(elapsed_s, 1e-9) if self._processes is None else self._processes
        return max(total / max(1.0, min(at_once, len(self._left))), pace * longest)


Record = dict[str, Any]


def keep(path: Path, identity: str, record: Mapping[str, Any], *, sort_keys: bool = True) -> None:
    """Write a record with its identity; ``sort_keys`` False preserves the order of keys."""
    atomic.make_folder(path.parent)
    write_json(path, {**record, "identity": identity}, indent=None, sort_keys=sort_keys)


def kept(path: Path, identity: str) -> Record | None:
    """Return a finished record of this identity; None for a missing, failed or damaged one (with a warning)."""
    record: Record | None = intact_json(path)
    if record is None or record.get("identity") != identity or record.get("error") is not None:
        return None
    return record


def take_over(source: Path, target: Path, rooms: Iterable[str], wanted: Callable[[Path], bool]) -> None:
    """Copy missing files below some sub-folders of another folder into ``target``.

    They are validated like the folder's own files later. Only regular files are copied, and none through a link out of
    ``target``.
    """
    for room in rooms:
        for path in sorted((source / room).rglob("*")):
            place = target / path.relative_to(source)
            if files.kind_at(path) != "a file" or not wanted(path) or files.kind_at(place):
                continue
            if files.is_inside(path, source / room) and files.is_inside(place, target / room):
                atomic.make_folder(place.parent)
                atomic.copy_file(path, place)


I = TypeVar("I")  # noqa: E741
R = TypeVar("R")
OnStart = Callable[[], Mapping[str, ExpectedTime] | None]


@dataclass(frozen=True)
class Done(Generic[R]):
    """Outcome of an item: ``result``, or None and ``error`` on one line.

    ``seconds``: by stage; empty for a stored result. ``spent``: total, for the estimate of the time left; None for a
    stored result.
    """

    result: R | None
    error: str | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    spent: SpentTime | None = field(default=None, compare=False)


class Work(ABC, Generic[I, R]):
    """Definition of how items of one kind are made and stored. Picklable: each item is sent with it."""

    renders: bool = True
    """Whether processes need a renderer."""
    folder: Path | None = None
    """Folder that the workers of a cluster must see."""

    @abstractmethod
    def name(self, item: I) -> str:
        """Return the unique name of an item."""

    @abstractmethod
    def finished(self, item: I) -> R | None:
        """Return the stored result of an item, or None."""

    @abstractmethod
    def make(self, item: I, watch: Stopwatch) -> R:
        """Make an item in another process, store its result, and return what the caller needs."""

    def group(self, item: I) -> Hashable:
        """Return the key of items with shared one-time costs: one process makes them in sequence."""
        return self.name(item)

    def limit_s(self, item: I) -> float | None:
        """Return the time limit of the process of an item, or None."""
        return None

    def lost(self, item: I, why: str) -> Done[R]:
        """Return the result of an item whose processes died repeatedly."""
        return Done(None, why)

    def parts(self, item: I, done: Done[R] | None) -> Mapping[str, str | None]:
        """Return the parts that count as finished with an item, and why each failed."""
        return {self.name(item): None if done is None else done.error}


class Recorded(Work[I, Record]):
    """Work with a record file for each result."""

    sort_keys: bool = True
    """Whether the keys of a record are sorted; otherwise their order is part of the result."""

    @abstractmethod
    def path(self, item: I) -> Path:
        """Return the file of an item's record."""

    @abstractmethod
    def identity(self, item: I) -> str:
        """Return the digest of everything that an item's result depends on, its code included."""

    @abstractmethod
    def record(self, item: I, watch: Stopwatch) -> Record:
        """Make an item and return its record: plain data."""

    def finished(self, item: I) -> Record | None:
        """Return the stored record of an item."""
        return kept(self.path(item), self.identity(item))

    def make(self, item: I, watch: Stopwatch) -> Record:
        """Make and store a record, and read it back: a result must not depend on what was in memory."""
        keep(self.path(item), self.identity(item), self.record(item, watch), sort_keys=self.sort_keys)
        record = self.finished(item)
        if record is None:
            raise OSError(f"{self.path(item).name} cannot be read back")
        return record


def stream(
    work: Work[I, R],
    items: Iterable[I],
    execution: Execution,
    progress: Progress,
    *,
    unit: str = "",
    what: str = "",
    on_start: OnStart | None = None,
) -> Iterator[tuple[I, Done[R]]]:
    """Yield every item with its outcome: stored ones first, then the others as they finish.

    Closing the generator ends the workers at once; only unfinished items are lost.

    Parameters
    ----------
    items : iterable
        Picklable; all of them, whatever the shard.
    unit, what : str
        For the display: what is counted, and of what.
    on_start : callable, optional
        Called once when workers are available for missing items. May return the expected times of the items' parts by
        name.

    Raises
    ------
    UserError
        No back-end on this machine, or the cluster cannot do the work.
    """
    ready: list[tuple[I, Done[R]]] = []
    missing: list[I] = []
    for item in execution.share(list(items)):
        result = work.finished(item)
        if result is None:
            missing.append(item)
        else:
            ready.append((item, Done(result)))
    left, there = (sum(len(work.parts(item, None)) for item in some) for some in (missing, [item for item, _ in ready]))
    progress.start(left + there, there, unit=unit, what=what)
    yield from ready
    if not missing:
        return
    clock = _Clock(work, missing, execution, on_start)
    with contextlib.closing(_run(work, missing, execution, clock.start)) as results:
        for item, made in results:
            done = work.lost(item, _died(work, item)) if made is None else made
            progress.left(clock.left_s(item, done))
            for name, error in work.parts(item, done).items():
                progress.done(name, failed=error)
            yield item, done


def do(
    work: Work[I, R],
    items: Sequence[I],
    execution: Execution,
    progress: Progress,
    *,
    unit: str = "",
    what: str = "",
) -> dict[str, Done[R]]:
    """Return the outcome of every item by name, in the items' order; otherwise as :func:`stream`."""
    done = {work.name(item): one for item, one in stream(work, items, execution, progress, unit=unit, what=what)}
    return {name: done[name] for item in items if (name := work.name(item)) in done}


def _run(
    work: Work[I, R], items: Sequence[I], execution: Execution, on_start: Callable[[], None]
) -> Results[I, Done[R] | None, None]:
    function = partial(_safely, work)
    if execution.dask is not None:
        return run_on_cluster(
            function, items, execution.dask, work.folder or Path(), renderer=work.renders, on_start=on_start
        )
    if work.renders:
        from horizonval.renderer.backend import probe

        if probe().chosen is None:
            raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    on_start()
    return run_in_processes(function, items, execution.processes, renderer=work.renders, group=work.group)


class _Clock(Generic[I, R]):
    """Estimates the time left for the missing items."""

    def __init__(self, work: Work[I, R], missing: Sequence[I], execution: Execution, on_start: OnStart | None) -> None:
        self._work, self._missing, self._on_start = work, missing, on_start
        self._processes = execution.processes if execution.dask is None else None
        self._remaining = Remaining({}, 1)
        self._begin = 0.0

    def start(self) -> None:
        """Start with the expected times."""
        stated = (self._on_start() if self._on_start is not None else None) or {}
        expected: dict[str, ExpectedTime | None] = {}
        for item in self._missing:
            parts = [stated.get(name) for name in self._work.parts(item, None)]
            known = [part for part in parts if part is not None]
            whole = sum(known[1:], known[0]) if known and len(known) == len(parts) else None
            expected[self._work.name(item)] = whole
        self._remaining = Remaining(expected, self._processes)
        self._begin = time.monotonic()

    def left_s(self, item: I, done: Done[R]) -> float | None:
        """Return the seconds left after an item."""
        self._remaining.done(self._work.name(item), done.spent or SpentTime(0.0))
        return self._remaining.seconds(time.monotonic() - self._begin)


def _safely(work: Work[I, R], item: I) -> Done[R]:
    from horizonval.renderer.backend import compiling_counted

    start = time.perf_counter()
    taken_s()
    with compiling_counted() if work.renders else contextlib.nullcontext():
        done = _made(work, item)
    counted = taken_s()
    compiling_s = counted.pop(COMPILING, 0.0)
    return replace(done, spent=SpentTime(time.perf_counter() - start, sum(counted.values()), compiling_s))


def _made(work: Work[I, R], item: I) -> Done[R]:
    watch = Stopwatch()
    try:
        with _ended_after(work.limit_s(item)):
            result = work.make(item, watch)
    except Exception as e:
        return Done(None, one_line(e), watch.rounded())
    return Done(result, None, watch.rounded())


def _died(work: Work[I, R], item: I) -> str:
    limit_s = work.limit_s(item)
    longer = "" if limit_s is None else f", or more than {limit_s:g} s"
    return f"the worker process died (out of memory, {'' if longer else 'or '}a crash{longer})"


@contextlib.contextmanager
def _ended_after(limit_s: float | None) -> Iterator[None]:
    """End this process after a time, even inside blocking foreign code."""
    if limit_s is None:
        yield
        return
    with open(os.devnull, "w") as nowhere:
        faulthandler.dump_traceback_later(limit_s, exit=True, file=nowhere)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()
