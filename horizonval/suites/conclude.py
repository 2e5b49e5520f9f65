"""What is made of all rows at the end: the table, the summary, the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from horizonval.core.code import code_version
from horizonval.scoring.row import Row
from horizonval.store.folder import RunFolder, read_json, write_json


def conclude(
    folder: RunFolder,
    suite: str | None,
    rows: Sequence[Row],
    failed: Mapping[str, str],
    more: Mapping[str, Any] | None = None,
) -> tuple[dict[str, Any], list[Path]]:
    """Write table, summary and report; return the summary and the report's pages, the first one first.

    Parameters
    ----------
    suite : str or None
        Name of the suite, where it is known.
    failed : mapping of str to str
        Cases without a result, and why.
    more : mapping, optional
        What else the summary holds.
    """
    from horizonval.report.build import write_report
    from horizonval.scoring.row import write_results
    from horizonval.scoring.summary import summarise

    about = read_json(folder.suite) or {}
    statistics = summarise(
        rows, about.get("given_pose") or (), frozenset(about.get("orbit") or ()), about.get("likelihood") or ()
    )
    summary = {"suite": suite, "version": code_version(), "failed": dict(failed), **statistics, **(more or {})}
    write_results(rows, folder.results)
    write_json(folder.summary, summary)
    return summary, write_report(folder.root)
