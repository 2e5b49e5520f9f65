"""Where work is done: processes, shards, a cluster."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from horizonval.core.errors import UserError

I = TypeVar("I")  # noqa: E741


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
    """

    workers: int | None = None
    shard: tuple[int, int] | None = None
    dask: str | None = None
    merge: tuple[Path, ...] = field(default=())

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


def parse_shard(text: str) -> tuple[int, int]:
    """Return (i, n) of ``"i/n"``.

    Raises
    ------
    UserError
        If it is not two whole numbers with 1 <= i <= n.
    """
    first, _, second = text.partition("/")
    if first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise UserError(f"found {text!r}", where="--shard", expected="i/n with i from 1 to n, such as 2/8")
