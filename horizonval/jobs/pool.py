"""Worker processes that may be killed, may crash, and never outlive the run.

Items go to spawned processes one at a time. When a worker dies (out of memory, a crash inside a library) the others
finish what they are at; the items whose workers died are then tried once more, each alone, and only one that kills its
worker again is given up.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from types import ModuleType
from typing import TypeAlias, TypeVar

from horizonval.jobs.execution import available_cpus
from horizonval.jobs.turns import Turns

I = TypeVar("I")  # noqa: E741
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
    group : callable, optional
        Returns what an item shares with others: those of a group go to one worker (:mod:`horizonval.jobs.turns`).

    Notes
    -----
    Closing the generator (or Ctrl-C) ends the workers at once; what they were doing is lost, nothing else.
    """
    waiting = Turns(items, group)
    while len(waiting):
        suspects = yield from _drain(work, waiting, workers, renderer)
        for item in suspects:
            if (yield from _drain(work, Turns([item]), 1, renderer)):
                yield item, None


def _drain(work: Callable[[I], T], waiting: Turns[I], workers: int, renderer: bool) -> Results[I, T, list[I]]:
    """Have items made until none waits or a worker dies; return those whose workers died."""
    workers = max(1, min(workers, len(waiting)))
    threads = max(1, available_cpus() // workers)
    others = set(multiprocessing.active_children())
    # A pool for every worker: one of them all would give an item to any.
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
        # Waits for the pools' threads too: one that still closes while the interpreter ends prints a traceback.
        for pool in pools:
            pool.shutdown(cancel_futures=True)
    waiting.release()
    return suspects


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
