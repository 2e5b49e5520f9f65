"""What the lanes of one night bring together: which units there are, and what came of them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress
from horizonval.jobs.engine import do
from horizonval.jobs.execution import Execution
from horizonval.jobs.kept import Record
from horizonval.spec.load import Case, Suite
from horizonval.spec.regression import RegressionSpec
from horizonval.studies.regression.baseline.baseline import Baseline
from horizonval.studies.regression.bench import NightWork, Task
from horizonval.studies.regression.environment import environment
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.tonight.wanted import NIGHT_SCHEMA, PUBLISHED, WORK, Published, Wanted, seed_of_night
from horizonval.studies.regression.units import Seen, is_due
from horizonval.suites.plan import CasePlan
from horizonval.suites.suite import load_suite


class Gathered:
    """What the lanes of one night brought together."""

    def __init__(
        self,
        suite: Suite,
        spec: RegressionSpec,
        plan: CasePlan,
        wanted: Wanted,
        accepted: Baseline | None,
        progress: Progress,
    ) -> None:
        self.suite, self.spec, self.plan, self.wanted, self.accepted = suite, spec, plan, wanted, accepted
        self._progress = progress
        self.identities: set[str] = set()
        self.failed: dict[str, str] = {}
        self.replayed: list[ReplicateRow] = []
        self.scenes: dict[str, JsonObject] = {}
        self.rows: list[ReplicateRow] = []
        self.arrays: dict[str, str] = {}
        self.fresh: list[ReplicateRow] = []
        self.batches = 0
        self.anchors: list[JsonObject] = []
        self.published: list[JsonObject] = []
        self.replay_s: list[float] = []

    def work_first(self) -> None:
        """Do what every night does."""
        self._do(self.first_tasks())

    def compute_published(self, compute: Published | None) -> None:
        """Compute key figures of the published systems again, in a suite that asks for it."""
        if compute is None or not self.spec.published or PUBLISHED not in self.wanted.lanes:
            return
        folder = self.wanted.out / WORK / PUBLISHED
        try:
            folder.mkdir(exist_ok=True)
            self.published = list(compute(folder, self._progress))
        except (UserError, RuntimeError) as error:
            self.failed[PUBLISHED] = str(error)
            return
        # An interrupted night goes on from it; a finished one must not leave what the next has no use for.
        shutil.rmtree(folder)

    def first_tasks(self) -> dict[str, Task]:
        """Return what every night does, by name."""
        tasks = {"anchors": Task("anchors", "anchors")}
        known: frozenset[Seen] = frozenset()
        if self.accepted is not None and "replay" in self.wanted.lanes:
            pack = self.accepted.images
            known = frozenset((image.sha256, image.radiance_per_dn) for image in pack.images)
            digest = str(self.accepted.head["pack_sha256"])
            for scene in dict.fromkeys(image.scene for image in pack.images):
                name = f"replay/{scene}"
                tasks[name] = Task(name, "replay", pack=self.accepted.pack, scene=scene, depends_on=digest)
        if "rerender" in self.wanted.lanes:
            for case in self.suite.cases:
                name = f"rerender/{case.name}"
                tasks[name] = Task(name, "render", case=case, replicates=self.spec.replicates, known=known)
        if "fresh" in self.wanted.lanes:
            tasks |= self._fresh_tasks()
        return tasks

    def work_on_more_scenes(self) -> None:
        """Do another batch of fresh scenes."""
        self._do(self._fresh_tasks())

    def _fresh_tasks(self) -> dict[str, Task]:
        """Return another batch of fresh scenes: the Sobol tables under a seed of the night."""
        other = load_suite(self.wanted.suite, seed=seed_of_night(self.suite.name, self.wanted.night, self.batches))
        fixed = {content_of(case) for case in self.suite.cases}
        tasks = {}
        for case in other.cases:
            if content_of(case) not in fixed:
                name = f"fresh/{self.batches}/{case.name}"
                tasks[name] = Task(name, "render", case=case, batch=self.batches)
        self.batches += 1
        return tasks

    def _do(self, tasks: Mapping[str, Task]) -> None:
        work = NightWork(self.plan, self.wanted.out / WORK)
        self.identities |= {work.identity(task) for task in tasks.values()}
        done = do(work, list(tasks.values()), Execution(self.wanted.workers), self._progress)
        for name, one in done.items():
            if tasks[name].kind == "replay" and one.spent is not None:
                self.replay_s.append(one.spent.seconds)
            if one.result is None:
                self.failed[name] = one.error or "its result cannot be read"
            else:
                self._take(tasks[name], one.result, work.arrays(tasks[name]))

    def _take(self, task: Task, record: Record, arrays: Path) -> None:
        if task.kind == "anchors":
            self.anchors = list(record["anchors"])
        elif task.kind == "replay":
            assert self.accepted is not None
            about = {(r.scene, r.band): r for r in self.accepted.results.rows}
            for row in _rows(record):
                before = about[row.scene, row.band]
                self.replayed.append(replace(row, table=before.table, due=before.due, bound_arcsec=before.bound_arcsec))
        elif task.batch is not None:
            scene = f"{task.batch}/{record['scene']}"
            self.fresh += [replace(row, scene=scene) for row in _rows(record)]
        else:
            self.scenes[record["scene"]] = {key: record[key] for key in ("table", "camera", "truth", "bands")}
            self.arrays[record["scene"]] = str(arrays)
            self.rows += _rows(record)

    def all_rows(self) -> list[ReplicateRow]:
        """Return the rows on tonight's images: those estimated again, and of unchanged images those of the replay."""
        by_image = {(r.image, r.scene, r.estimator): r for r in self.replayed}
        found = {r.key: r for r in self.rows}
        for scene, record in self.scenes.items():
            for band, about in record["bands"].items():
                for replicate, image in enumerate(about["images"]):
                    for estimator in self.plan.estimators:
                        key = (scene, band, replicate, estimator)
                        row = by_image.get((image, scene, estimator))
                        if key not in found and row is not None:
                            bound = about.get("bound_arcsec")
                            found[key] = replace(row, replicate=replicate, due=is_due(about), bound_arcsec=bound)
        return [found[key] for key in sorted(found)]

    def content(self) -> JsonObject:
        """Return what a baseline is made of."""
        return {
            "schema": NIGHT_SCHEMA,
            "suite": self.suite.name,
            "night": self.wanted.night,
            "lanes": list(self.wanted.lanes),
            "failed": self.failed,
            "scenes": self.scenes,
            "arrays": {scene: Path(path).name for scene, path in self.arrays.items()},
            "rows": [row.to_dict() for row in self.all_rows()],
            "fresh": [row.to_dict() for row in self.fresh],
            "environment": environment(),
            "replicates": self.spec.replicates,
            "gates": [gate.model_dump(mode="json") for gate in self.spec.gate],
        }


def _rows(record: Mapping[str, Any]) -> list[ReplicateRow]:
    return [ReplicateRow.from_dict(row) for row in record["rows"]]


def content_of(case: Case) -> str:
    """Return what a frame is, but for the seed of what is random in its scene."""
    scene = case.scene.model_dump(mode="json")
    scene["scene"] = {**scene["scene"], "seed": 0}
    return json.dumps([scene, case.camera.model_dump(mode="json")], sort_keys=True)
