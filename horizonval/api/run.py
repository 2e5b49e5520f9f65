"""Suites: run into a folder, taken up again, and their results as a table."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from horizonval.api.progress import shown
from horizonval.core.errors import UserError

if TYPE_CHECKING:
    from duckdb import DuckDBPyRelation

    from horizonval.core.progress import Progress
    from horizonval.jobs.engine import ExpectedTime


class SuiteWarning(UserWarning):
    """What a check of a sample of a suite's frames found before they are rendered, as a saturated limb.

    Examples
    --------
    >>> import warnings
    >>> import horizonval as hv
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("ignore", hv.SuiteWarning)
    ...     run = hv.run("orbit.toml", out="out", progress=False)
    """


@dataclass(frozen=True, repr=False)
class Run:
    """A run of a suite in its folder.

    Made by :func:`horizonval.run` or :func:`horizonval.open_run`.

    Attributes
    ----------
    out : Path
        The folder: ``results.parquet``, ``summary.json``, ``archive/``, ``report/``.
    suite : str
        Name of the suite.
    summary : dict
        The content of ``summary.json``; empty as long as shards are missing.
    failed : dict
        Frames without a result, by name, and why.
    missing : int
        Frames that other shards have yet to make.

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

    @property
    def report(self) -> Path | None:
        """The first page of the report; None while there is none."""
        page = self.out / "report" / "index.html"
        return page if page.is_file() else None

    def rows(self) -> DuckDBPyRelation:
        """Return the results, one row for every frame and estimator.

        Returns
        -------
        duckdb.DuckDBPyRelation
            ``.df()`` makes it a pandas frame, ``.arrow()`` an Arrow table, ``.filter("status = 'valid'")`` another
            relation.

        Raises
        ------
        UserError
            The run is not finished, or the file with its results is damaged.
        """
        import duckdb

        from horizonval.scoring.row import open_results
        from horizonval.store.folder import RunFolder

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
    merge: Sequence[str | Path] = (),
    progress: bool | Progress = True,
) -> Run:
    """Run a suite: render, observe, estimate, score, report. The same call again finishes what is missing.

    What :func:`horizonval.check` has against a sample of the frames is a warning before they are rendered.

    Parameters
    ----------
    suite : str or Path
        A suite file, or the name of a shipped suite (:func:`horizonval.list_suites`).
    out : str or Path
        Folder of the run; made if need be.
    workers : int, optional
        Processes; as many as processors by default. The number does not change any result.
    shard : str or (int, int), optional
        ``"2/8"``: only every 8th frame from the 2nd on; the call without it then concludes.
    seed, frames : int, optional
        In place of ``suite.seed`` and ``suite.frames``.
    keep : {"all", "failures", "none"}, optional
        In place of ``suite.keep``: what stays in the archive.
    time_limit_s : float, optional
        Of one estimate, in place of ``suite.time_limit_s``.
    dask : str, optional
        Address of a Dask scheduler in place of own processes, or ``"local:N"``.
    merge : sequence of str or Path
        Folders of other runs of this suite, whose results are taken over.
    progress : bool or Progress
        Whether progress is shown on standard error, or who is told of it.

    Returns
    -------
    Run

    Raises
    ------
    UserError
        A mistake in the suite, told before anything is rendered; a folder that holds another suite's run.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.run("orbit.toml", out="out", progress=False)
    <Run orbit: 2 rows, 0 frames failed>
    """
    from horizonval.commands.run import run as run_suite
    from horizonval.jobs.pool import Execution, parse_shard
    from horizonval.precheck import check_before_run, expected_of
    from horizonval.suites.suite import load_suite, with_options

    part = parse_shard(f"{shard[0]}/{shard[1]}" if isinstance(shard, tuple) else shard) if shard is not None else None
    execution = Execution(workers, part, dask, tuple(Path(folder) for folder in merge))
    loaded = with_options(load_suite(suite, frames, seed), time_limit_s, keep)

    def warn() -> dict[str, ExpectedTime]:
        report = check_before_run(loaded)
        for line in [] if report is None else report.summary_lines():
            warnings.warn(line, SuiteWarning, stacklevel=_frames_inside())
        return expected_of(loaded)

    with shown(progress, f"suite {loaded.name}") as listener:
        result = run_suite(loaded, Path(out), progress=listener, execution=execution, on_start=warn)
    return Run(Path(out), loaded.name, result.summary, result.failed, result.missing)


def open_run(folder: str | Path) -> Run:
    """Open the folder of a run.

    Parameters
    ----------
    folder : str or Path

    Returns
    -------
    Run

    Raises
    ------
    UserError
        It is not the folder of a run.

    Examples
    --------
    >>> import horizonval as hv
    >>> hv.open_run("out").suite
    'orbit'
    """
    from horizonval.store.folder import RunFolder, read_json

    paths = RunFolder(Path(folder))
    about = read_json(paths.suite)
    if about is None:
        raise UserError("there is no run here", where=str(folder), expected="the folder of a run")
    summary = read_json(paths.summary) or {}
    missing = 0 if summary else sum(not paths.case(name).is_file() for name in about["cases"])
    return Run(Path(folder), about["suite"], summary, dict(summary.get("failed", {})), missing)


def _frames_inside() -> int:
    """Return how many frames above its caller the user's own code stands, whose line a warning is about."""
    frame, count = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "horizonval":
        frame, count = frame.f_back, count + 1
    return count
