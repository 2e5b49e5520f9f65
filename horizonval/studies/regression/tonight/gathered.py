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
from horizonval.jobs.engine import Record, do
from horizonval.jobs.pool import Execution
from horizonval.spec.load import Case, Suite
from horizonval.spec.suite import RegressionSpec
from horizonval.studies.regression.baseline.baseline import Baseline
from horizonval.studies.regression.bench import NightWork, Task
from horizonval.studies.regression.environment import environment
from horizonval.studies.regression.heads import seen_together
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.tonight.wanted import NIGHT_SCHEMA, PUBLISHED, WORK, Published, Wanted, seed_of_night
from horizonval.studies.regression.units import Seen, is_due
from horizonval.suites.plan import CasePlan, Unit, units_of
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
        self.together: dict[str, JsonObject] = {}
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
        known: set[Seen] = set()
        if self.accepted is not None and "replay" in self.wanted.lanes:
            pack = self.accepted.images
            known |= {(image.sha256, image.radiance_per_dn) for image in pack.images}
            known |= _known_together(self.accepted)
            tasks |= self._replay_tasks(self.accepted)
        if "rerender" in self.wanted.lanes:
            for unit in units_of(self.suite.cases, self.plan):
                name = f"rerender/{unit.name}"
                tasks[name] = replace(
                    self._render_task(name, unit), replicates=self.spec.replicates, known=frozenset(known)
                )
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
        drawn = [case for case in other.cases if content_of(case) not in fixed]
        tasks = {}
        for unit in units_of(drawn, self.plan):
            name = f"fresh/{self.batches}/{unit.name}"
            tasks[name] = replace(self._render_task(name, unit), batch=self.batches)
        self.batches += 1
        return tasks

    def _render_task(self, name: str, unit: Unit) -> Task:
        heads = tuple((str(case.head), case.name) for case in unit.cases) if unit.heads else ()
        return Task(name, "render", cases=unit.cases, heads=heads, estimators=self._estimators_of(unit))

    def _replay_tasks(self, accepted: Baseline) -> dict[str, Task]:
        """Return the frozen images of every scene, those of one scene's heads together as they were rendered.

        The estimators are those that run on the scene tonight. One that the suite has no more is replayed by those of
        its rows, so that it does not count as a changed one beside being missed.
        """
        asked = {unit.name: self._estimators_of(unit) for unit in units_of(self.suite.cases, self.plan)}
        asked |= {case.name: self.plan.alone(case) for case in self.suite.cases if case.name not in asked}
        before: dict[str, set[str]] = {}
        for row in accepted.results.rows:
            before.setdefault(row.scene, set()).add(row.estimator)
        heads = {
            scene: tuple((head, case) for head, case in about["heads"]) for scene, about in accepted.together.items()
        }
        scene_of = {case: scene for scene, of_heads in heads.items() for _, case in of_heads}
        scenes = dict.fromkeys(scene_of.get(image.scene, image.scene) for image in accepted.images.images)
        tasks = {}
        for scene in scenes:
            names, members = asked.get(scene), heads.get(scene, ())
            if names is None:
                known = set().union(*(before.get(one, set()) for one in (scene, *(case for _, case in members))))
                names = tuple(name for name in self.plan.estimators if name in known)
            name = f"replay/{scene}"
            tasks[name] = Task(
                name,
                "replay",
                pack=accepted.pack,
                scene=scene,
                heads=members,
                estimators=names,
                depends_on=str(accepted.head["pack_sha256"]),
            )
        return tasks

    def _estimators_of(self, unit: Unit) -> tuple[str, ...]:
        """Return the estimators that run on a unit, in the suite's order."""
        case = unit.cases[0]
        return self.plan.of(case) if unit.heads else self.plan.alone(case)

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
                # A scene that no method saw before has no partner to be compared with.
                before = about.get((row.scene, row.band), row)
                self.replayed.append(replace(row, table=before.table, due=before.due, bound_arcsec=before.bound_arcsec))
        else:
            parts = record.get("heads", [record])
            rows = [row for one in ([record, *parts] if "heads" in record else parts) for row in _rows(one)]
            if task.batch is not None:
                self.fresh += [replace(row, scene=f"{task.batch}/{row.scene}") for row in rows]
                return
            self.rows += rows
            for part in parts:
                self.scenes[part["scene"]] = {key: part[key] for key in ("table", "camera", "truth", "bands")}
                self.arrays[part["scene"]] = str(arrays)
            if "together" in record:
                whole = record["together"]
                self.together[whole["scene"]] = {key: whole[key] for key in ("table", "heads", "bands")}

    def all_rows(self) -> list[ReplicateRow]:
        """Return the rows on tonight's images: those estimated again, and of unchanged images those of the replay."""
        by_image = {(r.image, r.scene, r.estimator): r for r in self.replayed}
        found = {r.key: r for r in self.rows}
        for scene, record in [*self.scenes.items(), *self.together.items()]:
            for band, about in record["bands"].items():
                for replicate, image in enumerate(about["images"]):
                    for estimator in self.plan.estimators:
                        key = (scene, band, replicate, estimator)
                        row = by_image.get((image, scene, estimator))
                        if key not in found and row is not None:
                            own = {"table": record["table"], "due": is_due(about)}
                            bound = about.get("bound_arcsec")
                            found[key] = replace(row, replicate=replicate, bound_arcsec=bound, **own)
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
            "together": self.together,
            "arrays": {scene: Path(path).name for scene, path in self.arrays.items()},
            "rows": [row.to_dict() for row in self.all_rows()],
            "fresh": [row.to_dict() for row in self.fresh],
            "environment": environment(),
            "replicates": self.spec.replicates,
            "gates": [gate.model_dump(mode="json") for gate in self.spec.gate],
        }


def _rows(record: Mapping[str, Any]) -> list[ReplicateRow]:
    return [ReplicateRow.from_dict(row) for row in record["rows"]]


def _known_together(accepted: Baseline) -> set[Seen]:
    """Return what the replay shows of all heads of a scene at once."""
    pack, found = accepted.images, set()
    images = {(image.scene, image.band, image.replicate): image for image in pack.images}
    for about in accepted.together.values():
        cases = [case for _, case in about["heads"]]
        for scene, band, replicate in images:
            keys = [(case, band, replicate) for case in cases]
            if scene == cases[0] and all(key in images for key in keys):
                found.add(seen_together([(images[key].sha256, images[key].radiance_per_dn) for key in keys]))
    return found


def content_of(case: Case) -> str:
    """Return what a frame is, but for the seed of what is random in its scene."""
    scene = case.scene.model_dump(mode="json")
    scene["scene"] = {**scene["scene"], "seed": 0}
    return json.dumps([scene, case.camera.model_dump(mode="json")], sort_keys=True)
