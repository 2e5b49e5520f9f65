"""Runs of suites, studies, nights and published systems: new, resumed, or as a dry run."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from horizonval.api.check import Finding, Report, check_before_run, check_suite, expected_of
from horizonval.api.check.cost import Cost, cost_lines
from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.core.progress import Progress
from horizonval.jobs.engine import ExpectedTime
from horizonval.jobs.pool import Execution, available_cpus, parse_shard
from horizonval.jobs.progress import shown
from horizonval.spec.load import Suite
from horizonval.store.folder import RunFolder, read_json
from horizonval.studies.trade.design import Study
from horizonval.suites.plan import plan_of, units_of
from horizonval.suites.run import run_suite
from horizonval.suites.suite import load_suite, with_options
from horizonval.suites.units.work import UnitWork
from horizonval.systems.task_cache import NamedItem, TaskCache, TaskWork

if TYPE_CHECKING:
    from duckdb import DuckDBPyRelation

    from horizonval.studies.trade.run import StudyResult

BASELINES, PAGES = Path("results/baseline"), Path("results/published")


@dataclass(frozen=True)
class DryRun:
    """Counts of a run without rendering or writing anything.

    ``total``, ``finished``: number of items by kind, and of those finished in the folder ``out``. ``cost``: of all
    items; None if unknown.
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
            lines += cost_lines(self.cost)
        return "\n".join([*lines, *self.notes, "nothing was rendered or written"])


@dataclass(frozen=True, repr=False)
class Run:
    """A run of a suite in its folder; made by :func:`horizonval.run` or :func:`horizonval.open_run`.

    Attributes
    ----------
    out : Path
        The folder: ``results.parquet``, ``summary.json``, ``archive/``, ``report/``.
    suite : str
        Name of the suite.
    summary : dict
        The content of ``summary.json``; empty while shards are missing.
    failed : dict
        Reasons of frames without a result, by name.
    missing : int
        Frames that are not made yet: by other shards, or after a dry run.
    warnings : tuple of Finding
        What the check of a sample of the frames found before they were rendered, such as a saturated limb.
    dry_run : DryRun or None
        What a run with ``dry_run=True`` would make.

    Examples
    --------
    >>> import horizonval as hv
    >>> run = hv.open_run("out")
    >>> run
    <Run orbit: 2 rows, 0 frames failed>
    >>> run.rows().project("estimator, status").fetchall()
    [('altitude-free', 'valid'), ('ideal', 'valid')]
    """

    out: Path
    suite: str
    summary: dict[str, Any] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    missing: int = 0
    warnings: tuple[Finding, ...] = ()
    dry_run: DryRun | None = None

    @property
    def report(self) -> Path | None:
        """The first page of the report; None while there is none."""
        page = self.out / "report" / "index.html"
        return page if page.is_file() else None

    def rows(self) -> DuckDBPyRelation:
        """Return the results as a relation, one row for every frame and estimator.

        ``.df()`` makes it a pandas frame, ``.arrow()`` an Arrow table, ``.filter("status = 'valid'")`` a relation.
        Raises ``UserError``: the run is not finished, or its results are damaged.
        """
        import duckdb

        from horizonval.scoring.row import open_results

        path = RunFolder(self.out).results
        if not path.exists():
            raise UserError("there are no results yet", where=str(self.out), fix="finish the run first")
        return open_results(path, duckdb.connect())

    def __repr__(self) -> str:
        if not self.summary:
            return f"<Run {self.suite}: {self.missing} frames missing>"
        rows = sum(group["n"] for group in self.summary["groups"])
        return f"<Run {self.suite}: {rows} rows, {len(self.failed)} frames failed>"

    def _repr_html_(self) -> str:
        from html import escape

        page = self.report
        link = "" if page is None else f' <a href="{page.resolve().as_uri()}">report</a>'
        return f"{escape(repr(self))}{link}"


def run(
    suite: str | Path,
    out: str | Path,
    *,
    workers: int | None = None,
    shard: str | tuple[int, int] | None = None,
    seed: int | None = None,
    frames: int | None = None,
    keep: str | None = None,
    time_limit_s: float | None = None,
    dask: str | None = None,
    merge: Iterable[str | Path] = (),
    dry_run: bool = False,
    progress: bool | Progress = True,
) -> Run:
    """Run a suite: render, observe, estimate, score, report. The same call again finishes what is missing.

    Before rendering, :func:`horizonval.check` looks at a sample of the frames; its warnings are shown and returned.

    Parameters
    ----------
    suite : str or Path
        A suite file, or the name of a shipped suite (:func:`horizonval.list_suites`).
    out : str or Path
        Folder of the run; created if it does not exist.
    workers : int, optional
        Number of processes, by default one for each processor. Results do not depend on it.
    shard : str or (int, int), optional
        ``"2/8"``: only every 8th frame, starting with the 2nd. The call without ``shard`` then writes the results.
    seed, frames : int, optional
        Replace ``suite.seed`` and ``suite.frames``.
    keep : {"all", "failures", "none"}, optional
        Replaces ``suite.keep``: what stays in the archive.
    time_limit_s : float, optional
        Processor time of one estimate; replaces ``suite.time_limit_s``.
    dask : str, optional
        Address of a Dask scheduler, or ``"local:N"``; replaces the processes of this call.
    merge : sequence of str or Path
        Folders of other runs of this suite; their results are copied.
    dry_run : bool
        Count what would be made and what it costs; render and write nothing.
    progress : bool or Progress
        Whether progress and warnings are shown on standard error, or the object that receives them.

    Raises
    ------
    UserError
        A mistake in the suite, before anything is rendered; a folder that holds another suite's run.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.run("orbit.toml", out="out", progress=False)
    <Run orbit: 2 rows, 0 frames failed>
    """
    execution = execution_of(workers, shard, dask, merge)
    loaded = with_options(load_suite(suite, frames, seed), time_limit_s, keep)
    if dry_run:
        report = check_suite(loaded, infrared=False)
        plan = _dry_run(loaded, Path(out), execution, report)
        missing = plan.total["frames"] - plan.finished["frames"]
        return Run(Path(out), loaded.name, missing=missing, warnings=report.warnings, dry_run=plan)
    found: list[Finding] = []
    with shown(progress, f"suite {loaded.name}") as listener:
        start = partial(_before, loaded, listener, found)
        done = run_suite(loaded, Path(out), progress=listener, execution=execution, on_start=start)
    return Run(Path(out), loaded.name, done.summary, done.failed, done.missing, tuple(found))


def open_run(folder: str | Path) -> Run:
    """Open the folder of a run.

    Raises ``UserError``: it is not the folder of a run.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.open_run("out").suite
    'orbit'
    """
    paths = RunFolder(Path(folder))
    about = read_json(paths.suite)
    if about is None:
        raise UserError("there is no run here", where=str(folder), expected="the folder of a run")
    summary = read_json(paths.summary) or {}
    missing = 0 if summary else sum(not paths.case(name).is_file() for name in about["cases"])
    return Run(Path(folder), about["suite"], summary, dict(summary.get("failed", {})), missing)


def study(
    study: str | Path,
    out: str | Path,
    *,
    workers: int | None = None,
    shard: str | tuple[int, int] | None = None,
    frames: int | None = None,
    dask: str | None = None,
    merge: Iterable[str | Path] = (),
    dry_run: bool = False,
    progress: bool | Progress = True,
) -> StudyResult | DryRun:
    """Run a trade study into a folder, or finish or extend the study in it: only new frames are made.

    Parameters and errors as for :func:`run`; ``frames`` replaces the number of conditions in the file.
    """
    from horizonval.studies.trade.run import run_study, study_in

    execution, folder = execution_of(workers, shard, dask, merge), Path(out)
    if dry_run:
        planned = study_in(study, frames)
        return _dry_run(planned.suite, folder, execution, check_suite(planned, infrared=False))
    with shown(progress, "study") as listener:
        return run_study(
            study,
            folder,
            execution=execution,
            progress=listener,
            frames=frames,
            on_start=lambda expanded: _before(expanded, listener, []),
        )


def regress(
    suite: str,
    out: Path,
    *,
    baseline: Path | None = None,
    lanes: Iterable[str] | None = None,
    night: str | None = None,
    reference: Path | None = None,
    workers: int | None = None,
    dry_run: bool = False,
    progress: bool | Progress = True,
) -> JsonObject | DryRun:
    """Run the regression of one night and return its verdict.

    Raises ``UserError``: no such lane; or as :func:`horizonval.studies.regression.night.run_night`.

    Parameters
    ----------
    suite : str
        A suite with a table ``[regression]``: a file or a shipped name.
    out : Path
        Folder of the nights.
    baseline : Path, optional
        By default ``results/baseline/SUITE.json``.
    lanes : iterable of str, optional
        Some of ``replay``, ``rerender``, ``fresh`` and ``published``; all by default.
    night : str, optional
        Label and seed; today (UTC) by default.
    reference : Path, optional
        Folder of this night by another version; fresh scenes are compared in pairs.
    workers, dry_run, progress
        As for :func:`run`. A dry run counts only the first batch of fresh scenes: later ones depend on its result.
    """
    from horizonval.studies.regression.night import LANES, Wanted, planned, run_night

    chosen = set(LANES if lanes is None else lanes)
    if unknown := sorted(chosen - {*LANES}):
        raise UserError(f"found {unknown[0]!r}", where="--lane", expected=" or ".join(LANES))
    label, file = night or datetime.now(UTC).date().isoformat(), baseline or baseline_of(Path(suite).stem)
    wanted = Wanted(suite, out, file, label, tuple(name for name in LANES if name in chosen), workers, reference)
    if not dry_run:
        with shown(progress, f"night {label}", "units") as listener:
            return run_night(wanted, listener, partial(_published, workers))
    loaded, work, tasks = planned(wanted)
    total: dict[str, int] = {}
    finished: dict[str, int] = {}
    for task in tasks:
        lane = task.name.partition("/")[0]
        total[lane] = total.get(lane, 0) + 1
        finished[lane] = finished.get(lane, 0) + (work.finished(task) is not None)
    rendered = total.get("rerender", 0) + total.get("fresh", 0)
    cost = check_suite(loaded, infrared=False).cost if rendered else None
    notes = ("the cost is that of one lane: rerender and fresh render as many frames each",) if rendered else ()
    return DryRun(f"night {label} of suite {loaded.name}", str(out), total, finished, cost, notes)


def baseline_of(suite: str) -> Path:
    """Return the path of the accepted baseline of a suite."""
    return BASELINES / f"{suite}.json"


def _published(workers: int | None, folder: Path, progress: Progress) -> list[JsonObject]:
    from horizonval.systems.quick import quick_figures

    return quick_figures(TaskCache(folder, workers=workers or available_cpus(), progress=progress), PAGES)


def reproduce(
    systems: Sequence[str],
    out: Path,
    *,
    seed: int = 0,
    workers: int | None = None,
    dry_run: bool = False,
    progress: bool | Progress = True,
) -> Iterator[JsonObject | DryRun]:
    """Repeat the published experiments and yield the content of each page as it is written, or the dry run.

    ``systems``: letters; empty or ``all`` for all. ``out``: folder of the pages. ``seed``: of all noise. Others as for
    :func:`run`. A dry run leaves out items that depend on missing results.
    """
    from horizonval.systems.quick import chosen, experiment
    from horizonval.systems.run import WORK, reproduce_systems

    if not dry_run:
        with shown(progress, "reproduce", "items") as listener:
            yield from reproduce_systems(list(systems), out, seed=seed, workers=workers, progress=listener)
        return
    counted = DryRun("published systems", str(out), {}, {})
    notes = []
    for letter in chosen(list(systems)):
        try:
            experiment(letter).reproduce(_Counting(out / WORK, seed, letter=letter, counted=counted))
        except _NotYetError as stop:
            notes.append(f"{letter}: what follows {stop} depends on its results")
    yield DryRun(counted.what, counted.out, counted.total, counted.finished, None, tuple(notes))


class _NotYetError(Exception):
    """The next step needs a result that does not exist."""


@dataclass(frozen=True)
class _Counting(TaskCache):
    """Counts items instead of making them."""

    letter: str = ""
    counted: DryRun = field(default_factory=lambda: DryRun("", "", {}, {}))

    def each(self, title: str, work: Any, items: Mapping[str, JsonObject]) -> dict[str, JsonObject]:
        """Count items, and return their results if all of them are there."""
        task = TaskWork(work, self.folder)
        records = {name: task.finished(NamedItem(name, dict(item))) for name, item in items.items()}
        values = {name: record["value"] for name, record in records.items() if record is not None}
        name, (total, finished) = f"{self.letter}: {title}", (self.counted.total, self.counted.finished)
        total[name] = total.get(name, 0) + len(records)
        finished[name] = finished.get(name, 0) + len(values)
        if len(values) < len(records):
            raise _NotYetError(title)
        return values


def execution_of(
    workers: int | None = None,
    shard: str | tuple[int, int] | None = None,
    dask: str | None = None,
    merge: Iterable[str | Path] = (),
) -> Execution:
    """Return the execution of a run; parameters as for :func:`run`."""
    text = f"{shard[0]}/{shard[1]}" if isinstance(shard, tuple) else shard
    return Execution(workers, None if text is None else parse_shard(text), dask, tuple(map(Path, merge)))


def _before(target: Suite | Study, listener: Progress, found: list[Finding]) -> dict[str, ExpectedTime]:
    """Report the findings of a sample of the frames before they are rendered, and return the expected times."""
    report = check_before_run(target)
    if report is not None:
        found += report.warnings
        for line in report.summary_lines():
            listener.note(line)
    return expected_of(target)


def _dry_run(suite: Suite, out: Path, execution: Execution, report: Report) -> DryRun:
    """Return the dry run of a suite, or of the suite of a study; raises as the run."""
    if report.cost is None:
        error = next(finding for finding in report.findings if finding.code == "cannot-run")
        raise UserError(error.text, fix=error.fix)
    plan = plan_of(suite)
    units, work = execution.share(units_of(suite.cases, plan)), UnitWork(plan, RunFolder(out))
    total = {"frames": sum(len(unit.cases) for unit in units)}
    finished = {"frames": sum(len(unit.cases) for unit in units if work.finished(unit) is not None)}
    notes = () if execution.shard is None else ("the cost is that of all shards together",)
    return DryRun(f"{report.kind} {report.name}", str(out), total, finished, report.cost, notes)
