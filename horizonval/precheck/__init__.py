"""What a user ought to know before anything is rendered: exposure, arc in view, signal, determinability, cost.

Made from specifications and truth alone; the renderer is not loaded.
"""

from horizonval.precheck.before import check_before_run, expected_of
from horizonval.precheck.findings import Finding, Level
from horizonval.precheck.report import Report
from horizonval.precheck.scene import check_scene
from horizonval.precheck.study import check_study
from horizonval.precheck.suite import check_suite
from horizonval.precheck.target import check

__all__ = [
    "Finding",
    "Level",
    "Report",
    "check",
    "check_before_run",
    "check_scene",
    "check_study",
    "check_suite",
    "expected_of",
]
