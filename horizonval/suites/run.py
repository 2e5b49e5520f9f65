"""Run a suite: every case to its result, then the summary, the table and the report.

The same command resumes an interrupted run: finished cases stay, and the result has the same bytes.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core.code import code_version
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.engine import Done, OnStart, Record, stream, take_over
from horizonval.jobs.pool import Execution
from horizonval.scoring import requirements
from horizonval.scoring.row import Row
from horizonval.spec.load import Suite
from horizonval.store.entry import INDEX_PREFIX
from horizonval.store.folder import RunFolder, intact_json, read_json, write_json
from horizonval.store.index import Index
from horizonval.store.verify import files_of_run, withdraw_manifest, write_manifest
from horizonval.suites.identity import suite_identity
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import CasePlan, Unit, plan_of, units_of
from horizonval.suites.record import command_of_suite, figure_plans
from horizonval.suites.stability import run_stability
from horizonval.suites.suite import load_suite
from horizonval.suites.units.scored import PROCESSOR
from horizonval.suites.units.work import Brief, UnitWork
from horizonval.suites.worker_memory import within_memory


def conclude(
    folder: RunFolder,
    suite: str | None,
    rows: Sequence[Row],
    failed: Mapping[str, str],
    more: Mapping[str, Any] | None = None,
) -> tuple[dict[str, Any], list[Path]]:
    """Write table, summary and report; return the summary and the report's pages, the first one first.

    ``failed``: reasons by case. ``more``: additional content of the summary.
    """
    from horizonval.report.build import write_report
    from horizonval.scoring.row import write_results
    from horizonval.scoring.summary import summarise

    about = read_json(folder.suite) or {}
    statistics = summarise(
        rows, about.get("given_pose") or (), frozenset(about.get("orbit") or ()), about.get("likelihood") or ()
    )
    summary = {
        "suite": suite,
        "version": code_version(),
        "failed": dict(failed),
        "prior": about.get("prior"),
        **statistics,
        **(more or {}),
    }
    write_results(rows, folder.results)
    write_json(folder.summary, summary)
    return summary, write_report(folder.root)


ROOMS = ("archive", "cases", "state", "stability")


def adopt(source: RunFolder, target: RunFolder, suite: Suite) -> None:
    """Copy missing results from another run of the same suite.

    They are validated like the folder's own files. The archive's index is not copied but updated from the files. Raises
    ``UserError``: ``source`` is not a run of this suite.
    """
    run = read_json(source.suite)
    if run is None:
        raise UserError("no run.json", where=str(source.root), expected="the folder of a run")
    if run.get("suite_sha256") != suite_identity(suite):
        raise UserError(
            f"holds a run of other frames, cameras or estimators (suite {run.get('suite')!r})",
            where=str(source.root),
            expected=f"a run of {suite.name!r} as it is now",
        )
    take_over(source.root, target.root, ROOMS, lambda path: not path.name.startswith((".", INDEX_PREFIX)))


RUN_SCHEMA = 1


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    ``summary``: content of ``summary.json``; empty while other shards are missing. ``failed``: reasons by case, and by
    ``stability/<month>``. ``report``: the first page, or None. ``missing``: cases of other shards.
    """

    summary: dict[str, Any]
    failed: dict[str, str]
    report: Path | None
    missing: int = 0


def run_suite(
    suite: Suite,
    out_dir: Path,
    progress: Progress | None = None,
    execution: Execution | None = None,
    on_start: OnStart | None = None,
    also: Callable[[], Iterable[Path]] | None = None,
) -> RunResult:
    """Run a suite into a folder, or resume.

    Raises ``UserError``: a mistake in the suite, found before rendering; too little memory for frames or workers, no
    back-end, a folder with another suite's run or an active one.

    Parameters
    ----------
    on_start : callable, optional
        Called once before the first frame, unless all frames are finished. May return the expected times of the frames
        by case.
    also : callable, optional
        Called at the end to make more of the results; returns the files that it made.
    """
    progress = progress or Silent()
    execution = execution or Execution()
    plan = plan_of(suite)
    refuse_mistakes(suite, plan)
    execution = within_memory(execution, suite)
    units = units_of(suite.cases, plan)
    folder = RunFolder(out_dir)
    folder.create(stability=suite.stability is not None)
    with folder.locked(execution.shard):
        _claim(folder, suite, plan, units)
        if execution.shard is None:
            # Temporary files may belong to concurrent shards.
            folder.remove_temporary_files()
        for other in execution.merge:
            adopt(RunFolder(other), folder, suite)
        seconds: dict[str, Mapping[str, float]] = {}
        try:
            briefs = _run_units(units, plan, folder, execution, progress, seconds, on_start)
        except BaseException:
            # Times of finished work cannot be measured again.
            _add_timings(folder, seconds, execution.shard)
            raise
        if execution.shard is not None:
            _add_timings(folder, seconds, execution.shard)
            missing = sum(not folder.case(name).is_file() for unit in units for name in unit.names)
            failed = {name: brief.error for name, brief in briefs.items() if brief.error is not None}
            return RunResult({}, failed, None, missing)
        study: tuple[JsonObject | None, Mapping[str, Done[Record]]] = (None, {})
        if suite.stability is not None:
            study = run_stability(suite.stability, folder, execution, progress)
        folder.remove_temporary_files()
        return _conclude(suite, units, folder, briefs, seconds, study, also)


def _claim(folder: RunFolder, suite: Suite, plan: CasePlan, units: Sequence[Unit]) -> None:
    """Record the suite of this folder; refuse a folder of another one.

    The frames of a study and the number of a suite's frames may change: every case has its identity. Frames that no
    longer belong to the suite stay but do not count.
    """
    identity = suite_identity(suite)
    before = intact_json(folder.suite)
    # Without run.json the summary still identifies the suite.
    lost = {} if before is not None else intact_json(folder.summary) or {}
    if lost.get("suite", suite.name) != suite.name:
        before = lost
    if before is not None and before.get("suite_sha256") != identity and not _may_go_on(before, suite):
        other = before.get("suite")
        same = "other frames, cameras or estimators of " if other == suite.name else ""
        raise UserError(
            f"holds a run of {same}suite {other!r}",
            where=str(folder.root),
            expected=f"a new folder, or a run of {suite.name!r} as it is now",
            fix="choose another --out, or delete this folder",
        )
    withdraw_manifest(folder.root)
    write_json(
        folder.suite,
        {
            "schema": RUN_SCHEMA,
            "suite": suite.name,
            "title": suite.title,
            "suite_sha256": identity,
            "version": code_version(),
            "command": command_of_suite(suite, folder.root),
            "estimators": list(suite.estimators),
            "programs": [program.name for program in suite.programs],
            "given_pose": [name for name in suite.estimators if plan.estimator(name).needs == "pose"],
            "likelihood": [name for name in suite.estimators if plan.estimator(name).claim == "likelihood"],
            "prior": _common_prior(suite),
            "cases": [name for unit in units for name in unit.names],
            "orbit": [name for unit in units if unit.cases[0].sample for name in unit.names],
            "heads": {unit.name: [[case.head, case.name] for case in unit.cases] for unit in units if unit.heads},
            "keep": suite.keep,
            "figures": figure_plans(suite),
            "study": suite.study,
            "frames": suite.frames,
        },
    )


def _common_prior(suite: Suite) -> JsonObject | None:
    """Return the table ``[prior]`` that all frames of a suite have, or None."""
    priors = [case.scene.prior for case in suite.cases]
    first = priors[0] if priors else None
    if first is None or any(one != first for one in priors):
        return None
    return first.model_dump(mode="json", exclude_none=True)


def _may_go_on(before: Mapping[str, Any], suite: Suite) -> bool:
    """Whether a folder's frames belong to the same study, or to a suite that differs only in ``frames``."""
    frames = before.get("frames")
    if before.get("suite") != suite.name:
        return False
    if suite.study:
        return bool(before.get("study"))
    if suite.frames is None or not isinstance(frames, int):
        return False
    try:
        other = load_suite(suite.source, frames, suite.seed)
    except UserError:
        return False
    return suite_identity(replace(other, keep=suite.keep)) == before.get("suite_sha256")


def _run_units(
    units: Sequence[Unit],
    plan: CasePlan,
    folder: RunFolder,
    execution: Execution,
    progress: Progress,
    seconds: dict[str, Mapping[str, float]],
    on_start: OnStart | None,
) -> dict[str, Brief]:
    """Make the missing units and return the outcomes of all; add the times to ``seconds``."""
    briefs: dict[str, Brief] = {}
    for unit, done in stream(UnitWork(plan, folder), units, execution, progress, on_start=on_start):
        if done.result is None:
            raise UserError(f"{unit.name}: {done.error}", where=str(folder.root), fix="mend it, and run again")
        briefs |= done.result
        if done.seconds:
            seconds[unit.name] = done.seconds
    return briefs


def _conclude(
    suite: Suite,
    units: Sequence[Unit],
    folder: RunFolder,
    briefs: Mapping[str, Brief],
    seconds: Mapping[str, Mapping[str, float]],
    study: tuple[JsonObject | None, Mapping[str, Done[Record]]],
    also: Callable[[], Iterable[Path]] | None,
) -> RunResult:
    start = time.perf_counter()
    ordered = {name: briefs[name] for unit in units for name in unit.names}
    failed = {name: brief.error for name, brief in ordered.items() if brief.error is not None}
    rows = [row for brief in ordered.values() for row in brief.rows]
    Index(folder.archive).update()
    stability, months = study
    judged = _judge(suite, rows, folder, seconds) if suite.requirements else []
    summary, pages = conclude(folder, suite.name, rows, failed, {"stability": stability} if months else {})
    failed |= {f"stability/{month}": one.error for month, one in months.items() if one.error is not None}
    seconds = {**seconds, **{f"stability/{month}": one.seconds for month, one in months.items() if one.seconds}}
    _add_timings(folder, seconds, conclude=round(time.perf_counter() - start, 4))
    records = [place(name) for name in ordered for place in (folder.case, folder.frame_pointer)]
    made = [folder.stability_case(month) for month in months] + (
        [folder.stability / "result.json"] if stability else []
    )
    made += [*judged, *(also() if also else ())]
    write_manifest(folder.root, [*files_of_run(folder), *records, *made, *pages])
    return RunResult(summary, failed, pages[0])


def _judge(
    suite: Suite, rows: Sequence[Row], folder: RunFolder, seconds: Mapping[str, Mapping[str, float]]
) -> list[Path]:
    """Judge the suite's requirements by camera and method, and write the verdicts; return the files."""
    timings = {**(intact_json(folder.timings) or {}).get("cases", {}), **seconds}
    flights = {case.name: f"{case.table}/{case.variant}" for case in suite.cases if case.sample}
    # A single flight gives no variation between flights: results hold for it alone.
    flights = flights if len(set(flights.values())) > 1 else {}
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(f"{row.camera}, {row.estimator}", []).append(row)
    answers = {}
    for name in sorted(groups):
        own = groups[name]
        bands = Counter(row.case for row in own)
        stages = [timings.get(row.case, {}).get(PROCESSOR + row.estimator, math.nan) for row in own]
        _, cluster = np.unique([flights.get(row.case, row.case) for row in own], return_inverse=True)
        spent = np.array(stages, dtype=np.float64) / [bands[row.case] for row in own]
        answers[name] = requirements.Answers(cluster=cluster, seconds=spent, **requirements.columns_of(own))
    return requirements.write(folder.root, suite.name, requirements.judged(suite.requirements, answers))


def _add_timings(
    folder: RunFolder,
    seconds: Mapping[str, Mapping[str, float]],
    shard: tuple[int, int] | None = None,
    conclude: float | None = None,
) -> None:
    """Add seconds to those of earlier runs; every shard has a separate file."""
    path = folder.timings if shard is None else folder.shard_timings(shard)
    timings = intact_json(path) or {}
    cases = {**timings.get("cases", {}), **seconds}
    write_json(path, {"cases": cases, **({} if conclude is None else {"conclude": conclude})})
