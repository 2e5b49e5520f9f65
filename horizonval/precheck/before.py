"""The check that precedes a run: a sample of the frames, in a second or two; and what the frames will take."""

from __future__ import annotations

from dataclasses import replace

from horizonval.core.errors import UserError
from horizonval.jobs.engine import ExpectedTime
from horizonval.precheck.cost import column_key, json_of_bands
from horizonval.precheck.findings import Kind
from horizonval.precheck.frames import Group, Watcher
from horizonval.precheck.report import Report
from horizonval.precheck.study import by_design
from horizonval.precheck.suite import by_camera, check_groups
from horizonval.renderer.scene.shared_view import shared_view
from horizonval.scoring import limits
from horizonval.spec.load import Case, Suite
from horizonval.studies.trade.design import Study

FEW_FRAMES = 32
"""Frames that are looked at before a run, some 0.05 s each: it must not start more than some two seconds later."""

FRAMES_FOR_COST = 3
"""Frames of every camera from which the time that a run takes is told."""

FEW_LINEAR = 2
"""Of each linear array: its horizon is followed in steps of a thousandth of a pixel, for some 0.2 s."""


def check_before_run(target: Suite | Study) -> Report | None:
    """Return a report of an even sample of the frames, without thermal levels and cost.

    None where the run itself is about to say what is wrong with the file.
    """
    try:
        suite = target.suite if isinstance(target, Study) else target
        groups = by_design(target) if isinstance(target, Study) else by_camera(target)
        groups = [replace(group, most=FEW_LINEAR) if _is_linear(group) else group for group in groups]
        kind: Kind = "study" if isinstance(target, Study) else "suite"
        report = check_groups(kind, suite.name, suite, groups, most=FEW_FRAMES, infrared=False, mistakes=False)
    except UserError:
        return None
    if any(finding.code == "cannot-run" for finding in report.findings):
        return None
    return replace(report, source=target.suite.source if isinstance(target, Study) else target.source)


def expected_of(target: Suite | Study) -> dict[str, ExpectedTime]:
    """Return what each frame is expected to take, by the cases' names, from a few frames of every camera.

    Empty where the run itself is about to say what is wrong with the file.
    """
    suite = target.suite if isinstance(target, Study) else target
    watcher, expected = Watcher(), {}
    try:
        for group in by_camera(suite):
            bands: dict[str, list[Case]] = {}
            for case in group.cases:
                bands.setdefault(json_of_bands(case.camera), []).append(case)
            for cases in bands.values():
                alike = Group(group.subject, tuple(cases), group.estimators, group.needs)
                costs = watcher.look(alike, FRAMES_FOR_COST, infrared=False).costs
                if not costs:
                    return {}
                seconds = sum(c.render_s + (c.observe_s + c.estimate_s) * suite.draws for c in costs) / len(costs)
                once_s, place_s = costs[0].tables_s, sum(c.view_tables_s for c in costs) / len(costs)
                for case in cases:
                    once = {str(column_key(case.scene, case.camera)): once_s} if once_s else {}
                    once |= {shared_view(case.scene, case.camera): place_s} if place_s else {}
                    expected[case.name] = ExpectedTime(seconds, once)
    except UserError:
        return {}
    return expected


def _is_linear(group: Group) -> bool:
    geometry = group.cases[0].camera.camera
    return min(geometry.width, geometry.height) <= limits.LINEAR_PX
