"""The check that precedes a run: a sample of the frames, in a second or two."""

from __future__ import annotations

from dataclasses import replace

from horizonval.core.errors import UserError
from horizonval.precheck.findings import Kind
from horizonval.precheck.frames import Group
from horizonval.precheck.report import Report
from horizonval.precheck.study import by_design
from horizonval.precheck.suite import by_camera, check_groups
from horizonval.scoring import limits
from horizonval.spec.load import Suite
from horizonval.studies.trade.design import Study

FEW_FRAMES = 32
"""Frames that are looked at before a run, some 0.05 s each: it must not start more than some two seconds later."""

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
    return None if any(finding.code == "cannot-run" for finding in report.findings) else report


def _is_linear(group: Group) -> bool:
    geometry = group.cases[0].camera.camera
    return min(geometry.width, geometry.height) <= limits.LINEAR_PX
