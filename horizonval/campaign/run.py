"""Run a suite: every case to its result, then the summary, the table and the report.

The folder can be handed to the same command again at any time, whatever ended the last run: finished cases are kept,
unfinished ones are made, and the outcome is the same bytes as of a run that was never cut off.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from horizonval.campaign.case import Record, failed_record, finished_record, run_case
from horizonval.campaign.folder import RunFolder, read_json, write_json
from horizonval.campaign.identity import code_version, suite_identity
from horizonval.campaign.pool import available_cpus, run_cases
from horizonval.campaign.progress import Progress, Silent
from horizonval.campaign.stability import StudyOutcome, check_stability, run_stability
from horizonval.errors import UserError
from horizonval.spec.load import Suite

RUN_SCHEMA = 1


@dataclass(frozen=True)
class RunResult:
    """What a run made.

    Attributes
    ----------
    summary : dict
        The content of ``summary.json``.
    failed : dict
        Cases without a result, by name, and why; those of a study as ``stability/<name>``.
    report : Path
        The report's first page.
    """

    summary: dict[str, Any]
    failed: dict[str, str]
    report: Path


def run_suite(suite: Suite, out_dir: Path, workers: int | None = None, progress: Progress | None = None) -> RunResult:
    """Run a suite into a folder, or finish what an earlier run left there.

    Parameters
    ----------
    suite : Suite
    out_dir : Path
        Made if need be.
    workers : int, optional
        Processes; :func:`default_workers` by default. The number does not change any result.
    progress : Progress, optional

    Raises
    ------
    UserError
        A mistake in the suite (told before anything is rendered), no back-end to render with, a folder that holds
        another suite's run or in which another run is working.
    """
    progress = progress or Silent()
    check_suite(suite)
    folder = RunFolder(out_dir)
    folder.create(stability=suite.stability is not None)
    with folder.locked():
        _claim(folder, suite)
        folder.remove_temporary_files()
        records, seconds = _run_cases(suite, folder, workers, progress)
        study: StudyOutcome | None = None
        if suite.stability is not None:
            study = run_stability(suite.stability, folder, workers or default_workers(), progress)
        folder.remove_temporary_files()
        return _conclude(suite, folder, records, seconds, study)


def default_workers() -> int:
    """Return the number of processes to use: one per processor, as most stages run on a single one."""
    return available_cpus()


def check_suite(suite: Suite) -> None:
    """Find mistakes that the files' models cannot know: estimators, atmospheres, detectors, positions.

    Raises
    ------
    UserError
        Naming the suite, the frame and the key.
    """
    from horizonval.earth.optical import optical_model
    from horizonval.estimators import registry
    from horizonval.sensor.observe import check_camera
    from horizonval.truth import truth_of

    for name in suite.estimators:
        try:
            registry.get(name)
        except UserError as e:
            raise _placed(e, f"{suite.source}: suite.estimators") from e
    checked = set()
    for case in suite.cases:
        where = f"{suite.source}: {case.name}"
        if case.camera.detector is None:
            raise UserError(
                f"camera {case.scene.camera.file!r} has no detector",
                where=f"{where}: camera.file",
                expected="a [detector] table in the camera file",
            )
        matter = (
            case.scene.atmosphere.model_dump_json(),
            case.scene.camera.file,
            case.camera.model_dump_json(),
            case.scene.render.band_error,
        )
        try:
            check_camera(case.camera)
            truth_of(case.scene, case.camera, infrared=False)
            if matter not in checked:
                optical_model(case.scene, case.camera)
                checked.add(matter)
        except UserError as e:
            raise _placed(e, where) from e
    check_stability(suite)


def _placed(error: UserError, where: str) -> UserError:
    inner = f"{where}: {error.where}" if error.where and error.where not in where else where
    return UserError(error.what, where=inner, expected=error.expected, fix=error.fix)


def _claim(folder: RunFolder, suite: Suite) -> None:
    """Write down which suite this folder belongs to; refuse if it belongs to another."""
    identity = suite_identity(suite)
    before = read_json(folder.suite)
    if before is not None and before.get("suite_sha256") != identity:
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
            "cases": [case.name for case in suite.cases],
        },
    )


def _run_cases(
    suite: Suite, folder: RunFolder, workers: int | None, progress: Progress
) -> tuple[dict[str, Record], dict[str, dict[str, float]]]:
    from horizonval.render.backend import probe

    records: dict[str, Record] = {}
    for case in suite.cases:
        record = finished_record(case, suite.estimators, folder)
        if record is not None:
            records[case.name] = record
    seconds: dict[str, dict[str, float]] = {}
    missing = [case for case in suite.cases if case.name not in records]
    progress.start(len(suite.cases), len(records))
    if not missing:
        return records, seconds
    if probe().chosen is None:
        raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    work = partial(run_case, estimators=suite.estimators, folder=folder)
    results = run_cases(work, missing, workers or default_workers())
    try:
        for case, result in results:
            if result is None:
                record = failed_record(case, suite.estimators, "the worker process died (out of memory, or a crash)")
                write_json(folder.case(case.name), record, indent=None)
            else:
                record, seconds[case.name] = result
            records[case.name] = record
            progress.done(case.name, failed=record["error"])
    finally:
        results.close()
    return records, seconds


def _conclude(
    suite: Suite,
    folder: RunFolder,
    records: dict[str, Record],
    seconds: dict[str, dict[str, float]],
    study: StudyOutcome | None,
) -> RunResult:
    from horizonval.report import build_report
    from horizonval.scoring.summary import summarise
    from horizonval.scoring.table import write_results

    start = time.perf_counter()
    ordered: Sequence[Record] = [records[case.name] for case in suite.cases]
    failed = {record["case"]: record["error"] for record in ordered if record["error"] is not None}
    rows = [row for record in ordered for row in record["rows"]]
    summary = {"suite": suite.name, "version": code_version(), "failed": failed, **summarise(rows)}
    if study is not None:
        failed |= {f"stability/{name}": why for name, why in study.failed.items()}
        summary["stability"] = study.digest
        seconds = seconds | {f"stability/{name}": {"march": spent} for name, spent in study.seconds.items()}
    write_results(rows, folder.results)
    write_json(folder.summary, summary)
    report = build_report(folder.root)
    timings = read_json(folder.timings) or {}
    cases = {**timings.get("cases", {}), **seconds}
    write_json(folder.timings, {"cases": cases, "conclude": round(time.perf_counter() - start, 4)})
    return RunResult(summary, failed, report)
