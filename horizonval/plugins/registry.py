"""Estimators by name, from the entry points ``horizonval.estimators`` of this and other packages.

Names come from the packages' metadata. Only :func:`load` imports third-party code, in the estimator's process
(:mod:`horizonval.plugins.child`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from horizonval.core.errors import UserError, nearest
from horizonval.core.outcome import Refusal
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.plugins.answer import checked, crash, raised, rounded, traceback_of

GROUP = "horizonval.estimators"
PACKAGE = "horizonval"


@dataclass(frozen=True)
class _Declared:
    """An entry point with the name of its package, which takes a millisecond to read."""

    point: EntryPoint
    package: str

    @property
    def is_ours(self) -> bool:
        return self.package == PACKAGE and self.point.value.startswith(f"{PACKAGE}.")


@cache
def _points() -> dict[str, _Declared]:
    """Return entry points by name: this package goes first, then other packages in alphabetical order."""
    points = [
        _Declared(point, "" if point.dist is None else str(point.dist.name).lower())
        for point in entry_points(group=GROUP)
        if point.name.isprintable() and _module(point)
    ]
    points.sort(key=lambda one: (one.is_ours, one.package), reverse=True)
    ours = {one.point.name: one for one in points if one.is_ours}
    return {one.point.name: one for one in points} | ours


def _module(point: EntryPoint) -> str | None:
    try:
        return point.module
    except (AttributeError, ValueError, AssertionError):
        # The entry point names no object of a module: readers of entry points differ in their errors.
        return None


def names() -> list[str]:
    return sorted(_points())


def is_foreign(name: str) -> bool:
    """Whether an installed estimator belongs to another package."""
    declared = _points().get(name)
    return declared is not None and not declared.is_ours


def module_of(name: str) -> str | None:
    """Return the dotted name of an installed estimator's module."""
    declared = _points().get(name)
    return None if declared is None else _module(declared.point)


def get(name: str) -> Estimator:
    """Return an estimator of this package. Raises ``UserError``: no such estimator.

    For those of other packages see :func:`horizonval.plugins.supervisor.get`.
    """
    if name not in _points():
        known = ", ".join(nearest(name, names()))
        raise UserError(f"unknown estimator {name!r}", expected=f"one of {known}")
    if is_foreign(name):
        raise UserError(f"the estimator {name!r} is another package's and runs in a process of its own")
    return load(name)


@cache
def load(name: str) -> Estimator:
    """Import and return an estimator; third-party code in its separate process only.

    Raises ``TypeError``: the entry point is not an estimator.
    """
    point = _points()[name].point
    estimator = point.load()
    if not isinstance(estimator, Estimator):
        raise TypeError(f"{point.value} is a {type(estimator).__name__}, no horizonval.Estimator")
    return estimator


def run_safely(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    """Run an estimator; exceptions, wrong types and NaN become crashes.

    Numbers are rounded to the digits of results (:mod:`horizonval.plugins.answer`).
    """
    try:
        # A user's method may return anything.
        result: object = estimator.run(observation)
    except Exception as e:
        return crash(f"the estimator raised {raised(e)}", traceback_of(e))
    try:
        answer = checked(result)
    except Exception as e:
        why = str(e) if isinstance(e, ValueError) else raised(e)
        return crash(f"the estimator's answer cannot be used: {why}")
    return answer if isinstance(answer, Refusal) else rounded(replace(answer, estimates=estimator.estimates))
