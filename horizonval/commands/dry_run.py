"""What a command would make, counted without making it: nothing is rendered, and nothing is written."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.jobs.engine import Work
from horizonval.jobs.execution import Execution, available_cpus
from horizonval.precheck.cost import Cost
from horizonval.precheck.report import Report
from horizonval.precheck.suite import check_suite
from horizonval.precheck.text import cost_lines
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder
from horizonval.studies.regression.night import Wanted, planned
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.units.work import UnitWork
from horizonval.systems.systems import chosen, experiment
from horizonval.systems.task_cache import NamedItem, TaskCache, TaskWork

I = TypeVar("I")  # noqa: E741

NOTHING_WRITTEN = "nothing was rendered or written"


@dataclass(frozen=True)
class DryRun:
    """What would be made.

    Attributes
    ----------
    what : str
    out : str
        Folder that it would go into.
    total, finished : dict of str to int
        How many of what, and how many of them are finished there already.
    cost : Cost or None
        Of all, finished or not; None where it is not known.
    notes : tuple of str
    """

    what: str
    out: str
    total: dict[str, int]
    finished: dict[str, int]
    cost: Cost | None = None
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self) | {"cost": None if self.cost is None else self.cost.to_dict()}

    def __str__(self) -> str:
        """Return a line for each kind of thing, and the cost."""
        lines = [self.what]
        for name, count in self.total.items():
            lines.append(f"  {name}: {count}, of which {self.finished.get(name, 0)} are finished in {self.out}")
        if self.cost is not None:
            lines += cost_lines(self.cost, available_cpus())
        return "\n".join([*lines, *self.notes, NOTHING_WRITTEN])


def of_suite(suite: Suite, out: Path, execution: Execution, report: Report) -> DryRun:
    """Return what a run of a suite, or of a study's suite, would make; ``report`` is that of its check.

    Raises
    ------
    UserError
        What the run itself would refuse.
    """
    if report.cost is None:
        error = next(finding for finding in report.findings if finding.code == "cannot-run")
        raise UserError(error.text, fix=error.fix)
    plan = plan_of(suite)
    units = execution.share(units_of(suite.cases, plan))
    done = _finished(UnitWork(plan, RunFolder(out)), units)
    total = {"frames": sum(len(unit.cases) for unit in units)}
    finished = {"frames": sum(len(unit.cases) for unit in done)}
    share = () if execution.shard is None else ("the cost is that of all shards together",)
    return DryRun(f"{report.kind} {report.name}", str(out), total, finished, report.cost, share)


def of_night(wanted: Wanted) -> DryRun:
    """Return what a night would make; of fresh scenes the first batch, as more are made only if gates ask for them."""
    suite, work, tasks = planned(wanted)
    total: dict[str, int] = {}
    finished: dict[str, int] = {}
    for task in tasks:
        lane = task.name.partition("/")[0]
        total[lane] = total.get(lane, 0) + 1
        finished[lane] = finished.get(lane, 0) + (work.finished(task) is not None)
    rendered = total.get("rerender", 0) + total.get("fresh", 0)
    cost = check_suite(suite, infrared=False).cost if rendered else None
    notes = ("the cost is that of one lane: rerender and fresh render as many frames each",) if rendered else ()
    return DryRun(f"night {wanted.night} of suite {suite.name}", str(wanted.out), total, finished, cost, notes)


def of_systems(names: list[str], out: Path, seed: int, work_folder: Path) -> DryRun:
    """Return what published experiments would make, as far as it does not hang on what is not made yet."""
    total: dict[str, int] = {}
    finished: dict[str, int] = {}
    notes = []
    for letter in chosen(names):
        cache = _Counting(work_folder, seed, letter, total, finished)
        try:
            experiment(letter)(cache)
        except _NotYetError as stop:
            notes.append(f"{letter}: what follows {stop} hangs on its results")
    return DryRun("published systems", str(out), total, finished, None, tuple(notes))


class _NotYetError(Exception):
    """Something is not made that the next step needs."""


class _Counting(TaskCache):
    """Counts items in place of making them."""

    def __init__(self, folder: Path, seed: int, letter: str, total: dict[str, int], finished: dict[str, int]) -> None:
        super().__init__(folder, seed)
        object.__setattr__(self, "_counts", (letter, total, finished))

    def each(self, title: str, work: Any, items: Any) -> dict[str, JsonObject]:
        """Count items, and return their results if all of them are there."""
        letter, total, finished = self._counts  # type: ignore[attr-defined]
        named = [NamedItem(name, dict(item)) for name, item in items.items()]
        task = TaskWork(work, self.folder)
        records = {item.name: task.finished(item) for item in named}
        name = f"{letter}: {title}"
        total[name] = total.get(name, 0) + len(named)
        finished[name] = finished.get(name, 0) + sum(record is not None for record in records.values())
        values = {name: record["value"] for name, record in records.items() if record is not None}
        if len(values) < len(named):
            raise _NotYetError(title)
        return values


def _finished(work: Work[I, Any], items: Sequence[I]) -> list[I]:
    return [item for item in items if work.finished(item) is not None]
