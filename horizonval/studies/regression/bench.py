"""Where the units of a night are worked on: processes, and a folder from which an interrupted night goes on.

A unit's result lies under the digest of what it depends on (its content and the code), so that the same command again
makes what is missing, and a change of anything makes it anew.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from horizonval.core.cache import is_intact, read_arrays, write_arrays
from horizonval.core.code import code_digest
from horizonval.jobs.engine import Record, Recorded
from horizonval.jobs.progress import Stopwatch
from horizonval.spec.load import Case
from horizonval.studies.regression.baseline.pack import read_pack
from horizonval.studies.regression.heads import render_heads, replay_heads
from horizonval.studies.regression.units import Seen, render_scene, replay_scene
from horizonval.suites.identity import code_of
from horizonval.suites.plan import CasePlan

_UNITS = (
    "horizonval.studies.regression.units",
    "horizonval.studies.regression.heads",
    "horizonval.plugins.child",
)
CODE = {"replay": _UNITS, "render": _UNITS, "anchors": ("horizonval.studies.regression.anchors",)}
"""The modules that make a unit, by its kind; the estimators come to them by name."""


@dataclass(frozen=True)
class Task:
    """One unit: ``kind`` is ``replay``, ``render`` or ``anchors``; the other fields are what that kind needs.

    ``batch`` is the number of the batch of fresh scenes that a case belongs to, ``None`` for one of the suite's own.
    Of a scene with methods that see all its heads, ``cases`` are those of all heads and ``heads`` their names by the
    head's; of others there is one case, and ``heads`` is empty. ``estimators`` run on it, all of the plan's by default.
    """

    name: str
    kind: str
    cases: tuple[Case, ...] = ()
    batch: int | None = None
    replicates: int = 1
    pack: Path | None = None
    scene: str = ""
    heads: tuple[tuple[str, str], ...] = ()
    estimators: tuple[str, ...] | None = None
    known: frozenset[Seen] = frozenset()
    depends_on: str = ""


class NightWork(Recorded[Task]):
    """Units of a night: a record each, and a file of arrays beside that of a rendered scene."""

    def __init__(self, plan: CasePlan, folder: Path) -> None:
        self.plan = plan
        self.folder: Path | None = folder
        self._place = folder

    def name(self, item: Task) -> str:
        """Return the unit's name."""
        return item.name

    def path(self, item: Task) -> Path:
        """Return the file of the record."""
        return self._place / f"{self.identity(item)}.json"

    def arrays(self, item: Task) -> Path:
        """Return the file of the arrays."""
        return self.path(item).with_suffix(".npz")

    def identity(self, item: Task) -> str:
        """Return the digest of what a unit's result depends on: the name of its files."""
        cases = [
            [case.name, case.table or "", case.scene.model_dump(mode="json"), case.camera.model_dump(mode="json")]
            for case in item.cases
        ]
        known = sorted(item.known, key=str)
        content = [item.kind, cases, item.scene, item.heads, known, item.depends_on, item.replicates]
        plan = self._plan_of(item)
        code = code_digest(*CODE[item.kind], *code_of(plan.estimators if item.kind != "anchors" else ()))
        text = json.dumps([content, plan.content(), code], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def finished(self, item: Task) -> Record | None:
        """Return the record of a unit whose arrays are there and undamaged, too."""
        return None if item.kind == "render" and not is_intact(self.arrays(item)) else super().finished(item)

    def record(self, item: Task, watch: Stopwatch) -> Record:
        """Do a unit and write its arrays."""
        plan = self._plan_of(item)
        if item.kind == "anchors":
            from horizonval.studies.regression.anchors import anchors

            return {"anchors": anchors()}
        if item.kind == "replay":
            assert item.pack is not None
            if item.heads:
                return {"rows": replay_heads(read_pack(item.pack), item.scene, dict(item.heads), plan)}
            return {"rows": replay_scene(item.pack, item.scene, plan)}
        if item.heads:
            record, arrays = render_heads(item.cases, plan, item.replicates, item.known)
        else:
            (case,) = item.cases
            record, arrays = render_scene(case, plan, item.replicates, item.known)
        write_arrays(self.arrays(item), arrays)
        return record

    def _plan_of(self, item: Task) -> CasePlan:
        return self.plan if item.estimators is None else replace(self.plan, estimators=item.estimators)


def arrays_of(path: Path, scene: str) -> dict[str, np.ndarray]:
    """Return the arrays of a scene from the file of its unit, which may hold those of several heads."""
    arrays, start = read_arrays(path), f"{scene}:"
    of_head = {name.removeprefix(start): values for name, values in arrays.items() if name.startswith(start)}
    return of_head or arrays


def sweep(folder: Path, kept: Iterable[str]) -> None:
    """Delete the files of units that are not among the identities ``kept``: those of earlier nights and older code."""
    names = frozenset(kept)
    for path in folder.iterdir():
        if path.suffix in (".json", ".npz") and path.stem not in names:
            path.unlink(missing_ok=True)
