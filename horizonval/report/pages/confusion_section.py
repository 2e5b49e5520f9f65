"""Expected against reported outcomes as tables of a page: one for each estimator, counted strictly.

Lines are what a frame should give, from its truth alone; columns what was reported, with the claims that are false
apart and told by their reason. Every cell has the glyph of what it means, so that no colour is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from horizonval.core.outcome import Outcome
from horizonval.report import formatting
from horizonval.report.verdict import BONUS, CRASHED, FALSE_VALID, MISSED, OTHER, REFUSED, VALID, VerdictMark
from horizonval.scoring import limits
from horizonval.scoring.row import Row
from horizonval.scoring.summary import BEYOND_LIMIT, BEYOND_SIGMA, BORDERLINE, in_order, strict_confusion

COLUMN_WORDS = {
    BEYOND_LIMIT: "false: beyond the limit of the error",
    BEYOND_SIGMA: f"false: beyond {limits.SIGMA_LIMIT:g} of its own sigma",
}


def matrices_of(rows: Sequence[Row], estimators: Sequence[str]) -> list[dict[str, Any]]:
    """Return the table of every estimator, all cameras together.

    Returns
    -------
    list of dict
        ``estimator``, ``n``, ``reported`` (the columns' words) and ``lines``: ``expected``, ``meaning``, ``total``,
        ``apart`` (the line of borderline frames, always the last) and ``cells`` of ``n``, ``share`` of the line,
        ``kind`` (a class of the style sheet) and ``glyph``.
    """
    return [_matrix([row for row in rows if row.estimator == name], name) for name in estimators]


def _matrix(rows: Sequence[Row], estimator: str) -> dict[str, Any]:
    counts = strict_confusion(rows)
    columns = list(in_order({reported: 1 for line in counts.values() for reported in line}))
    lines = []
    for expected, count_by_outcome in counts.items():
        total = sum(count_by_outcome.values())
        cells = []
        for reported in columns:
            n = count_by_outcome.get(reported, 0)
            kind, verdict = _look(expected, reported)
            cells.append(
                {
                    "n": n,
                    "share": n / total,
                    "kind": kind if n else "zero",
                    "glyph": "" if verdict is None or not n else verdict.glyph,
                }
            )
        apart = expected == BORDERLINE
        meaning = "either answer is fair" if apart else formatting.meaning(expected)
        lines.append({"expected": expected, "meaning": meaning, "cells": cells, "total": total, "apart": apart})
    words = [COLUMN_WORDS.get(name, formatting.outcome(name)) for name in columns]
    return {"estimator": estimator, "n": len(rows), "reported": words, "lines": lines}


def _look(expected: str, reported: str) -> tuple[str, VerdictMark | None]:
    """Return the class of a cell and the verdict whose glyph it has."""
    if reported in COLUMN_WORDS:
        return "alarm", FALSE_VALID
    if reported == Outcome.CRASHED:
        return "alarm", CRASHED
    if expected == BORDERLINE:
        return "fair", None
    if reported == Outcome.VALID:
        return ("same", VALID) if expected == Outcome.VALID else ("wrong", BONUS)
    if expected == Outcome.VALID:
        return "wrong", MISSED
    return ("same", REFUSED) if reported == expected else ("other", OTHER)
