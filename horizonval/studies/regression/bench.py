"""Where the units of a night are worked on: processes, and a folder from which an interrupted night goes on.

A unit's result lies under the digest of what it depends on (its content and the code), so that the same command again
makes what is missing, and a change of anything makes it anew.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic
from horizonval.core.code import code_digest
from horizonval.core.errors import one_line
from horizonval.core.progress import Progress
from horizonval.jobs.pool import run_cases
from horizonval.spec.load import Case
from horizonval.store.folder import read_json, write_json
from horizonval.studies.regression.units import render_scene, replay_scene
from horizonval.suites.identity import code_of
from horizonval.suites.plan import CasePlan

_UNITS = ("horizonval.studies.regression.units", "horizonval.estimation.process.estimator_process")
CODE = {"replay": _UNITS, "render": _UNITS, "anchors": ("horizonval.studies.regression.anchors",)}
"""The modules that make a unit, by its kind; the estimators come to them by name."""


@dataclass(frozen=True)
class Task:
    """One unit: ``kind`` is ``replay``, ``render`` or ``anchors``; the other fields are what that kind needs.

    ``batch`` is the number of the batch of fresh scenes that a case belongs to, ``None`` for one of the suite's own.
    """

    name: str
    kind: str
    case: Case | None = None
    batch: int | None = None
    replicates: int = 1
    pack: Path | None = None
    scene: str = ""
    known: frozenset[str] = frozenset()
    depends_on: str = ""


@dataclass(frozen=True)
class Done:
    """What became of a unit: its record, the file of its arrays, or why there is none."""

    record: dict[str, Any]
    arrays: Path | None
    error: str | None


def work(tasks: Mapping[str, Task], plan: CasePlan, folder: Path, workers: int, progress: Progress) -> dict[str, Done]:
    """Return what became of every unit, by name; a unit that fails or whose process dies has an ``error``.

    Nothing that is finished in the folder is made again.
    """
    folder.mkdir(parents=True, exist_ok=True)
    places = {name: folder / identity(task, plan) for name, task in tasks.items()}
    found: dict[str, Done] = {}
    for name, place in places.items():
        record = read_json(place.with_suffix(".json"))
        arrays = place.with_suffix(".npz")
        if record is not None and (arrays.is_file() or tasks[name].kind != "render"):
            found[name] = Done(record, arrays if arrays.is_file() else None, None)
    missing = [(task, str(places[name])) for name, task in tasks.items() if name not in found]
    progress.start(len(tasks), len(found))
    if missing:
        results = run_cases(partial(_safely, plan=plan), missing, workers)
        with contextlib.closing(results):
            for (task, stem), error in results:
                why = "its process died (a crash, or out of memory)" if error is None else error
                record = read_json(Path(stem).with_suffix(".json")) if why == "" else None
                if record is None:
                    found[task.name] = Done({}, None, why or "its result cannot be read")
                else:
                    arrays = Path(stem).with_suffix(".npz")
                    found[task.name] = Done(record, arrays if arrays.is_file() else None, None)
                progress.done(task.name, failed=found[task.name].error)
    return {name: found[name] for name in tasks}


def sweep(folder: Path, kept: Iterable[str]) -> None:
    """Delete the files of units that are not among the identities ``kept``: those of earlier nights and older code."""
    names = frozenset(kept)
    for path in folder.iterdir():
        if path.suffix in (".json", ".npz") and path.stem not in names:
            path.unlink(missing_ok=True)


def _safely(task: tuple[Task, str], plan: CasePlan) -> str:
    """Do a unit and write its files; return an empty text, or what went wrong."""
    unit, place = task
    path = Path(place)
    try:
        record, arrays = _do(unit, plan)
        if arrays:
            _write_arrays(path.with_suffix(".npz"), arrays)
        write_json(path.with_suffix(".json"), record, indent=None)
    except Exception as e:
        return one_line(e)
    return ""


def _do(task: Task, plan: CasePlan) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    if task.kind == "anchors":
        from horizonval.studies.regression.anchors import anchors

        return {"anchors": anchors()}, {}
    if task.kind == "replay":
        assert task.pack is not None
        return {"rows": replay_scene(task.pack, task.scene, plan)}, {}
    assert task.case is not None
    return render_scene(task.case, plan, task.replicates, task.known)


def identity(task: Task, plan: CasePlan) -> str:
    """Return the digest of what a unit's result depends on: the name of its files."""
    case, table = None, ""
    if task.case is not None:
        table = task.case.table or ""
        case = [task.case.scene.model_dump(mode="json"), task.case.camera.model_dump(mode="json")]
    content = [task.kind, case, table, task.scene, sorted(task.known), task.depends_on, task.replicates]
    code = code_digest(*CODE[task.kind], *code_of(plan.estimators if task.kind != "anchors" else ()))
    text = json.dumps([content, plan.content(), code], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    with atomic.replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **dict(arrays))  # type: ignore[arg-type]
