"""Where the experiments work: items go to worker processes, and what each gave is kept in a file of its own.

``each`` is the only idea: a function of plain data, applied to many items. The result of an item lies under the digest
of (function, item, seed, code), so that a run that was cut off goes on where it stopped, and a change of the item, the
seed or the code makes it anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from horizonval.core.code import code_digest
from horizonval.core.errors import one_line
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.pool import available_cpus, run_cases
from horizonval.store.folder import read_json, write_json


@dataclass(frozen=True)
class TaskCache:
    """A folder for results, a seed, worker processes.

    Attributes
    ----------
    folder : Path
    seed : int
        Of all noise in the experiments; see :meth:`rng`.
    workers : int
    progress : Progress
    """

    folder: Path
    seed: int = 0
    workers: int = field(default_factory=available_cpus)
    progress: Progress = field(default_factory=Silent)

    def each(
        self, title: str, work: Callable[[JsonObject], JsonObject], items: Mapping[str, JsonObject]
    ) -> dict[str, JsonObject]:
        """Return what ``work`` gives for every item, by the item's name and in the items' order.

        Parameters
        ----------
        title : str
            For the progress display.
        work : callable
            A function at the top level of its module, of plain data, returning plain data; it runs in another process
            with the renderer ready. It must depend on nothing but its item, so a seed that it needs is in the item.
        items : mapping
            By unique name.

        Raises
        ------
        RuntimeError
            A defect in ``work``; the other items' results are kept.
        """
        paths = {name: self._path(work, item) for name, item in items.items()}
        results = {name: found for name, path in paths.items() if (found := read_json(path)) is not None}
        missing = [(name, dict(items[name]), str(paths[name])) for name in items if name not in results]
        self.progress.start(len(items), len(results), unit="items", what=title)
        failed: dict[str, str] = {}
        for (name, _, path), result in run_cases(partial(_safely, work), missing, self.workers):
            error = "its process died" if result is None else result.get("error")
            if result is None or error is not None:
                failed[name] = str(error)
            else:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                write_json(Path(path), result["value"], indent=None)
                results[name] = result["value"]
            self.progress.done(name, failed=error)
        if failed:
            first = next(iter(failed))
            raise RuntimeError(f"{title}: {len(failed)} of {len(items)} failed; {first}: {failed[first]}")
        return {name: results[name] for name in items}

    def rng(self, *names: str) -> np.random.Generator:
        """Return the random numbers that belong to these names under this seed."""
        return rng_of(self.seed, *names)

    def _path(self, work: Callable[[JsonObject], JsonObject], item: JsonObject) -> Path:
        content = json.dumps([work.__module__, work.__qualname__, item, code_digest(work.__module__)], sort_keys=True)
        digest = hashlib.sha256(content.encode()).hexdigest()
        return self.folder / digest[:2] / f"{digest}.json"


def rng_of(seed: int, *names: str) -> np.random.Generator:
    """Return the random numbers that belong to a seed and some names: alike in every process."""
    digest = hashlib.sha256(json.dumps([seed, *names]).encode()).digest()
    return np.random.default_rng(np.random.SeedSequence(int.from_bytes(digest, "big")))


def _safely(work: Callable[[JsonObject], JsonObject], task: tuple[str, JsonObject, str]) -> JsonObject:
    _, item, _ = task
    try:
        return {"value": work(item)}
    except Exception as e:
        return {"error": one_line(e)}
