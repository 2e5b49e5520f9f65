"""The same work on a Dask cluster, with the same bytes.

Workers write their results into a folder on a shared file system. Each worker has one thread, because the renderer
keeps its state per process. Dask gives the item of a dead worker to another; an item that kills three is given up.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from horizonval.core import atomic
from horizonval.core.code import code_version
from horizonval.core.errors import UserError
from horizonval.jobs.pool import Results, get_ready, local_workers

I = TypeVar("I")  # noqa: E741
T = TypeVar("T")

CONNECT_LIMIT_S = 30.0
DEATHS = 2
"""Number of workers that an item may kill before it is given up."""

_ready = False


def run_on_cluster(
    work: Callable[[I], T],
    items: Iterable[I],
    address: str,
    folder: Path,
    *,
    renderer: bool = True,
    on_start: Callable[[], None],
) -> Results[I, T | None, None]:
    """Yield every item with its result as it finishes; ``None`` for one that killed its workers.

    ``work``: picklable; must not raise. ``address``: of a scheduler, or ``local:N`` for N processes on this machine.
    ``renderer``: whether workers get a renderer. ``on_start``: called once when the workers are ready. Raises
    ``UserError``: no scheduler answers, or its workers do not see the folder, have other code or more than one thread.
    """
    workers = local_workers(address)
    import distributed
    from distributed import as_completed

    with _client(address, workers) as client:
        _check_workers(client, folder.resolve(), address)
        on_start()
        futures = {client.submit(_prepared, work, item, renderer, pure=False): item for item in items}
        waiting = as_completed(futures)
        for future in waiting:
            item = futures.pop(future)
            try:
                result = future.result()
            except distributed.KilledWorker:
                result = None
            except (distributed.CancelledError, distributed.comm.CommClosedError) as e:
                raise UserError("the cluster is gone", where=f"--dask {address}", fix="start it, and run again") from e
            future.release()
            yield item, result


def _prepared(work: Callable[[I], T], item: I, renderer: bool) -> T:
    """Run the work in a worker that has its renderer ready."""
    global _ready
    if not _ready:
        get_ready(1, renderer)
        _ready = True
    return work(item)


@contextlib.contextmanager
def _client(address: str, workers: int | None) -> Iterator[Any]:
    import dask
    import distributed

    with dask.config.set({"distributed.scheduler.allowed-failures": DEATHS - 1}), contextlib.ExitStack() as stack:
        if workers is not None:
            cluster = distributed.LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
            )
            yield stack.enter_context(distributed.Client(stack.enter_context(cluster)))
            return
        try:
            client = distributed.Client(address, timeout=CONNECT_LIMIT_S)
        except (OSError, ValueError, TimeoutError) as e:
            raise UserError(
                f"no Dask scheduler answers at {address!r}",
                where="--dask",
                expected="an address such as tcp://host:8786, or local:N",
            ) from e
        yield stack.enter_context(client)


def _check_workers(client: Any, folder: Path, address: str) -> None:
    where = f"--dask {address}"
    threads = client.nthreads()
    if not threads:
        raise UserError("the cluster has no workers", where=where, fix="start some with `dask worker --nthreads 1`")
    if max(threads.values()) > 1:
        raise UserError("its workers have several threads", where=where, fix="start them with --nthreads 1")
    with atomic.temporary_in(folder) as marker:
        found = client.run(_look, str(marker))
    for worker, (sees, version) in found.items():
        if not sees:
            raise UserError(
                f"the worker {worker} does not see the folder {folder}", where=where, fix="use a shared folder"
            )
        if version != code_version():
            raise UserError(
                f"the worker {worker} has other code ({version})", where=where, expected=f"version {code_version()}"
            )


def _look(path: str) -> tuple[bool, str]:
    return os.path.exists(path), code_version()
