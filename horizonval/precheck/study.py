"""Check a trade study: its frames grouped by design."""

from __future__ import annotations

from horizonval.precheck.frames import Group
from horizonval.precheck.report import Report
from horizonval.precheck.suite import MOST_FRAMES, check_groups, estimators_of, needs_of
from horizonval.spec.load import Case
from horizonval.studies.trade.design import Study
from horizonval.suites.plan import plan_of


def check_study(study: Study, *, most: int = MOST_FRAMES, infrared: bool = True) -> Report:
    """Say what a user ought to know of a study before it is run.

    Designs that differ in the estimator alone share their frames, and are one entry here.

    Parameters
    ----------
    study : Study
        As :func:`horizonval.studies.trade.design.expand` returns it.
    most, infrared
        As for :func:`horizonval.precheck.suite.check_suite`.

    Returns
    -------
    Report
        Findings by entry of ``[design]``, and by band of cameras that have several.
    """
    name = study.spec.study.name
    return check_groups("study", name, study.suite, by_design(study), most=most, infrared=infrared)


def by_design(study: Study) -> list[Group]:
    """Return a study's frames grouped by the entry of ``[design]``."""
    plan = plan_of(study.suite)
    members: dict[str, list[Case]] = {}
    for case in study.suite.cases:
        members.setdefault(study.frames[case.name][0], []).append(case)
    return [
        Group(name, tuple(cases), estimators_of(cases[0], plan), needs_of(cases[0], plan))
        for name, cases in members.items()
    ]
