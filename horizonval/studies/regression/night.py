"""A night: run the lanes, compare, decide, and write it all down.

The folder of a night::

    verdict.json    everything decided, for machines
    junit.xml       the same for a CI service
    index.html      the same for people, with the trend of the last 60 nights
    night.json      rows and digests, from which `horizonval baseline accept` makes the next baseline
    history.jsonl   one line for every night that used this folder
    .work/          finished units; an interrupted night resumes from them
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import platform
import shutil
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import horizonval
from horizonval.core import atomic, files
from horizonval.core.code import code_version
from horizonval.core.errors import DamagedFileError, UserError, misfit
from horizonval.core.json_types import JsonObject
from horizonval.core.memory import peak_mebibytes
from horizonval.core.outcome import Outcome
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.engine import Record, do
from horizonval.jobs.pool import Execution
from horizonval.spec.load import Case, Suite
from horizonval.spec.suite import Lane, RegressionSpec
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.verify import withdraw_manifest, write_manifest
from horizonval.studies.regression import history
from horizonval.studies.regression.baseline import Baseline, baseline_at, release_path
from horizonval.studies.regression.fresh import judge_fresh
from horizonval.studies.regression.gates import GateInputs, judge_images, judge_rows
from horizonval.studies.regression.images import compare_images
from horizonval.studies.regression.partners import (
    Group,
    Pair,
    cameras_of,
    changed,
    missing,
    new,
    pairs_of,
    promise_of,
)
from horizonval.studies.regression.row import ReplicateRow, summary_of
from horizonval.studies.regression.statistics import Verdict
from horizonval.studies.regression.units import NightWork, Shown, Task, arrays_of, frozen_heads, shown, sweep
from horizonval.studies.regression.words import worst
from horizonval.suites.mistakes import check_heads
from horizonval.suites.plan import CasePlan, Unit, plan_of, units_of
from horizonval.suites.suite import load_suite

NIGHT_SCHEMA = 3
NightLane = Lane | Literal["published"]
LANES: tuple[NightLane, ...] = ("replay", "rerender", "fresh", "published")
WORK = ".work"
PUBLISHED = "published"
"""The lane without gates, and its folder in the work folder."""
Published = Callable[[Path, Progress], Sequence[JsonObject]]
"""Computes the key figures of published systems in a folder: ``{system, name, unit, accepted, measured, verdict}``."""
EXIT = {Verdict.PASS: 0, Verdict.IMPROVED: 0, Verdict.FAIL: 1, Verdict.INCOMPLETE: 2, Verdict.INCONCLUSIVE: 3}
MOST_CHANGES = 200
"""Changed scenes listed in the verdict; the count includes all."""
PACKAGES = (
    "mitsuba", "drjit", "karellen-llvm-core", "numpy", "scipy", "opencv-python-headless", "OpenEXR", "pyerfa",
)  # fmt: skip
"""Packages that affect the numbers."""


@dataclass(frozen=True)
class Wanted:
    """Request for a night.

    ``suite``: file or shipped name. ``night``: label, and seed of the fresh scenes: a date. ``reference``: folder of
    the same night by another version; fresh scenes are then compared in pairs.
    """

    suite: str
    out: Path
    baseline: Path
    night: str
    lanes: tuple[NightLane, ...] = LANES
    workers: int | None = None
    reference: Path | None = None


def seed_of_night(suite: str, night: str, batch: int) -> int:
    """Return the seed of a night's fresh scenes."""
    digest = hashlib.sha256(json.dumps(["fresh", suite, night, batch]).encode()).digest()
    return int.from_bytes(digest[:7], "big")


def checked(suite: Suite) -> tuple[RegressionSpec, CasePlan]:
    """Return the gates and plan of a nightly suite, after validation."""
    if suite.regression is None:
        raise UserError(
            "has no [regression] table",
            where=suite.source,
            expected="a suite that declares gates",
            fix="scenes/suites/nightly.toml is one",
        )
    # Every replicate has a separate row, so a run's common scoring of noise samples is off.
    plan = replace(plan_of(suite), draws=1)
    check_heads(suite, plan)
    return suite.regression, plan


def read_night(folder: Path) -> JsonObject:
    """Return the content of a night's ``night.json``. Raises ``UserError``: there is none, or it is damaged."""
    path = folder / "night.json"
    data = read_json(path)
    if data is None or data.get("schema") != NIGHT_SCHEMA:
        raise UserError(
            "no night.json of this version", where=str(folder), expected="the folder of `horizonval regress`"
        )
    try:
        return dict(data) | {key: [ReplicateRow.from_dict(row) for row in data[key]] for key in ("rows", "fresh")}
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        why = str(error) if isinstance(error, ValueError) else misfit(error)
        raise DamagedFileError(f"its rows cannot be used: {why}", where=str(path)) from None


def reference_of(folder: Path, suite: str, night: str) -> GateInputs:
    """Return the fresh rows of another version's night."""
    data = read_night(folder)
    if (data["suite"], data["night"]) != (suite, night):
        raise UserError(
            f"is night {data['night']!r} of suite {data['suite']!r}",
            where=str(folder),
            expected=f"night {night!r} of {suite!r}",
            fix="give both runs the same --night",
        )
    return GateInputs(fresh=data["fresh"], fresh_night=data["night"])


def check_folder(out: Path) -> None:
    """Refuse a folder that is neither new nor empty nor of nights."""
    ours = any((out / name).exists() for name in (WORK, "night.json", history.FILE))
    files.check_folder(out, ours=ours)


class Night:
    """Results of the lanes of one night."""

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
        self.published: list[JsonObject] = []
        self.replay_s: list[float] = []

    def work_first(self) -> None:
        """Run the tasks of every night."""
        self._do(self.first_tasks())

    def compute_published(self, compute: Published | None) -> None:
        """Recompute key figures of the published systems, if the suite requests it."""
        if compute is None or not self.spec.published or PUBLISHED not in self.wanted.lanes:
            return
        folder = self.wanted.out / WORK / PUBLISHED
        try:
            atomic.make_folder(folder)
            self.published = list(compute(folder, self._progress))
        except (UserError, RuntimeError) as error:
            self.failed[PUBLISHED] = str(error)
            return
        # An interrupted night resumes from it; a finished one needs it no longer.
        shutil.rmtree(folder)

    def first_tasks(self) -> dict[str, Task]:
        """Return the tasks of every night, by name."""
        tasks: dict[str, Task] = {}
        known: set[Shown] = set()
        if self.accepted is not None and "replay" in self.wanted.lanes:
            pack = self.accepted.images
            known |= {shown([image]) for image in pack.images}
            for about in self.accepted.together.values():
                known |= {shown(images.values()) for images in frozen_heads(pack, dict(about["heads"]))}
            tasks |= self._replay_tasks(self.accepted)
        if "rerender" in self.wanted.lanes:
            for unit in units_of(self.suite.cases, self.plan):
                task = self._render_task(f"rerender/{unit.name}", unit)
                tasks[task.name] = replace(task, replicates=self.spec.replicates, known=frozenset(known))
        if "fresh" in self.wanted.lanes:
            tasks |= self._fresh_tasks()
        return tasks

    def work_on_more_scenes(self) -> None:
        """Run another batch of fresh scenes."""
        self._do(self._fresh_tasks())

    def _fresh_tasks(self) -> dict[str, Task]:
        """Return another batch of fresh scenes: the Sobol tables under a seed of the night."""
        other = load_suite(self.wanted.suite, seed=seed_of_night(self.suite.name, self.wanted.night, self.batches))
        fixed = {content_of(case) for case in self.suite.cases}
        drawn = [case for case in other.cases if content_of(case) not in fixed]
        tasks = {}
        for unit in units_of(drawn, self.plan):
            task = self._render_task(f"fresh/{self.batches}/{unit.name}", unit)
            tasks[task.name] = replace(task, batch=self.batches)
        self.batches += 1
        return tasks

    def _render_task(self, name: str, unit: Unit) -> Task:
        return Task(name, unit.name, self._estimators_of(unit), unit=unit)

    def _replay_tasks(self, accepted: Baseline) -> dict[str, Task]:
        """Return the frozen images of every scene as tasks; the heads of a scene form one.

        The estimators are those of tonight's scene. A scene missing from the suite is replayed with the estimators of
        its rows, so that it counts as missing and not also as changed.
        """
        asked = {unit.name: self._estimators_of(unit) for unit in units_of(self.suite.cases, self.plan)}
        asked |= {case.name: self.plan.alone(case) for case in self.suite.cases if case.name not in asked}
        before: dict[str, set[str]] = {}
        for row in accepted.results.rows:
            before.setdefault(row.case, set()).add(row.estimator)
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
            name, sha256 = f"replay/{scene}", str(accepted.head["pack_sha256"])
            tasks[name] = Task(name, scene, names, pack=accepted.pack, pack_sha256=sha256, heads=members)
        return tasks

    def _estimators_of(self, unit: Unit) -> tuple[str, ...]:
        """Return the estimators of a unit, in the suite's order."""
        case = unit.cases[0]
        return self.plan.of(case) if unit.heads else self.plan.alone(case)

    def _do(self, tasks: Mapping[str, Task]) -> None:
        work = NightWork(self.plan, self.wanted.out / WORK)
        self.identities |= {work.identity(task) for task in tasks.values()}
        done = do(work, list(tasks.values()), Execution(self.wanted.workers), self._progress)
        for name, one in done.items():
            if tasks[name].unit is None and one.spent is not None:
                self.replay_s.append(one.spent.seconds)
            if one.result is None:
                self.failed[name] = one.error or "its result cannot be read"
            else:
                self._take(tasks[name], one.result, work.arrays(tasks[name]))

    def _take(self, task: Task, record: Record, arrays: Path) -> None:
        rows = [ReplicateRow.from_dict(row) for row in record["rows"]]
        if task.unit is None:
            assert self.accepted is not None
            about = {(row.case, row.band): row for row in self.accepted.results.rows}
            for row in rows:
                # A new scene has no partner for the comparison.
                before = about.get((row.case, row.band), row)
                due = {"expected": before.expected, "borderline": before.borderline}
                self.replayed.append(row.against(before.bound_arcsec, table=before.table, **due))
        elif task.batch is not None:
            self.fresh += [replace(row, case=f"{task.batch}/{row.case}") for row in rows]
        else:
            self.rows += rows
            self.scenes |= record["scenes"]
            self.together |= record["together"]
            self.arrays |= dict.fromkeys(record["scenes"], str(arrays))

    def all_rows(self) -> list[ReplicateRow]:
        """Return the rows on tonight's images: new ones, and those of the replay for unchanged images."""
        by_image = {(row.image_address, row.case, row.estimator): row for row in self.replayed}
        found = {row.key: row for row in self.rows}
        for scene, record in [*self.scenes.items(), *self.together.items()]:
            for band, about in record["bands"].items():
                due = about["expected"] == Outcome.VALID and not about["borderline"]
                own = {"table": record["table"], "expected": str(Outcome.VALID), "borderline": not due}
                for replicate, image in enumerate(about["images"]):
                    for estimator in self.plan.estimators:
                        row, key = by_image.get((image, scene, estimator)), (scene, band, replicate, estimator)
                        if key not in found and row is not None:
                            found[key] = row.against(about["bound_arcsec"], replicate=replicate, **own)
        return [found[key] for key in sorted(found)]

    def content(self) -> JsonObject:
        """Return the content of a baseline."""
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


def content_of(case: Case) -> str:
    """Return the content of a frame without the seed of its scene."""
    scene = case.scene.model_dump(mode="json")
    scene["scene"] = {**scene["scene"], "seed": 0}
    return json.dumps([scene, case.camera.model_dump(mode="json")], sort_keys=True)


def compare(
    night: Night, release: Baseline | None, reference: GateInputs | None
) -> tuple[list[JsonObject], list[JsonObject]]:
    """Return the comparison of a night with each of its baselines, and the verdict of every gate."""
    comparisons: list[JsonObject] = []
    gates: list[JsonObject] = []
    for name, base in (("accepted", night.accepted), ("release", release)):
        if base is None:
            continue
        if name == "release" and night.accepted is not None and _is_same(base, night.accepted):
            comparisons.append({"name": name, "baseline": base.label, "same_as_accepted": True, "changed": []})
            continue
        about, found = _against(night, name, base, reference if name == "accepted" else None)
        comparisons.append(about)
        gates += found
    return comparisons, gates


def _against(
    night: Night, name: str, base: Baseline, reference: GateInputs | None
) -> tuple[JsonObject, list[JsonObject]]:
    lanes, spec = night.wanted.lanes, night.spec
    cameras = cameras_of(base.scenes, base.together)
    images = _images(night, base)
    moved: list[JsonObject] = []
    replay_pairs: list[Pair] = []
    gates: list[JsonObject] = []
    if name == "accepted" and "replay" in lanes:
        replay_pairs = pairs_of(night.replayed, base.results.rows)
        moved = changed(replay_pairs)
        gates += judge_rows(spec, "replay", replay_pairs, cameras)
    if "rerender" in lanes:
        gates += judge_images(spec, images, cameras, name)
        pairs = pairs_of(night.all_rows(), base.results.rows)
        if replay_pairs:
            # Answers to the images that are the same are in the replay.
            pairs = [(now, before) for now, before in pairs if now.image_address != before.image_address]
        gates += judge_rows(spec, "rerender", pairs, cameras, name)
    elif name == "release":
        gates += judge_rows(spec, "replay", pairs_of(night.replayed, base.results.rows), cameras, name)
    if name == "release" and night.accepted is not None:
        _leave_accepted(
            gates, judge_rows(spec, "rerender", pairs_of(night.accepted.results.rows, base.results.rows), cameras)
        )
    if "fresh" in lanes and name == "accepted":
        theirs = base.results if reference is None else reference
        if theirs.fresh_night == night.wanted.night:
            # The same scenes by another version: facts, with the margins of facts.
            gates += [
                gate | {"lane": "fresh"}
                for gate in judge_rows(spec, "rerender", pairs_of(night.fresh, theirs.fresh), cameras)
            ]
        else:
            gates += judge_fresh(spec, night.fresh, theirs.fresh, cameras)
    other = [
        {"scene": scene, "band": band, **{key: value for key, value in image.items() if key != "table"}}
        for (scene, band), image in images.items()
        if not image["same_radiance"] or image["same_images"] < image["n_images"]
    ]
    about = {
        "name": name,
        "baseline": base.label,
        "reason": base.head["reason"],
        "covers": base.head.get("covers", []),
        "environment": base.head["environment"],
        "same_as_accepted": False,
        "replayed": len(replay_pairs),
        "n_changed": len(moved),
        "changed": moved[:MOST_CHANGES],
        "rendered": len(images),
        "n_images_changed": len(other),
        "images_changed": other[:MOST_CHANGES],
    }
    return about, gates


def _leave_accepted(gates: list[JsonObject], accepted: Sequence[JsonObject]) -> None:
    """Pass what changed since the last release and was accepted with a reason."""
    failed = {_about(gate) for gate in accepted if gate["verdict"] == Verdict.FAIL}
    for gate in gates:
        if gate["verdict"] == Verdict.FAIL and _about(gate) in failed:
            gate["verdict"] = str(Verdict.PASS)
            gate["reason"] = "accepted with a reason since the last release"


def _about(gate: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(gate[key] for key in ("metric", *Group._fields))


def _images(night: Night, base: Baseline) -> dict[tuple[str, str], JsonObject]:
    frames = {(frame.scene, frame.band): frame for frame in base.images.frames}
    found = {}
    for scene, record in night.scenes.items():
        before = base.scenes.get(scene)
        for band, now in record["bands"].items():
            if before is None or band not in before["bands"]:
                continue
            old = before["bands"][band]
            radiance = None
            if now["radiance_sha256"] != old["radiance_sha256"]:
                radiance = arrays_of(Path(night.arrays[scene]), scene)[f"radiance.{band}"]
            found[scene, band] = compare_images(record["table"], now, old, radiance, frames.get((scene, band)))
    return found


def _is_same(a: Baseline, b: Baseline) -> bool:
    return bool(a.head["night"] == b.head["night"] and a.head["version"] == b.head["version"]) and (
        a.results.rows == b.results.rows
    )


def verdict_of(night: Night, release: Baseline | None, reference: GateInputs | None) -> JsonObject:
    """Return the verdict; add batches of fresh scenes while their gates are inconclusive."""
    while True:
        comparisons, gates = compare(night, release, reference)
        undecided = any(g["lane"] == "fresh" and g["verdict"] == Verdict.INCONCLUSIVE for g in gates)
        more = undecided and night.accepted is not None and reference is None and "fresh" in night.wanted.lanes
        if not more or night.batches >= night.spec.most_batches:
            break
        night.work_on_more_scenes()
    return _conclude(night, comparisons, gates)


def _conclude(night: Night, comparisons: list[JsonObject], gates: list[JsonObject]) -> JsonObject:
    """Return the verdict: a regression, else incomplete, else that of the facts; without any, that of other scenes."""
    problems, notes = _partners(night)
    facts = [Verdict(one["verdict"]) for one in [*gates, *night.published] if one.get("lane") != "fresh"]
    fresh = [Verdict(one["verdict"]) for one in gates if one["lane"] == "fresh"]
    if night.accepted is not None and not facts and not fresh:
        problems.append("nothing was compared")
    verdict = worst(facts or fresh)
    if Verdict.FAIL in fresh:
        verdict = Verdict.FAIL
    if problems and verdict is not Verdict.FAIL:
        verdict = Verdict.INCOMPLETE
    status = EXIT[verdict]
    return {
        "schema": NIGHT_SCHEMA,
        "suite": night.suite.name,
        "night": night.wanted.night,
        "lanes": list(night.wanted.lanes),
        "verdict": str(verdict),
        "exit_status": status,
        "complete": not problems,
        "problems": problems,
        "notes": notes,
        "environment": environment(),
        "comparisons": comparisons,
        "gates": gates,
        "published": night.published,
        "fresh": {
            "night": night.wanted.night,
            "batches": night.batches,
            "scenes": len({row.case for row in night.fresh}),
            "verdict": str(worst(fresh)) if fresh else None,
        },
        "levels": levels_of(night.all_rows() or night.replayed, night.fresh) | _cost(night),
    }


def _partners(night: Night) -> tuple[list[str], list[str]]:
    """Return what leaves a night incomplete, and what else it did not compare."""
    problems = [f"{name}: {error}" for name, error in night.failed.items()]
    base = night.accepted
    if base is None:
        return [*problems, f"no accepted baseline at {night.wanted.baseline}: nothing to compare with"], []
    promise = promise_of(night.suite, night.plan, night.spec.replicates)
    answered = {row.key for row in night.replayed} if "replay" in night.wanted.lanes and not night.failed else None
    problems += missing(promise, base.results.rows, cameras_of(base.scenes, base.together), answered)
    notes = new(promise, base.results.rows, base.scenes)
    silent = sum(row.nadir_error_arcsec is not None and not row.states_altitude for row in base.results.rows)
    if silent:
        notes.append(
            f"the baseline does not hold sigma and altitude of {silent} claims: they are compared once a new one is "
            "accepted"
        )
    if "fresh" in night.wanted.lanes and not night.fresh and not night.failed:
        notes.append("no scene was drawn anew: the suite has no Sobol table")
    return problems, notes


def _cost(night: Night) -> JsonObject:
    """Return speed and memory, without a gate, because they depend on the machine and its load."""
    found: JsonObject = {}
    if night.replay_s and night.replayed:
        n = len({(row.case, row.band, row.replicate) for row in night.replayed})
        found["replay: time of an image"] = {"value": sum(night.replay_s) / n, "unit": "s", "n": n}
    if (peak := peak_mebibytes()) is not None:
        found["largest process: memory"] = {"value": peak, "unit": "MiB", "n": 1}
    return found


def levels_of(rows: Sequence[ReplicateRow], fresh: Sequence[ReplicateRow]) -> JsonObject:
    """Return the figures of the trend: availability, false claims and median errors, by estimator."""
    return {
        f"{lane} {estimator}: {name}": {"value": value, "unit": unit, "n": n}
        for lane, own in (("fixed", rows), ("fresh", fresh))
        for estimator in sorted({row.estimator for row in own})
        for name, (value, unit, n) in summary_of([row for row in own if row.estimator == estimator]).items()
    }


def environment() -> dict[str, Any]:
    """Return versions and kinds of the environment, without paths or machine names."""
    from horizonval.renderer.backend import probe

    chosen = probe().chosen
    return {
        "version": code_version(),
        "commit": _commit(),
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "packages": {name: _version(name) for name in PACKAGES},
        "variant": None if chosen is None else chosen.variant,
        "processor_flags": _flags(),
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _commit() -> str | None:
    """Return the commit of the running checkout, with ``-dirty`` if files differ; None without one."""
    folder = Path(horizonval.__file__).parent.parent
    if not (folder / ".git").exists():
        return None
    try:
        made = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=30,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return made.stdout.strip() or None


def _flags() -> list[str]:
    """Return the processor's vector extensions, which affect the compilation of kernels."""
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="ascii", errors="replace")
    except OSError:
        return []
    line = next((line for line in text.splitlines() if line.startswith("flags")), "")
    return sorted(flag for flag in line.partition(":")[2].split() if flag.startswith(("avx", "fma", "sse4")))


def run_night(wanted: Wanted, progress: Progress | None = None, published: Published | None = None) -> JsonObject:
    """Run a night and return the content of ``verdict.json``; ``published`` does the lane of that name, if any.

    Raises ``UserError``: a mistake in the suite or the baseline's files, no ``[regression]`` table, a folder in which
    another night runs, or no back-end.
    """
    from horizonval.renderer.backend import probe
    from horizonval.studies.regression.page import of_baseline, of_night, write_junit, write_page

    suite = load_suite(wanted.suite)
    spec, plan = checked(suite)
    accepted = baseline_at(wanted.baseline, suite.name)
    release = None if accepted is None else baseline_at(release_path(wanted.baseline), suite.name)
    reference = None if wanted.reference is None else reference_of(wanted.reference, suite.name, wanted.night)
    if probe().chosen is None:
        raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    check_folder(wanted.out)
    atomic.make_folder(wanted.out / WORK)
    folder = RunFolder(wanted.out / WORK)
    with folder.locked():
        withdraw_manifest(wanted.out)
        for path in atomic.leftovers(wanted.out / WORK, below=False):
            path.unlink(missing_ok=True)
        night = Night(suite, spec, plan, wanted, accepted, progress or Silent())
        night.work_first()
        night.compute_published(published)
        verdict = verdict_of(night, release, reference)
        write_json(wanted.out / "night.json", night.content(), indent=None)
        # The folder must not grow from night to night.
        sweep(wanted.out / WORK, night.identities)
        history.append(wanted.out / history.FILE, verdict)
        verdict["trend"] = history.steps_of(history.read(wanted.out / history.FILE))
        write_json(wanted.out / "verdict.json", verdict)
        write_junit(wanted.out / "junit.xml", verdict)
        seen = None
        if night.scenes:
            seen = of_night(night.all_rows(), night.scenes, night.arrays)
        elif accepted is not None:
            seen = of_baseline(accepted, night.replayed)
        write_page(wanted.out / "index.html", verdict, history.read(wanted.out / history.FILE), seen)
        pages = [wanted.out / name for name in ("night.json", "verdict.json", "junit.xml", "index.html", history.FILE)]
        units = [wanted.out / WORK / f"{name}{end}" for name in night.identities for end in (".json", ".npz")]
        write_manifest(wanted.out, [*pages, *units])
    return verdict


def planned(wanted: Wanted) -> tuple[Suite, NightWork, list[Task]]:
    """Return the first tasks of a night without running them. Errors as :func:`run_night`."""
    suite = load_suite(wanted.suite)
    spec, plan = checked(suite)
    accepted = baseline_at(wanted.baseline, suite.name)
    night = Night(suite, spec, plan, wanted, accepted, Silent())
    return suite, NightWork(plan, wanted.out / WORK), list(night.first_tasks().values())
