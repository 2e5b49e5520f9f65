"""Run a suite with everything that it may ask for."""

from __future__ import annotations

from pathlib import Path

from horizonval.core.progress import Progress
from horizonval.jobs.engine import OnStart
from horizonval.jobs.execution import Execution
from horizonval.spec.load import Suite
from horizonval.suites.run import RunResult, run_suite


def run(
    suite: Suite,
    out_dir: Path,
    *,
    progress: Progress | None = None,
    execution: Execution | None = None,
    on_start: OnStart | None = None,
) -> RunResult:
    """Run a suite into a folder, or finish what an earlier run left there; see :func:`run_suite`.

    Parameters
    ----------
    suite : Suite
    out_dir : Path
    progress : Progress, optional
    execution : Execution, optional
    on_start : callable, optional
        Called once before the first frame, when nothing is refused any more; never if all frames are finished.

    Raises
    ------
    UserError
        As :func:`horizonval.suites.run.run_suite`.
    """
    return run_suite(suite, out_dir, progress=progress, execution=execution, on_start=on_start)
