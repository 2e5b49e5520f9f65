"""The study of the infrared horizon inside a run: its cases through the worker pool, then its result.

Every case is one band in one month, in a file of its own, written whole or not at all; a run that was cut off goes on
with those that are missing. The result is made of all of them, so that it is the same bytes however often the run was
cut off::

    stability/<band>-<month>.json   profiles of one case
    stability/result.json           what the report reads
    stability.csv                   errors at every position
"""

from __future__ import annotations

import csv
import io
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from horizonval.core import atomic
from horizonval.core.errors import UserError, one_line
from horizonval.core.progress import Progress
from horizonval.jobs.pool import run_cases
from horizonval.spec.load import Suite
from horizonval.spec.stability import StabilitySpec
from horizonval.stability import study
from horizonval.stability.case import StabilityCase, cases_of, from_plain, to_plain
from horizonval.stability.profiles import Profiles, month_model, month_profiles
from horizonval.store.folder import RunFolder, read_json, write_json
from horizonval.suites.identity import stability_identity

CASE_SCHEMA = 1


def check_stability(suite: Suite) -> None:
    """Find mistakes that the file's model cannot know: bands outside the tables, unknown air.

    Raises
    ------
    UserError
        Naming the suite and the table.
    """
    if suite.stability is None:
        return
    for i, band in enumerate(suite.stability.band, start=1):
        try:
            month_model(suite.stability, band, suite.stability.months[0])
        except UserError as e:
            where = f"{suite.source}: stability.band[{i}] ({band.name})"
            if "atmosphere" in e.where:
                where = f"{suite.source}: stability.atmosphere"
            raise e.at(where) from e


@dataclass(frozen=True)
class StudyOutcome:
    """What became of a study.

    Attributes
    ----------
    digest : dict, or None
        For the summary; ``None`` where a case failed, and there is no result.
    failed : dict
        Cases without profiles, by name, and why.
    seconds : dict
        Of the cases that were made.
    """

    digest: dict[str, Any] | None
    failed: dict[str, str]
    seconds: dict[str, float]


def run_stability(spec: StabilitySpec, folder: RunFolder, workers: int, progress: Progress) -> StudyOutcome:
    """Run what is missing of a study and conclude it.

    Raises
    ------
    UserError
        No back-end to march with.
    """
    from horizonval.renderer.plugin.backend import probe

    cases = cases_of(spec)
    done = {case.key: found for case in cases if (found := _finished(case, folder)) is not None}
    progress.start(len(cases), len(done), unit="months", what="infrared horizon")
    failed: dict[str, str] = {}
    seconds: dict[str, float] = {}
    missing = [case for case in cases if case.key not in done]
    if missing and probe().chosen is None:
        raise UserError("no back-end can render on this machine", fix="see `horizonval doctor`")
    results = run_cases(partial(_run_case, folder=folder), missing, workers)
    try:
        for case, result in results:
            error = None
            if result is None:
                error = "the worker process died (out of memory, or a crash)"
            else:
                error, seconds[case.name] = result
            if error is not None:
                failed[case.name] = error
            progress.done(case.name, failed=error)
    finally:
        results.close()
    result_path = folder.stability / "result.json"
    if failed:
        for path in (result_path, folder.stability_table):
            path.unlink(missing_ok=True)
        return StudyOutcome(None, failed, seconds)
    profiles: dict[tuple[str, int], Profiles] = {}
    for case in cases:
        # Read back, also what was just made: a result must not depend on what a run still had in memory.
        read = _finished(case, folder)
        assert read is not None
        profiles[case.key] = read
    conclusion = study.conclude(spec, profiles)
    write_json(result_path, conclusion, indent=None)
    _write_table(folder.stability_table, *study.rows(conclusion))
    return StudyOutcome(study.digest(conclusion), {}, seconds)


def _finished(case: StabilityCase, folder: RunFolder) -> Profiles | None:
    record = read_json(folder.stability_case(case.name))
    if record is None or record.get("identity") != stability_identity(case):
        return None
    try:
        return from_plain(record["profiles"])
    except (KeyError, TypeError, ValueError):
        return None


def _run_case(case: StabilityCase, folder: RunFolder) -> tuple[str | None, float]:
    """Make one case and write it; return what went wrong, and the seconds it took."""
    start = time.perf_counter()
    error = None
    try:
        profiles = month_profiles(case.spec, case.band, case.month)
        record = {
            "schema": CASE_SCHEMA,
            "case": case.name,
            "identity": stability_identity(case),
            "profiles": to_plain(profiles),
        }
        write_json(folder.stability_case(case.name), record, indent=None)
    except Exception as e:
        error = one_line(e)
    return error, round(time.perf_counter() - start, 4)


def _write_table(path: Path, header: list[str], lines: list[list[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(lines)
    atomic.write_text(path, text.getvalue())
