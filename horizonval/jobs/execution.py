"""Where work is done: processes, shards, a cluster."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from horizonval.core.errors import UserError

I = TypeVar("I")  # noqa: E741
MOST_WORKERS = 4096
MOST_SHARDS = 1_000_000
"""As many as a suite may have frames."""


@dataclass(frozen=True)
class Execution:
    """Where the work is done. It changes no result.

    Attributes
    ----------
    workers : int, optional
        Processes on this machine; one per processor by default, as most stages run on a single one.
    shard : (int, int), optional
        (i, n): only every n-th item, from the i-th on. Shards can share a folder, also at the same time.
    dask : str, optional
        Address of a Dask scheduler, or ``local:N``; its workers must see the run's folder.
    merge : tuple of Path
        Folders of other runs of the same suite, whose results are taken over.

    Raises
    ------
    UserError
        No number of processes, or too many; no address of a scheduler, or Dask is not installed.
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
    """Return how many processors this process may use: its affinity, and a container's share of time."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(OSError, ValueError), open("/sys/fs/cgroup/cpu.max") as file:
        quota, period = file.read().split()
        cpus = min(cpus, max(1, round(int(quota) / int(period))))
    return cpus


def local_workers(address: str) -> int | None:
    """Return N of the address ``local:N``, ``None`` for that of a Dask scheduler.

    Raises
    ------
    UserError
        If N is no number of processes.
    """
    local, _, count = address.partition(":")
    if local != "local":
        return None
    if not re.fullmatch("[0-9]{1,5}", count) or not 1 <= int(count) <= MOST_WORKERS:
        expected = f"local:N with N from 1 to {MOST_WORKERS}, or an address"
        raise UserError(f"found {address[:80]!r}", where="--dask", expected=expected)
    return int(count)


def parse_shard(text: str) -> tuple[int, int]:
    """Return (i, n) of ``"i/n"``.

    Raises
    ------
    UserError
        If it is not two whole numbers with 1 <= i <= n.
    """
    match = re.fullmatch(r"([0-9]{1,7})/([0-9]{1,7})", text)
    if match and 1 <= int(match[1]) <= int(match[2]) <= MOST_SHARDS:
        return int(match[1]), int(match[2])
    expected = f"i/n with i from 1 to n, such as 2/8, and n of at most {MOST_SHARDS}"
    raise UserError(f"found {text[:40]!r}", where="--shard", expected=expected)
