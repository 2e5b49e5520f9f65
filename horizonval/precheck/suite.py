"""Check a suite: its frames grouped by camera and band."""

from __future__ import annotations

from collections.abc import Sequence

from horizonval.core.errors import UserError
from horizonval.precheck.findings import Finding, Kind, sorted_findings
from horizonval.precheck.frames import Group, Watcher, cannot_run, sample_sizes, total_cost
from horizonval.precheck.limb import Needs
from horizonval.precheck.report import Report
from horizonval.precheck.rules import findings_of
from horizonval.precheck.text import group_line
from horizonval.spec.load import Case, Suite
from horizonval.suites.mistakes import refuse_mistakes
from horizonval.suites.plan import CasePlan, of_heads, plan_of
from horizonval.suites.record import camera_name

MOST_FRAMES = 400
"""Frames that a check looks at; some 0.05 s each."""


def check_suite(suite: Suite, *, most: int = MOST_FRAMES, infrared: bool = True) -> Report:
    """Say what a user ought to know of a suite before it is run.

    Parameters
    ----------
    suite : Suite
        As :func:`horizonval.suites.suite.load_suite` returns it.
    most : int
        Frames to look at; of more an even sample, whose size the report states.
    infrared : bool
        Whether to work out the level of thermal limbs, of one frame of every camera: up to 2 s for each band.

    Returns
    -------
    Report
        Findings by camera, and by band of cameras that have several. What a run would refuse
        (:func:`horizonval.suites.mistakes.refuse_mistakes`) is an error among them.
    """
    return check_groups("suite", suite.name, suite, by_camera(suite), most=most, infrared=infrared)


def check_groups(
    kind: Kind, name: str, suite: Suite, groups: Sequence[Group], *, most: int, infrared: bool, mistakes: bool = True
) -> Report:
    """Return the report of a suite whose frames are grouped; see :func:`check_suite`.

    Without ``mistakes`` what a run would refuse is not looked for, and there is no cost: what comes next says both.
    """
    findings: list[Finding] = []
    facts: dict[str, str] = {}
    if mistakes:
        try:
            refuse_mistakes(suite, plan_of(suite))
        except UserError as e:
            return Report(kind, name, tuple(map(cannot_run, e.mistakes)), facts, 0, len(suite.cases))
    watcher, looks = Watcher(), []
    for group, count in zip(groups, sample_sizes([group.count for group in groups], most), strict=True):
        look = watcher.look(group, count, infrared=infrared, cost=mistakes)
        looks.append(look)
        findings += look.errors[:1]
        for band, views in look.views.items():
            subject = f"{group.subject}, {band}" if len(look.views) > 1 else group.subject
            findings += findings_of(views, subject, total=len(group.cases))
            facts[subject] = group_line(views, len(group.cases))
    return Report(
        kind,
        name,
        sorted_findings(findings),
        facts,
        sum(look.examined for look in looks),
        len(suite.cases),
        total_cost(groups, looks, suite.keep, suite.draws) if mistakes else None,
    )


def needs_of(case: Case, plan: CasePlan) -> Needs:
    """Return what a case's estimators look through: all heads together where none looks at one image alone."""
    return "heads" if of_heads(case) and plan.together(case) and not plan.alone(case) else "image"


def estimators_of(case: Case, plan: CasePlan) -> int:
    """Return how many estimators run on every image of a case."""
    return len(plan.alone(case)) + (len(plan.together(case)) if of_heads(case) else 0)


def by_camera(suite: Suite) -> list[Group]:
    """Return a suite's frames grouped by camera, and by what runs on them."""
    plan = plan_of(suite)
    members: dict[tuple[str, Needs, int], list[Case]] = {}
    for case in suite.cases:
        try:
            key = (camera_name(case), needs_of(case, plan), estimators_of(case, plan))
        except UserError:
            # An estimator that does not exist is told by the check for mistakes.
            key = (camera_name(case), "image", 0)
        members.setdefault(key, []).append(case)
    return [Group(name, tuple(of), count, needs) for (name, needs, count), of in members.items()]
