"""A night: run the lanes and the anchors, compare, decide, and write it all down.

The folder of a night::

    verdict.json    everything decided, for machines
    junit.xml       the same for a CI service
    index.html      the same for people, with the trend of the last 60 nights
    night.json      rows and digests, from which `horizonval baseline accept` makes the next baseline
    history.jsonl   one line for every night that used this folder
    .work/          finished units; an interrupted night goes on from them
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from horizonval.core import atomic
from horizonval.core.cache import read_arrays
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.machine.memory import peak_mebibytes
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.engine import do
from horizonval.jobs.execution import Execution
from horizonval.jobs.kept import Record
from horizonval.spec.load import Case, Suite
from horizonval.spec.regression import Lane, RegressionSpec
from horizonval.store.folder import RunFolder, write_json
from horizonval.store.manifest import withdraw_manifest, write_manifest
from horizonval.studies.regression.baseline import history
from horizonval.studies.regression.baseline.baseline import Baseline, frames_of, read_baseline, release_path
from horizonval.studies.regression.bench import NightWork, Task, sweep
from horizonval.studies.regression.environment import environment
from horizonval.studies.regression.images import compare_images
from horizonval.studies.regression.junit import write_junit
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics.decide import Verdict, night_verdict
from horizonval.studies.regression.statistics.gates import GateInputs, Measured, changed, measure, pairs_of
from horizonval.studies.regression.statistics.judge import judge
from horizonval.studies.regression.units import Seen, is_due
from horizonval.suites.plan import CasePlan, plan_of
from horizonval.suites.suite import load_suite

NIGHT_SCHEMA = 2
NightLane = Lane | Literal["published"]
LANES: tuple[NightLane, ...] = ("replay", "rerender", "fresh", "published")
WORK = ".work"
PUBLISHED = "published"
"""The lane without gates, and its folder in that of the work."""
Published = Callable[[Path, Progress], Sequence[JsonObject]]
"""Computes key figures of the published systems in a folder, each a plain
``{system, name, unit, accepted, measured, verdict}``."""
EXIT = {Verdict.PASS: 0, Verdict.IMPROVED: 0, Verdict.FAIL: 1, Verdict.INCONCLUSIVE: 3}
INCOMPLETE = 2
MOST_CHANGES = 200
"""Changed scenes written into the verdict; the count is always that of all."""


@dataclass(frozen=True)
class Wanted:
    """What a night is asked to do.

    Attributes
    ----------
    suite : str
        File or shipped name.
    out : Path
    baseline : Path
    night : str
        Label, and seed of the fresh scenes: a date.
    lanes : tuple of str
    workers : int, optional
    reference : Path, optional
        Folder of a night of the same label made by another version: fresh scenes are then compared in pairs.
    """

    suite: str
    out: Path
    baseline: Path
    night: str
    lanes: tuple[NightLane, ...] = LANES
    workers: int | None = None
    reference: Path | None = None


def run_night(wanted: Wanted, progress: Progress | None = None, published: Published | None = None) -> JsonObject:
    """Do a night and return the content of ``verdict.json``.

    Parameters
    ----------
    wanted : Wanted
    progress : Progress, optional
    published : callable, optional
        What the lane of that name does, in a suite that asks for it; without, it is left out.

    Raises
    ------
    UserError
        A mistake in the suite or the baseline's files, no ``[regression]`` table, a folder in which another night runs,
        or no back-end to render with.
    """
    from horizonval.renderer.plugin.backend import probe
    from horizonval.studies.regression.page import write_page

    suite = load_suite(wanted.suite)
    spec, plan = _checked(suite)
    accepted = read_baseline(wanted.baseline, suite.name) if wanted.baseline.is_file() else None
    release = None
    if accepted is not None and release_path(wanted.baseline).is_file():
        release = read_baseline(release_path(wanted.baseline), suite.name)
    reference = None if wanted.reference is None else _reference(wanted.reference, suite.name, wanted.night)
    if probe().chosen is None:
        raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    _check_folder(wanted.out)
    (wanted.out / WORK).mkdir(parents=True, exist_ok=True)
    folder = RunFolder(wanted.out / WORK)
    with folder.locked():
        withdraw_manifest(wanted.out)
        for path in atomic.leftovers(wanted.out / WORK, below=False):
            path.unlink(missing_ok=True)
        gathered = _Gathered(suite, spec, plan, wanted, accepted, progress or Silent())
        gathered.work_first()
        gathered.compute_published(published)
        verdict = gathered.verdict(release, reference)
        write_json(wanted.out / "night.json", gathered.content(), indent=None)
        # A folder that serves every night must not grow with them.
        sweep(wanted.out / WORK, gathered.identities)
        history.append(wanted.out / history.FILE, verdict)
        verdict["trend"] = history.steps_of(history.read(wanted.out / history.FILE))
        write_json(wanted.out / "verdict.json", verdict)
        write_junit(wanted.out / "junit.xml", verdict)
        write_page(wanted.out / "index.html", verdict, history.read(wanted.out / history.FILE))
        pages = [wanted.out / name for name in ("night.json", "verdict.json", "junit.xml", "index.html", history.FILE)]
        units = [wanted.out / WORK / f"{name}{end}" for name in gathered.identities for end in (".json", ".npz")]
        write_manifest(wanted.out, [*pages, *units])
    return verdict


def planned(wanted: Wanted) -> tuple[Suite, NightWork, list[Task]]:
    """Return what a night would begin with, and how it is made; nothing is made. Errors as :func:`run_night`."""
    suite = load_suite(wanted.suite)
    spec, plan = _checked(suite)
    accepted = read_baseline(wanted.baseline, suite.name) if wanted.baseline.is_file() else None
    gathered = _Gathered(suite, spec, plan, wanted, accepted, Silent())
    return suite, NightWork(plan, wanted.out / WORK), list(gathered.first_tasks().values())


def seed_of_night(suite: str, night: str, batch: int) -> int:
    """Return the seed of a night's fresh scenes."""
    digest = hashlib.sha256(json.dumps(["fresh", suite, night, batch]).encode()).digest()
    return int.from_bytes(digest[:7], "big")


class _Gathered:
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
        self._work(self.first_tasks())

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

    def _fresh_tasks(self) -> dict[str, Task]:
        """Return another batch of fresh scenes: the Sobol tables under a seed of the night."""
        other = load_suite(self.wanted.suite, seed=seed_of_night(self.suite.name, self.wanted.night, self.batches))
        fixed = {_content(case) for case in self.suite.cases}
        tasks = {}
        for case in other.cases:
            if _content(case) not in fixed:
                name = f"fresh/{self.batches}/{case.name}"
                tasks[name] = Task(name, "render", case=case, batch=self.batches)
        self.batches += 1
        return tasks

    def _work(self, tasks: Mapping[str, Task]) -> None:
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

    def verdict(self, release: Baseline | None, reference: GateInputs | None) -> JsonObject:
        """Return the verdict; asks for further batches of fresh scenes as long as their gates are inconclusive."""
        while True:
            comparisons, gates = self._compare(release, reference)
            undecided = any(g["lane"] == "fresh" and g["verdict"] == Verdict.INCONCLUSIVE for g in gates)
            more = undecided and self.accepted is not None and reference is None and "fresh" in self.wanted.lanes
            if not more or self.batches >= self.spec.most_batches:
                break
            self._work(self._fresh_tasks())
        return self._conclude(comparisons, gates)

    def _compare(
        self, release: Baseline | None, reference: GateInputs | None
    ) -> tuple[list[JsonObject], list[JsonObject]]:
        comparisons: list[JsonObject] = []
        measured: list[tuple[str, Measured]] = []
        bases = [("accepted", self.accepted), ("release", release)]
        for name, base in bases:
            if base is None:
                continue
            if name == "release" and self.accepted is not None and _is_same(base, self.accepted):
                comparisons.append({"name": name, "baseline": base.label, "same_as_accepted": True, "changed": []})
                continue
            about, found = self._against(name, base, reference if name == "accepted" else None)
            comparisons.append(about)
            measured += [(name, one) for one in found]
        gates = judge(measured, looks=self.spec.most_batches)
        return comparisons, gates

    def _against(self, name: str, base: Baseline, reference: GateInputs | None) -> tuple[JsonObject, list[Measured]]:
        images = self._images(base)
        now = GateInputs(self.replayed, images, self.fresh, self.wanted.night)
        whole = replace(now, rows=self.all_rows())
        theirs = (
            base.results
            if reference is None
            else replace(base.results, fresh=reference.fresh, fresh_night=reference.fresh_night)
        )
        found = []
        for gate in self.spec.gate:
            if gate.lane not in self.wanted.lanes:
                continue
            # The release's own detector images are not kept: what is compared with it is the whole chain.
            whole_chain = gate.lane == "rerender" or name == "release"
            mine = whole if whole_chain and (gate.lane != "replay" or "rerender" in self.wanted.lanes) else now
            found.append(measure(gate, mine, theirs))
        replay_pairs = pairs_of(self.replayed if name == "accepted" else (), base.results.rows)
        moved = changed(replay_pairs)
        other = [
            {"scene": scene, "band": band, **{key: value for key, value in image.items() if key != "table"}}
            for (scene, band), image in images.items()
            if not image["same_radiance"] or image["same_images"] < image["n_images"]
        ]
        about = {
            "name": name,
            "baseline": base.label,
            "reason": base.head["reason"],
            "environment": base.head["environment"],
            "same_as_accepted": False,
            "replayed": len(replay_pairs),
            "n_changed": len(moved),
            "changed": moved[:MOST_CHANGES],
            "rendered": len(images),
            "n_images_changed": len(other),
            "images_changed": other[:MOST_CHANGES],
            "missing_scenes": sorted(set(base.scenes) - set(self.scenes)) if "rerender" in self.wanted.lanes else [],
        }
        return about, found

    def _images(self, base: Baseline) -> dict[tuple[str, str], JsonObject]:
        frames = frames_of(base.images)
        found = {}
        for scene, record in self.scenes.items():
            before = base.scenes.get(scene)
            for band, now in record["bands"].items():
                if before is None or band not in before["bands"]:
                    continue
                old = before["bands"][band]
                radiance = None
                if now["radiance_sha256"] != old["radiance_sha256"]:
                    radiance = read_arrays(Path(self.arrays[scene]))[f"radiance.{band}"]
                found[scene, band] = compare_images(record["table"], now, old, radiance, frames.get((scene, band)))
        return found

    def _conclude(self, comparisons: list[JsonObject], gates: list[JsonObject]) -> JsonObject:
        problems = [f"{name}: {error}" for name, error in self.failed.items()]
        if self.accepted is None:
            problems.append(f"no accepted baseline at {self.wanted.baseline}: nothing to compare with")
        for about in comparisons:
            if about.get("missing_scenes"):
                count = len(about["missing_scenes"])
                problems.append(f"{count} scenes of the baseline ({about['name']}) are not in the suite any more")
        verdicts = [Verdict(one["verdict"]) for one in [*gates, *self.anchors, *self.published]]
        if self.accepted is None:
            verdicts.append(Verdict.FAIL)
        verdict = night_verdict(verdicts)
        proven = any(Verdict(item["verdict"]) is Verdict.FAIL for item in [*gates, *self.anchors, *self.published])
        status = EXIT[verdict] if proven or not problems else INCOMPLETE
        if problems and not proven and verdict in (Verdict.PASS, Verdict.IMPROVED):
            # What was not looked at has not passed.
            verdict = Verdict.INCONCLUSIVE
        return {
            "schema": NIGHT_SCHEMA,
            "suite": self.suite.name,
            "night": self.wanted.night,
            "lanes": list(self.wanted.lanes),
            "verdict": str(verdict),
            "exit_status": status,
            "complete": not problems,
            "problems": problems,
            "environment": environment(),
            "comparisons": comparisons,
            "gates": gates,
            "anchors": self.anchors,
            "published": self.published,
            "fresh": {"night": self.wanted.night, "batches": self.batches, "scenes": _count(self.fresh)},
            "levels": _levels(self.all_rows() or self.replayed, self.fresh) | self._cost(),
        }

    def _cost(self) -> JsonObject:
        """Return speed and memory: followed from night to night, no gate, since they are a machine's and its load's."""
        found: JsonObject = {}
        if self.replay_s and self.replayed:
            n = len({(row.scene, row.band, row.replicate) for row in self.replayed})
            found["replay: time of an image"] = {"value": sum(self.replay_s) / n, "unit": "s", "n": n}
        if (peak := peak_mebibytes()) is not None:
            found["largest process: memory"] = {"value": peak, "unit": "MiB", "n": 1}
        return found

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


def _checked(suite: Suite) -> tuple[RegressionSpec, CasePlan]:
    if suite.regression is None:
        raise UserError(
            "has no [regression] table",
            where=suite.source,
            expected="a suite that declares gates",
            fix="scenes/suites/nightly.toml is one",
        )
    plan = plan_of(suite)
    together = [name for name in plan.estimators if plan.estimator(name).needs == "heads"]
    if together:
        raise UserError(
            f"estimator {together[0]!r} needs several heads at once",
            where=suite.estimators_key,
            expected="estimators that take one image",
        )
    if any(case.estimators is not None for case in suite.cases):
        raise UserError(
            "a table or frame has estimators of its own",
            where=suite.source,
            expected="one list for all frames, so that they can be compared",
        )
    return suite.regression, plan


def _content(case: Case) -> str:
    """Return what a frame is, but for the seed of what is random in its scene."""
    scene = case.scene.model_dump(mode="json")
    scene["scene"] = {**scene["scene"], "seed": 0}
    return json.dumps([scene, case.camera.model_dump(mode="json")], sort_keys=True)


def _is_same(a: Baseline, b: Baseline) -> bool:
    return bool(a.head["night"] == b.head["night"] and a.head["version"] == b.head["version"]) and (
        a.results.rows == b.results.rows
    )


def _reference(folder: Path, suite: str, night: str) -> GateInputs:
    """Return the fresh rows of another version's night."""
    from horizonval.store.folder import read_json

    data = read_json(folder / "night.json")
    if data is None:
        raise UserError("no night.json", where=str(folder), expected="the folder of another version's night")
    if (data["suite"], data["night"]) != (suite, night):
        raise UserError(
            f"is night {data['night']!r} of suite {data['suite']!r}",
            where=str(folder),
            expected=f"night {night!r} of {suite!r}",
            fix="give both runs the same --night",
        )
    return GateInputs(fresh=[ReplicateRow.from_dict(row) for row in data["fresh"]], fresh_night=data["night"])


def _check_folder(out: Path) -> None:
    """Refuse a folder that is neither new nor empty nor one of ours."""
    if not out.parent.is_dir():
        raise UserError("no such folder", where=str(out.parent), fix="create it first")
    if out.exists() and not out.is_dir():
        raise UserError("is a file", where=str(out), expected="a folder")
    ours = any((out / name).exists() for name in (WORK, "night.json", history.FILE))
    if out.is_dir() and any(out.iterdir()) and not ours:
        raise UserError("holds something else", where=str(out), expected="a new folder, or one of this command")


def _count(rows: Sequence[ReplicateRow]) -> int:
    return len({row.scene for row in rows})


def _levels(rows: Sequence[ReplicateRow], fresh: Sequence[ReplicateRow]) -> JsonObject:
    """Return the figures whose trend is followed: availability, false claims and median error, by estimator."""
    found: JsonObject = {}
    for lane, own in (("fixed", rows), ("fresh", fresh)):
        for estimator in sorted({row.estimator for row in own}):
            mine = [row for row in own if row.estimator == estimator]
            due = [row for row in mine if row.due]
            errors = [row.nadir_error_arcsec for row in mine if row.nadir_error_arcsec is not None]
            name = f"{lane} {estimator}"
            if due:
                share = sum(row.is_claim for row in due) / len(due)
                found[f"{name}: availability"] = {"value": 100.0 * share, "unit": "%", "n": len(due)}
            share = sum(row.false_valid for row in mine) / len(mine)
            found[f"{name}: false claims"] = {"value": 100.0 * share, "unit": "%", "n": len(mine)}
            if errors:
                median = float(np.median(errors))
                found[f"{name}: median nadir error"] = {"value": median, "unit": "arcsec", "n": len(errors)}
            over = [row.error_over_bound for row in mine if row.error_over_bound is not None]
            if over:
                found[f"{name}: median error over bound"] = {
                    "value": float(np.median(over)),
                    "unit": "1",
                    "n": len(over),
                }
    return found
