"""The report of a run as self-contained HTML pages."""

from horizonval.report.build import build_report

__all__ = ["build_report"]
