"""Estimators by name for whoever asks them: ours as they are, others as a proxy of the process that they run in.

No package of others is ever imported here: what is to be known of an estimator is asked of its process, once.
"""

from __future__ import annotations

from functools import partial

from horizonval.core.outcome import Refusal
from horizonval.estimation import registry
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.estimation.process.limits import Limits
from horizonval.estimation.process.sandbox import sandbox_of


def get(name: str, limits: Limits | None = None) -> Estimator:
    """Return an estimator.

    One whose package cannot be imported is returned too: it crashes on every image.

    Parameters
    ----------
    name : str
    limits : Limits, optional
        Of an estimator of another package, and programs that are estimators by name.

    Raises
    ------
    UserError
        If there is none of that name.
    """
    limits = limits or Limits()
    run = partial(_run, name, limits)
    for program in limits.programs:
        if program.name == name:
            return Estimator(name, program.command, run, estimates=program.estimates)
    if not registry.is_foreign(name):
        return registry.get(name)
    said = sandbox_of(limits).describe(name)
    if isinstance(said, Refusal):
        return Estimator(name, name, run)
    return Estimator(name, said.title, run, estimates=said.estimates, needs=said.needs)


def _run(name: str, limits: Limits, observation: Observation) -> Fit | Refusal:
    return sandbox_of(limits).run(name, observation)
