"""Expected against reported outcomes: who says no, and for the right reason?

Counted strictly, a claim that is false is no valid answer, whatever was expected, and is told apart by what makes it
false; frames that may fairly go either way have a line of their own.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from horizonval.core.outcome import Outcome
from horizonval.scoring.limits import claim_limits
from horizonval.scoring.row import Row

BORDERLINE = "borderline"
"""Line of a matrix for frames that may fairly go either way."""
BEYOND_LIMIT = "false_beyond_limit"
BEYOND_SIGMA = "false_beyond_sigma"
"""Columns of a matrix for claims that are false; the column ``valid`` holds the others."""


def why_false(row: Row) -> str | None:
    """Return what makes a claim false: its error, else an error beyond its own sigma; ``None`` where it is not.

    A claim whose error is no number is beyond every limit.
    """
    if not row.false_valid:
        return None
    limit_arcsec = math.degrees(claim_limits(row.estimator).nadir_error_rad) * 3600.0
    if row.nadir_error_arcsec is None or row.nadir_error_arcsec > limit_arcsec:
        return BEYOND_LIMIT
    return BEYOND_SIGMA


def confusion(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """Return ``{expected: {reported: n}}``, both in the order of the outcomes, empty cells left out."""
    return _matrix((row.expected, row.status) for row in rows)


def strict_confusion(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """Return the same with borderline frames on a line and false claims in a column of their own."""
    return _matrix((BORDERLINE if row.borderline else row.expected, why_false(row) or row.status) for row in rows)


def confusion_by_estimator(rows: Sequence[Row]) -> dict[str, dict[str, dict[str, int]]]:
    """Return the strict matrix of every estimator, all cameras together."""
    names = sorted({row.estimator for row in rows})
    return {name: strict_confusion(row for row in rows if row.estimator == name) for name in names}


def _matrix(cells: Iterable[tuple[str, str]]) -> dict[str, dict[str, int]]:
    counts: dict[str, Counter[str]] = {}
    for expected, reported in cells:
        counts.setdefault(expected, Counter())[reported] += 1
    return {expected: in_order(counts[expected]) for expected in sorted(counts, key=_rank)}


def in_order(counts: Mapping[str, int]) -> dict[str, int]:
    """Return counts in the order of the outcomes, false claims behind the valid ones; anything else last by name."""
    return {outcome: counts[outcome] for outcome in sorted(counts, key=_rank)}


_FIRST = (str(Outcome.VALID), BEYOND_LIMIT, BEYOND_SIGMA)
_NAMES = (*_FIRST, *(str(outcome) for outcome in Outcome if str(outcome) not in _FIRST), BORDERLINE)
_ORDER = {name: i for i, name in enumerate(_NAMES)}


def _rank(name: str) -> tuple[int, str]:
    return _ORDER.get(name, len(_ORDER)), name
