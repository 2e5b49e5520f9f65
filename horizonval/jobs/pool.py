"""Worker processes that may be killed, may crash, and never outlive the run.

Items go to spawned processes a few at a time. A worker that dies (out of memory, a crash inside a library) takes the
whole pool of :mod:`concurrent.futures` with it; the items under way are then tried once more, each alone, and only
one that kills its worker again is given up.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from types import ModuleType
from typing import TypeAlias, TypeVar

from horizonval.jobs.execution import available_cpus

I = TypeVar("I")  # noqa: E741
T = TypeVar("T")
R = TypeVar("R")
Results: TypeAlias = Generator[tuple[I, T], None, R]

_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Linear algebra on one thread: the order of its sums, hence its last bit, must not depend on the machine."""


def run_in_processes(
    work: Callable[[I], T], items: Iterable[I], workers: int, *, renderer: bool = True
) -> Results[I, T | None, None]:
    """Yield every item with its result, as they come; ``None`` for one that killed its worker.

    Parameters
    ----------
    work : callable
        Picklable; must not raise.
    items : iterable
        Of anything picklable.
    workers : int
        Processes; the processors are shared among them.
    renderer : bool
        Whether they get a renderer.

    Notes
    -----
    Closing the generator (or Ctrl-C) ends the workers at once; what they were doing is lost, nothing else.
    """
    waiting = deque(items)
    while waiting:
        suspects = yield from _drain(work, waiting, workers, renderer)
        for item in suspects:
            if (yield from _drain(work, deque([item]), 1, renderer)):
                yield item, None


def _drain(work: Callable[[I], T], waiting: deque[I], workers: int, renderer: bool) -> Results[I, T, list[I]]:
    """Take items from the left until none is left or the pool breaks; return those that were under way then."""
    workers = max(1, min(workers, len(waiting)))
    threads = max(1, available_cpus() // workers)
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_start_worker,
        initargs=(threads, renderer),
    )
    under_way: dict[Future[T], I] = {}
    suspects: list[I] = []
    try:
        while (waiting or under_way) and not suspects:
            with _inherited_by_children():
                while waiting and len(under_way) < workers:
                    under_way[pool.submit(work, waiting[0])] = waiting[0]
                    waiting.popleft()
            ready, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in ready:
                item = under_way.pop(future)
                try:
                    result = future.result()
                except BrokenProcessPool:
                    suspects.append(item)
                else:
                    yield item, result
    except BrokenProcessPool:
        pass
    finally:
        children = set(multiprocessing.active_children()) - others
        pool.shutdown(wait=False, cancel_futures=True)
        if under_way:
            for child in children:
                child.terminate()
        for child in children:
            child.join()
    return [*suspects, *under_way.values()]


@contextlib.contextmanager
def _inherited_by_children() -> Iterator[None]:
    """Set what spawned processes inherit: one thread for linear algebra, and deafness to Ctrl-C, which is for us.

    A blocked signal stays blocked in the child, from its first instruction on; here it is only delayed. The user's
    script is no part of the inheritance: a child that imported it again would start the script's work again, and all
    that is sent to a child comes from this package.
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
    """Give this process its share of the processors, and a renderer."""
    import cv2

    cv2.setNumThreads(threads)
    if renderer:
        from horizonval.renderer.plugin.backend import activate

        activate(threads)


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
