"""The study of the infrared horizon as a part of a suite's run: its cases through the engine, then its result.

Every case is one band in one month, in a file of its own; a run that was cut off goes on with those that are missing.
The result is made of all of them, so that it is the same bytes however often the run was cut off::

    stability/<band>-<month>.json   profiles of one case
    stability/result.json           what the report reads
    stability.csv                   errors at every position
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
from pathlib import Path

from horizonval.core import atomic
from horizonval.core.code import code_digest
from horizonval.core.errors import UserError
from horizonval.core.progress import Progress
from horizonval.jobs.engine import Recorded, do
from horizonval.jobs.execution import Execution
from horizonval.jobs.kept import Record
from horizonval.jobs.stopwatch import Stopwatch
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder, write_json
from horizonval.studies.stability import study
from horizonval.studies.stability.case import StabilityCase, cases_of, from_plain, to_plain
from horizonval.studies.stability.profiles import month_model, month_profiles
from horizonval.suites.run import PartOutcome

CASE_SCHEMA = 1
CODE = ("horizonval.studies.stability.profiles", "horizonval.studies.stability.case")
"""The modules that make the profiles of a case; those that they import are found."""


class StabilityPart:
    """The study of the infrared horizon, for suites that ask for one."""

    name = "stability"

    def is_asked_for(self, suite: Suite) -> bool:
        """Whether the suite has a table ``[stability]``."""
        return suite.stability is not None

    def check(self, suite: Suite) -> None:
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

    def run(self, suite: Suite, folder: RunFolder, execution: Execution, progress: Progress) -> PartOutcome:
        """Run what is missing of the study and conclude it.

        Raises
        ------
        UserError
            No back-end to march with.
        """
        assert suite.stability is not None
        cases = cases_of(suite.stability)
        done = do(StabilityWork(folder), cases, execution, progress, unit="months", what="infrared horizon")
        failed = {name: one.error for name, one in done.items() if one.error is not None}
        seconds = {name: one.seconds for name, one in done.items() if one.seconds}
        result_path = folder.stability / "result.json"
        if failed:
            for path in (result_path, folder.stability_table):
                path.unlink(missing_ok=True)
            return PartOutcome(None, failed, seconds, tuple(folder.stability_case(name) for name in done))
        profiles = {
            case.key: from_plain(record["profiles"]) for case in cases if (record := done[case.name].result) is not None
        }
        conclusion = study.conclude(suite.stability, profiles)
        write_json(result_path, conclusion, indent=None)
        _write_table(folder.stability_table, *study.rows(conclusion))
        made = (*(folder.stability_case(case.name) for case in cases), result_path, folder.stability_table)
        return PartOutcome(study.digest(conclusion), {}, seconds, made)


class StabilityWork(Recorded[StabilityCase]):
    """Cases of the study, into the folder of a run."""

    def __init__(self, folder: RunFolder) -> None:
        self.run = folder
        self.folder: Path | None = folder.root

    def name(self, item: StabilityCase) -> str:
        """Return the band and the month."""
        return item.name

    def path(self, item: StabilityCase) -> Path:
        """Return the file of a case."""
        return self.run.stability_case(item.name)

    def identity(self, item: StabilityCase) -> str:
        """Return the digest of the study, the case and the code."""
        return stability_identity(item)

    def finished(self, item: StabilityCase) -> Record | None:
        """Return a record that holds profiles."""
        record = super().finished(item)
        try:
            if record is not None:
                from_plain(record["profiles"])
        except (KeyError, TypeError, ValueError):
            return None
        return record

    def record(self, item: StabilityCase, watch: Stopwatch) -> Record:
        """March the profiles of a month."""
        with watch.stage("march"):
            profiles = month_profiles(item.spec, item.band, item.month)
        return {"schema": CASE_SCHEMA, "case": item.name, "profiles": to_plain(profiles)}


def stability_identity(case: StabilityCase) -> str:
    """Return the digest of what the profiles of a study's case depend on."""
    content = json.dumps([case.spec.model_dump_json(), case.name, code_digest(*CODE)])
    return hashlib.sha256(content.encode()).hexdigest()


def _write_table(path: Path, header: list[str], lines: list[list[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(lines)
    atomic.write_text(path, text.getvalue())
