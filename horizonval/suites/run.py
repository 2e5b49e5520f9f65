"""Run a suite: every case to its result, then the summary, the table and the report.

The folder can be handed to the same command again at any time, whatever ended the last run: finished cases are kept,
unfinished ones are made, and the outcome is the same bytes as of a run that was never cut off.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from horizonval.core.code import code_version
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress, Silent
from horizonval.jobs.pool import available_cpus, run_cases
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.store.index import Index
from horizonval.suites.axes import figure_plans
from horizonval.suites.case import Brief, finished, give_up, run_unit
from horizonval.suites.check import check_suite
from horizonval.suites.identity import suite_identity
from horizonval.suites.plan import CasePlan, Unit, plan_of, shard_of, units_of
from horizonval.suites.shards import adopt
from horizonval.suites.stability import StudyOutcome, run_stability
from horizonval.suites.suite import load_suite

RUN_SCHEMA = 1


@dataclass(frozen=True)
class RunResult:
    """What a run made.

    Attributes
    ----------
    summary : dict
        The content of ``summary.json``; empty as long as other shards are missing.
    failed : dict
        Cases without a result, by name, and why; those of a study as ``stability/<name>``.
    report : Path or None
        The report's first page.
    missing : int
        Cases that other shards have yet to make.
    """

    summary: dict[str, Any]
    failed: dict[str, str]
    report: Path | None
    missing: int = 0


@dataclass(frozen=True)
class Where:
    """Where the work is done.

    Attributes
    ----------
    workers : int, optional
        Processes on this machine; :func:`default_workers` by default. The number does not change any result.
    shard : (int, int), optional
        (i, n): only every n-th unit of the suite, from the i-th on. Shards can share a folder, also at the same time.
    dask : str, optional
        Address of a Dask scheduler, or ``local:N``; its workers must see the run's folder.
    merge : tuple of Path
        Folders of other runs of this suite, whose results are taken over.
    """

    workers: int | None = None
    shard: tuple[int, int] | None = None
    dask: str | None = None
    merge: tuple[Path, ...] = field(default=())


def run_suite(
    suite: Suite,
    out_dir: Path,
    workers: int | None = None,
    progress: Progress | None = None,
    where: Where | None = None,
) -> RunResult:
    """Run a suite into a folder, or finish what an earlier run left there.

    Parameters
    ----------
    suite : Suite
    out_dir : Path
        Made if need be.
    workers : int, optional
        Short for ``Where(workers)``.
    progress : Progress, optional
    where : Where, optional

    Raises
    ------
    UserError
        A mistake in the suite (told before anything is rendered), no back-end to render with, a folder that holds
        another suite's run or in which another run is working.
    """
    progress = progress or Silent()
    where = where or Where(workers)
    plan = plan_of(suite)
    check_suite(suite, plan)
    units = units_of(suite.cases, plan)
    folder = RunFolder(out_dir)
    folder.create(stability=suite.stability is not None)
    with folder.locked(where.shard):
        _claim(folder, suite, units)
        if where.shard is None:
            # Shards may be at work beside each other: what is temporary may be theirs.
            folder.remove_temporary_files()
        for other in where.merge:
            adopt(RunFolder(other), folder, suite)
        seconds: dict[str, dict[str, float]] = {}
        try:
            briefs = _run_units(shard_of(units, where.shard), plan, folder, where, progress, seconds)
        except BaseException:
            # The times of what is finished cannot be had again.
            _add_timings(folder, seconds, where.shard)
            raise
        if where.shard is not None:
            _add_timings(folder, seconds, where.shard)
            missing = sum(not folder.case(name).is_file() for unit in units for name in unit.names)
            failed = {name: brief.error for name, brief in briefs.items() if brief.error is not None}
            return RunResult({}, failed, None, missing)
        study: StudyOutcome | None = None
        if suite.stability is not None:
            study = run_stability(suite.stability, folder, where.workers or default_workers(), progress)
        folder.remove_temporary_files()
        return _conclude(suite, units, folder, briefs, seconds, study)


def default_workers() -> int:
    """Return the number of processes to use: one per processor, as most stages run on a single one."""
    return available_cpus()


def _claim(folder: RunFolder, suite: Suite, units: Sequence[Unit]) -> None:
    """Write down which suite this folder belongs to; refuse if it belongs to another.

    A study's frames may change with its designs, and the number of frames that a suite draws: every case is known by
    its own identity, and kept if that is the same. What is no frame of the suite any more stays, and counts nowhere.
    """
    identity = suite_identity(suite)
    before = read_json(folder.suite)
    if before is not None and before.get("suite_sha256") != identity and not _may_go_on(before, suite):
        other = before.get("suite")
        same = "other frames, cameras or estimators of " if other == suite.name else ""
        raise UserError(
            f"holds a run of {same}suite {other!r}",
            where=str(folder.root),
            expected=f"a new folder, or a run of {suite.name!r} as it is now",
            fix="choose another --out, or delete this folder",
        )
    write_json(
        folder.suite,
        {
            "schema": RUN_SCHEMA,
            "suite": suite.name,
            "title": suite.title,
            "suite_sha256": identity,
            "version": code_version(),
            "estimators": list(suite.estimators),
            "cases": [name for unit in units for name in unit.names],
            "keep": suite.keep,
            "figures": figure_plans(suite),
            "study": suite.study,
            "frames": suite.frames,
        },
    )


def _may_go_on(before: Mapping[str, Any], suite: Suite) -> bool:
    """Whether a folder of other frames is one of the same study, or of a suite that differs in ``frames`` alone."""
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
    where: Where,
    progress: Progress,
    seconds: dict[str, dict[str, float]],
) -> dict[str, Brief]:
    """Make what is missing of the units and return what became of all; the times that it took go into ``seconds``."""
    from horizonval.renderer.plugin.backend import probe

    briefs: dict[str, Brief] = {}
    missing = []
    for unit in units:
        found = finished(unit, plan, folder)
        if found is None:
            missing.append(unit)
        else:
            briefs |= found
    total = sum(len(unit.cases) for unit in units)
    progress.start(total, total - sum(len(unit.cases) for unit in missing))
    if not missing:
        return briefs
    work = partial(run_unit, plan=plan, folder=folder)
    if where.dask is not None:
        from horizonval.suites.cluster import run_on_cluster

        results = run_on_cluster(work, missing, where.dask, folder)
    else:
        if probe().chosen is None:
            raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
        results = run_cases(work, missing, where.workers or default_workers())
    with contextlib.closing(results):
        for unit, result in results:
            if result is None:
                limit = plan.frame_limit_s * len(unit.cases)
                why = f"the worker process died (out of memory, a crash, or more than {limit:g} s)"
                made = give_up(unit, plan, folder, why)
            else:
                made, seconds[unit.name] = result
            briefs |= made
            for name in unit.names:
                if name != unit.name or not unit.heads:
                    progress.done(name, failed=made[name].error)
    return briefs


def _conclude(
    suite: Suite,
    units: Sequence[Unit],
    folder: RunFolder,
    briefs: dict[str, Brief],
    seconds: dict[str, dict[str, float]],
    study: StudyOutcome | None,
) -> RunResult:
    from horizonval.report import build_report
    from horizonval.scoring.summary import summarise
    from horizonval.scoring.table import write_results

    start = time.perf_counter()
    ordered = {name: briefs[name] for unit in units for name in unit.names}
    failed = {name: brief.error for name, brief in ordered.items() if brief.error is not None}
    rows = [row for brief in ordered.values() for row in brief.rows]
    summary = {"suite": suite.name, "version": code_version(), "failed": dict(failed), **summarise(rows)}
    if study is not None:
        failed |= {f"stability/{name}": why for name, why in study.failed.items()}
        summary["stability"] = study.digest
        seconds = seconds | {f"stability/{name}": {"march": spent} for name, spent in study.seconds.items()}
    write_results(rows, folder.results)
    write_json(folder.summary, summary)
    with contextlib.suppress(UserError):  # An index that cannot be written is made by whoever asks for it.
        Index(folder.archive).update()
    report = build_report(folder.root)
    _add_timings(folder, seconds, conclude=round(time.perf_counter() - start, 4))
    return RunResult(summary, failed, report)


def _add_timings(
    folder: RunFolder,
    seconds: dict[str, dict[str, float]],
    shard: tuple[int, int] | None = None,
    conclude: float | None = None,
) -> None:
    """Add seconds to what earlier runs left; every shard has a file of its own."""
    path = folder.timings if shard is None else folder.shard_timings(shard)
    timings = read_json(path) or {}
    cases = {**timings.get("cases", {}), **seconds}
    write_json(path, {"cases": cases, **({} if conclude is None else {"conclude": conclude})})
