"""Estimators by name, from the package entry points ``horizonval.estimators``: ours and any user's, side by side."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from importlib.metadata import EntryPoint, entry_points

import numpy as np

from horizonval.core.errors import UserError
from horizonval.core.outcome import Outcome
from horizonval.core.refusal import Refusal
from horizonval.core.suggest import nearest
from horizonval.estimation.digits import rounded
from horizonval.estimation.last_words import crash, raised, traceback_of
from horizonval.estimation.observation import Estimator, Fit, Observation

GROUP = "horizonval.estimators"


@cache
def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=GROUP)}


def names() -> list[str]:
    """Return the names of all estimators that are installed, sorted."""
    return sorted(_points())


def module_of(name: str) -> str | None:
    """Return the module that an installed estimator is in, by its dotted name."""
    point = _points().get(name)
    return None if point is None else point.module


@cache
def get(name: str) -> Estimator:
    """Return an estimator.

    Raises
    ------
    UserError
        If there is none of that name, or its package cannot be imported.
    """
    if name not in _points():
        known = ", ".join(nearest(name, names()))
        raise UserError(f"unknown estimator {name!r}", expected=f"one of {known}")
    point = _points()[name]
    try:
        estimator = point.load()
    except Exception as e:
        raise UserError(
            f"the estimator {name!r} cannot be loaded from {point.value}: {type(e).__name__}: {e}",
            fix="mend or uninstall the package that provides it",
        ) from e
    if not isinstance(estimator, Estimator):
        raise UserError(
            f"the entry point {name!r} ({point.value}) is a {type(estimator).__name__}",
            expected="a horizonval.estimation.observation.Estimator",
        )
    return estimator


def run_safely(estimator: Estimator, observation: Observation) -> Fit | Refusal:
    """Run an estimator so that whatever it does becomes an outcome: exceptions, wrong types and NaN are crashes.

    Numbers are rounded to the digits that are results (:mod:`horizonval.estimation.digits`).
    """
    try:
        # What a user's own method returns may be anything.
        result: object = estimator.run(observation)
    except Exception as e:
        return crash(f"the estimator raised {raised(e)}", traceback_of(e))
    if isinstance(result, Refusal):
        if result.status is Outcome.VALID:
            return crash("the estimator returned a refusal with status valid")
        return result
    if not isinstance(result, Fit):
        return crash(f"the estimator returned a {type(result).__name__}, neither Fit nor Refusal")
    if not _is_sound(result):
        return crash("the estimator returned numbers that are none")
    return rounded(replace(result, estimates=estimator.estimates))


def _is_sound(fit: Fit) -> bool:
    arrays = [fit.nadir_cam, fit.covariance_nadir_cam]
    if fit.systematic_nadir_cam is not None:
        arrays.append(fit.systematic_nadir_cam)
    scalars = (fit.roll_rad, fit.pitch_rad, fit.angular_radius_rad, fit.altitude_m, fit.sigma_altitude_m)
    return (
        np.shape(fit.nadir_cam) == (3,)
        and all(np.shape(covariance) == (3, 3) for covariance in arrays[1:])
        and all(bool(np.all(np.isfinite(a))) for a in arrays)
        and all(v is None or math.isfinite(v) for v in scalars)
    )
