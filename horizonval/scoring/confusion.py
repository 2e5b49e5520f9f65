"""Expected against reported outcomes: who says no, and for the right reason?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from horizonval.outcome import Outcome

BORDERLINE = "borderline"
"""Line of a matrix for frames that may fairly go either way."""
FALSE_VALID = "false_valid"
"""Column of a matrix for claims that are false; the column ``valid`` holds the others."""


def confusion(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    """Return ``{expected: {reported: n}}``, both in the order of the outcomes, empty cells left out."""
    counts: dict[str, Counter[str]] = {}
    for row in rows:
        counts.setdefault(row["expected"], Counter())[row["status"]] += 1
    return {expected: in_order(counts[expected]) for expected in sorted(counts, key=_rank)}


def strict_confusion(rows: Iterable[Mapping[str, Any]]) -> dict[str, dict[str, int]]:
    """Return the same with borderline frames on a line and false claims in a column of their own."""
    return confusion(
        {
            "expected": BORDERLINE if row.get("borderline") else row["expected"],
            "status": FALSE_VALID if row["false_valid"] else row["status"],
        }
        for row in rows
    )


def confusion_by_estimator(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, int]]]:
    """Return the strict matrix of every estimator, all cameras together."""
    names = sorted({row["estimator"] for row in rows})
    return {name: strict_confusion(row for row in rows if row["estimator"] == name) for name in names}


def in_order(counts: Mapping[str, int]) -> dict[str, int]:
    """Return counts in the order of the outcomes; anything else behind them by name."""
    return {outcome: counts[outcome] for outcome in sorted(counts, key=_rank)}


_ORDER = {str(outcome): i for i, outcome in enumerate(Outcome)}


def _rank(outcome: str) -> tuple[int, str]:
    return _ORDER.get(outcome, len(_ORDER)), outcome
