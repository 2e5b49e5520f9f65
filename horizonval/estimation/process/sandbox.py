"""Estimators run in processes of their own, beside the worker: one that hangs or eats memory is ended, not the run.

Ours share a process. It is started once and asked again and again: an estimate costs a copy of its image (1 ms for
512 x 512), not a start. Every estimator of another package, and every program, has a keeper of its own, which asks
a fresh copy of it for each image (:mod:`horizonval.estimation.process.keeper`). All end with the worker, however that
ends.
"""

from __future__ import annotations

import atexit

from horizonval.core.outcome import Refusal
from horizonval.estimation import registry
from horizonval.estimation.observation import Fit, Observation
from horizonval.estimation.process.cell import Cell, Description
from horizonval.estimation.process.limits import Limits

__all__ = ["Description", "Limits", "Sandbox", "sandbox_of"]

_PROGRAM_GRACE_S = 5.0
"""A program's own limit comes first and says more."""

_MOST_KEEPERS = 16
"""Of keepers at the same time, each of some 50 MB; the one that was asked longest ago goes first."""


class Sandbox:
    """The processes of one set of limits, started when they are needed."""

    spent_s: float | None = None
    """Processor time of the last estimate, programs that it ran included; ``None`` if it did not end by itself."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._programs = {program.name for program in limits.programs}
        self._cells: dict[str | None, Cell] = {}

    def run(self, name: str, observation: Observation) -> Fit | Refusal:
        """Return what the estimator of a name makes of an observation."""
        limit = self._limits.time_s + (_PROGRAM_GRACE_S if name in self._programs else 0.0)
        result, self.spent_s = self._cell(name).ask(name, observation, limit)
        return result

    def describe(self, name: str) -> Description | Refusal:
        """Return what an estimator of another package says of itself; a crash if it cannot be imported."""
        return self._cell(name).describe()

    def close(self) -> None:
        """End the processes and what they started."""
        for cell in self._cells.values():
            cell.close()

    def _cell(self, name: str) -> Cell:
        foreign = name in self._programs or registry.is_foreign(name)
        key = name if foreign else None
        cell = self._cells.pop(key, None) or Cell(self._limits, key)
        self._cells[key] = cell
        keepers = [other for name, other in self._cells.items() if name is not None and other.is_open]
        for other in keepers[:-_MOST_KEEPERS]:
            other.close()
        return cell


_open: dict[Limits, Sandbox] = {}


def sandbox_of(limits: Limits) -> Sandbox:
    """Return this process's sandbox with these limits."""
    if limits not in _open:
        _open[limits] = Sandbox(limits)
        atexit.register(_open[limits].close)
    return _open[limits]
