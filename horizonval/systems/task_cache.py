"""Cache of the experiments' tasks: items go to worker processes, and each result is stored in a file.

``each`` is the only idea: a function of plain data, applied to many items. The result of an item lies under the digest
of (function, item, seed, code), so that a run that was cut off goes on where it stopped, and a change of the item, the
seed or the code makes it anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from horizonval.core.code import code_digest
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.engine import Record, Recorded, do
from horizonval.jobs.pool import Execution, available_cpus
from horizonval.jobs.progress import Stopwatch


@dataclass(frozen=True)
class TaskCache:
    """A folder for results, a seed of all noise (:meth:`rng`), worker processes, and progress."""

    folder: Path
    seed: int = 0
    workers: int = field(default_factory=available_cpus)
    progress: Progress = field(default_factory=Silent)

    def each(
        self, title: str, work: Callable[[JsonObject], JsonObject], items: Mapping[str, JsonObject]
    ) -> dict[str, JsonObject]:
        """Return what ``work`` gives for every item, by the item's name and in the items' order.

        ``title``: for the progress display; ``work``: a top-level function from plain data to plain data, which runs in
        another process with the renderer ready; it must depend on its item only, which therefore holds any seed. Raises
        ``RuntimeError``: a defect in ``work``; other items' results are kept.
        """
        named = [NamedItem(name, dict(item)) for name, item in items.items()]
        execution = Execution(self.workers)
        done = do(TaskWork(work, self.folder), named, execution, self.progress, unit="items", what=title)
        failed = {name: one.error for name, one in done.items() if one.result is None}
        if failed:
            first = next(iter(failed))
            raise RuntimeError(f"{title}: {len(failed)} of {len(items)} failed; {first}: {failed[first]}")
        return {name: one.result["value"] for name, one in done.items() if one.result is not None}

    def rng(self, *names: str) -> np.random.Generator:
        """Return the random numbers that belong to these names under this seed."""
        return rng_of(self.seed, *names)


@dataclass(frozen=True)
class NamedItem:
    """An item by its name."""

    name: str
    item: JsonObject


class TaskWork(Recorded[NamedItem]):
    """A function of plain data on many items; the result of each lies under its identity."""

    sort_keys = False

    def __init__(self, function: Callable[[JsonObject], JsonObject], folder: Path) -> None:
        self.function, self.place = function, folder

    def name(self, item: NamedItem) -> str:
        """Return the item's name."""
        return item.name

    def path(self, item: NamedItem) -> Path:
        """Return the file of the result."""
        identity = self.identity(item)
        return self.place / identity[:2] / f"{identity}.json"

    def identity(self, item: NamedItem) -> str:
        """Return the digest of the function, the item and the code."""
        code = code_digest(self.function.__module__, "horizonval.api")
        content = json.dumps([self.function.__module__, self.function.__qualname__, item.item, code], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()

    def record(self, item: NamedItem, watch: Stopwatch) -> Record:
        """Call the function."""
        return {"value": self.function(item.item)}


def rng_of(seed: int, *names: str) -> np.random.Generator:
    """Return the random numbers that belong to a seed and some names: alike in every process."""
    digest = hashlib.sha256(json.dumps([seed, *names]).encode()).digest()
    return np.random.default_rng(np.random.SeedSequence(int.from_bytes(digest, "big")))
