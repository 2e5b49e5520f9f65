"""The report of a run: one HTML file that needs nothing beside it."""

from horizonval.report.build import build_report

__all__ = ["build_report"]
