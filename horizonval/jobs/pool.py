"""Worker processes that may be killed, may crash, and never outlive the run.

Items go to spawned processes one at a time. When a worker dies (out of memory, a crash inside a library) the others
finish their items; the items of dead workers are then tried once more, each alone, and only one that kills its worker
again is given up.

**Groups.** Items of a group go to one worker, which keeps their shared data in memory. An idle worker takes over the
later half of the longest group. Results do not depend on it.

**Sign of life.** A command that loads for a while prints one line on standard error; :func:`hush` suppresses it.
"""

from __future__ import annotations

import contextlib
import importlib.util
import multiprocessing
import os
import re
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Generic, TypeAlias, TypeVar

from horizonval.core.errors import UserError

AFTER_S = 0.7
"""Delay of the sign of life [s]; with up to 0.5 s for the interpreter's start it comes within 2 s."""

_hushed = threading.Event()


@contextmanager
def sign_of_life(line: str, after_s: float = AFTER_S) -> Iterator[None]:
    """Write a line to standard error if the work inside takes too long without :func:`hush`."""
    _hushed.clear()

    def tell() -> None:
        if not _hushed.wait(after_s):
            sys.stderr.write(line + "\n")
            sys.stderr.flush()

    threading.Thread(target=tell, daemon=True).start()
    try:
        yield
    finally:
        hush()


def hush() -> None:
    """Suppress the sign of life, because there is other output."""
    _hushed.set()


I = TypeVar("I")  # noqa: E741


class Turns(Generic[I]):
    """Queue of items, by ``group``; by default every item is a separate group."""

    def __init__(self, items: Iterable[I], group: Callable[[I], Hashable] | None = None) -> None:
        groups: dict[Hashable, deque[I]] = {}
        for number, item in enumerate(items):
            groups.setdefault(number if group is None else group(item), deque()).append(item)
        self._groups = deque(groups.values())
        self._begun: dict[int, deque[I]] = {}

    def __len__(self) -> int:
        return sum(map(len, (*self._groups, *self._begun.values())))

    def take(self, worker: int) -> I | None:
        """Return a worker's next item, or None."""
        if not self._begun.get(worker):
            self._begun[worker] = self._groups.popleft() if self._groups else self._half_of_the_longest()
        turns = self._begun[worker]
        return turns.popleft() if turns else None

    def put_back(self, worker: int, item: I) -> None:
        """Return an item to the queue that a worker did not start."""
        self._begun[worker].appendleft(item)

    def release(self) -> None:
        """Release the groups of dead workers."""
        self._groups.extendleft(turns for _, turns in sorted(self._begun.items(), reverse=True) if turns)
        self._begun = {}

    def _half_of_the_longest(self) -> deque[I]:
        longest = max(self._begun.values(), key=len, default=deque())
        half: deque[I] = deque()
        for _ in range(len(longest) // 2):
            half.appendleft(longest.pop())
        return half


MOST_WORKERS = 4096
MOST_SHARDS = 1_000_000
"""Maximum number of shards, equal to that of a suite's frames."""


@dataclass(frozen=True)
class Execution:
    """Where the work is done; results do not depend on it.

    Raises ``UserError``: an invalid number of processes or address, or Dask is not installed.

    Attributes
    ----------
    workers : int, optional
        Processes on this machine; one per processor by default.
    shard : (int, int), optional
        (i, n): only every n-th item, from the i-th on. Shards can share a folder, also at the same time.
    dask : str, optional
        Address of a Dask scheduler, or ``local:N``; its workers must see the run's folder.
    merge : tuple of Path
        Folders of other runs of the same suite, whose results are copied.
    """

    workers: int | None = None
    shard: tuple[int, int] | None = None
    dask: str | None = None
    merge: tuple[Path, ...] = field(default=())

    def __post_init__(self) -> None:
        if self.workers is not None and not 1 <= self.workers <= MOST_WORKERS:
            raise UserError(
                f"found {self.workers}", where="--workers", expected=f"a whole number from 1 to {MOST_WORKERS}"
            )
        if self.dask is not None:
            local_workers(self.dask)
            if importlib.util.find_spec("distributed") is None:
                raise UserError(
                    "Dask is not installed",
                    where="--dask",
                    fix="pip install 'horizonval[cluster]', or leave --dask out",
                )

    @property
    def processes(self) -> int:
        """Number of processes on this machine."""
        return self.workers or available_cpus()

    def share(self, items: Sequence[I]) -> list[I]:
        """Return the items of this shard, or all."""
        return list(items) if self.shard is None else list(items[self.shard[0] - 1 :: self.shard[1]])


def available_cpus() -> int:
    """Return the number of usable processors: affinity and a container's CPU quota."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError), open("/sys/fs/cgroup/cpu.max") as file:
        quota, period = file.read().split()
        cpus = min(cpus, max(1, round(int(quota) / int(period))))
    return cpus


def local_workers(address: str) -> int | None:
    """Return N of ``local:N``, None for the address of a scheduler. Raises ``UserError``: an invalid N."""
    local, _, count = address.partition(":")
    if local != "local":
        return None
    if not re.fullmatch("[0-9]{1,5}", count) or not 1 <= int(count) <= MOST_WORKERS:
        expected = f"local:N with N from 1 to {MOST_WORKERS}, or an address"
        raise UserError(f"found {address[:80]!r}", where="--dask", expected=expected)
    return int(count)


def parse_shard(text: str) -> tuple[int, int]:
    """Return (i, n) of ``"i/n"``. Raises ``UserError`` unless they are integers with 1 <= i <= n."""
    match = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text)
    if match and 1 <= int(match[1]) <= int(match[2]) <= MOST_SHARDS:
        return int(match[1]), int(match[2])
    expected = f"i/n with i from 1 to n, such as 2/8, and n of at most {MOST_SHARDS}"
    raise UserError(f"found {text[:40]!r}", where="--shard", expected=expected)


T = TypeVar("T")
R = TypeVar("R")
Results: TypeAlias = Generator[tuple[I, T], None, R]

_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Linear algebra on one thread: the order of its sums, hence its last bit, must not depend on the machine."""


def run_in_processes(
    work: Callable[[I], T],
    items: Iterable[I],
    workers: int,
    *,
    renderer: bool = True,
    group: Callable[[I], Hashable] | None = None,
) -> Results[I, T | None, None]:
    """Yield every item with its result as it finishes; ``None`` for one that killed its worker.

    ``work``: picklable; must not raise. ``workers``: processes, among which the processors are shared. ``renderer``:
    whether they get a renderer. ``group``: key of the items that go to one worker. Closing the generator (or Ctrl-C)
    ends the workers at once; only unfinished items are lost.
    """
    waiting = Turns(items, group)
    while len(waiting):
        suspects = yield from _drain(work, waiting, workers, renderer)
        for item in suspects:
            if (yield from _drain(work, Turns([item]), 1, renderer)):
                yield item, None


def _drain(work: Callable[[I], T], waiting: Turns[I], workers: int, renderer: bool) -> Results[I, T, list[I]]:
    """Process items until none waits or a worker dies; return those whose workers died."""
    workers = max(1, min(workers, len(waiting)))
    threads = max(1, available_cpus() // workers)
    others = set(multiprocessing.active_children())
    # A pool for every worker: a common one would give an item to any.
    pools = [
        ProcessPoolExecutor(
            1,
            mp_context=multiprocessing.get_context("spawn"),
            initializer=_start_worker,
            initargs=(threads, renderer),
        )
        for _ in range(workers)
    ]
    idle = set(range(workers))
    under_way: dict[Future[T], tuple[int, I]] = {}
    suspects: list[I] = []
    broken = False
    try:
        while True:
            with _inherited_by_children():
                for worker in sorted(idle) if not broken else ():
                    item = waiting.take(worker)
                    if item is None:
                        continue
                    try:
                        under_way[pools[worker].submit(work, item)] = worker, item
                    except BrokenProcessPool:
                        waiting.put_back(worker, item)
                        broken = True
                        break
                    idle.remove(worker)
            if not under_way:
                break
            ready, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in ready:
                worker, item = under_way.pop(future)
                idle.add(worker)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    broken = True
                    suspects.append(item)
                else:
                    yield item, result
    finally:
        if under_way:
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
        # Waits for the pools' threads too: one that closes during the interpreter's exit prints a traceback.
        for pool in pools:
            pool.shutdown(cancel_futures=True)
    waiting.release()
    return suspects


@contextlib.contextmanager
def _inherited_by_children() -> Iterator[None]:
    """Set what spawned processes inherit: single-threaded linear algebra, and a blocked SIGINT, which is for the
    parent.

    A blocked signal stays blocked in the child; here it is only delayed. The user's script is not inherited: a child
    that imported it again would start its work again, and everything sent to a child comes from this package.
    """
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    masked = hasattr(signal, "pthread_sigmask")
    if masked:
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        sys.modules["__main__"] = script
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
        if masked:
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _start_worker(threads: int, renderer: bool) -> None:
    """Prepare a worker: die with the parent, and share the processors."""
    threading.Thread(target=_die_with_parent, daemon=True).start()
    get_ready(threads, renderer)


def get_ready(threads: int, renderer: bool) -> None:
    """Give this process its share of the processors, and a renderer if needed."""
    import cv2

    cv2.setNumThreads(threads)
    if renderer:
        from horizonval.renderer.backend import activate

        activate(threads)


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
