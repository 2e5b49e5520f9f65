"""Run a study: its frames by the campaign engine, then its results and its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.jobs.engine import ExpectedTime
from horizonval.jobs.pool import Execution
from horizonval.report import study as study_page
from horizonval.spec.requirement import Requirement
from horizonval.store.verify import amend_manifest
from horizonval.studies.trade.conclude import Data, conclude, files_of_study, query, read_data
from horizonval.studies.trade.design import (
    PLAN_FILE,
    Study,
    expand,
    read_plan,
    read_study,
    write_plan,
)
from horizonval.suites.run import run_suite


@dataclass(frozen=True)
class StudyResult:
    """Result of a study.

    ``result``, ``costs``: contents of ``study.json`` and ``study-costs.json``; empty while other shards are missing.
    ``failed``: reasons by frame. ``missing``: results of other shards.
    """

    result: dict[str, Any]
    costs: dict[str, Any]
    failed: Mapping[str, str]
    page: Path | None
    missing: int = 0


def study_in(path_or_name: str | Path, frames: int | None = None) -> Study:
    spec, path = read_study(path_or_name, frames)
    study = expand(spec, path)
    if frames is not None:
        study = replace(study, suite=replace(study.suite, options=("--frames", str(frames))))
    return study


def run_study(
    path_or_name: str | Path,
    out_dir: Path,
    *,
    execution: Execution | None = None,
    progress: Progress | None = None,
    frames: int | None = None,
    on_start: Callable[[Study], Mapping[str, ExpectedTime] | None] | None = None,
) -> StudyResult:
    """Run a study into a folder, or resume, or extend it: only new frames are made.

    ``frames`` replaces the number of conditions. ``on_start`` is called with the study before the first frame. Raises
    ``UserError``: a mistake in the study, found before rendering; or as :func:`horizonval.suites.run.run_suite`.
    """
    study = study_in(path_or_name, frames)
    made: list[tuple[dict[str, Any], dict[str, Any], Path]] = []

    def concluded() -> list[Path]:
        write_plan(study, out_dir)
        made.append((*conclude(read_data(study, out_dir), out_dir), study_page.write_page(out_dir)))
        return [*files_of_study(out_dir), made[0][-1]]

    start = None if on_start is None else partial(on_start, study)
    run = run_suite(study.suite, out_dir, progress=progress, execution=execution, on_start=start, also=concluded)
    if not made:
        return StudyResult({}, {}, run.failed, None, run.missing)
    return StudyResult(made[0][0], made[0][1], run.failed, made[0][2])


def open_study(folder: Path) -> Data:
    """Return the results of a study's folder. Raises ``UserError``: no finished study in it."""
    plan = read_plan(folder)
    if plan is None:
        raise UserError(
            f"no {PLAN_FILE}", where=str(folder), expected="the folder of a study, or a study file with --out"
        )
    return read_data(plan, folder)


def conclude_again(folder: Path) -> StudyResult:
    """Recompute the results of a folder and its page."""
    data = open_study(folder)
    result, costs = conclude(data, folder)
    page = study_page.write_page(folder)
    amend_manifest(folder, [*files_of_study(folder), page])
    return StudyResult(result, costs, dict.fromkeys(data.failed, "see summary.json"), page)


def ask(data: Data, result: StudyResult, requirements: Sequence[Requirement], by: str | None = None) -> dict[str, Any]:
    """Return the cheapest design for requirements, by an expression or by the study's price."""
    price, where = (data.plan.head.cheapest_by, "study.cheapest_by") if by is None else (by, "--cheapest-by")
    return query(data, result.result["designs"], requirements, price, result.costs["designs"], where)
