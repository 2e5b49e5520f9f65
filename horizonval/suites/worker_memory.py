"""Number of workers that fit into memory, each with the largest frame of a suite."""

from __future__ import annotations

from dataclasses import replace

from horizonval.core import memory
from horizonval.core.errors import UserError
from horizonval.jobs.pool import Execution
from horizonval.renderer.frame_cost import frame_bytes
from horizonval.spec.load import Case, Suite


def largest_frame(suite: Suite) -> Case | None:
    """Return the frame with the largest memory use; None without frames."""
    # Thousands of cases share few cameras.
    cases = {(id(case.camera), case.scene.render.subsamples): case for case in suite.cases}.values()
    return max(cases, key=lambda case: frame_bytes(case.scene, case.camera), default=None)


def within_memory(execution: Execution, suite: Suite) -> Execution:
    """Return an execution with as many local workers as fit into memory, at least one; cluster workers are unchanged.

    Raises ``UserError``: an explicit number of workers does not fit.
    """
    largest = largest_frame(suite)
    if execution.dask is not None or largest is None:
        return execution
    needed = frame_bytes(largest.scene, largest.camera)
    free = memory.available_bytes()
    most = max(1, int(free / needed))
    if execution.processes <= most:
        return execution
    if execution.workers is not None:
        raise UserError(
            f"{execution.workers} processes of {memory.size_text(needed)} each, as the largest frame takes",
            where="--workers",
            expected=f"at most {most}: {memory.size_text(free)} of memory are free",
        )
    return replace(execution, workers=most)
