"""What an estimator does with a camera, in a line: how often it works, where it does not, how far off it is at most.

It *works* where it claims an attitude that is not false. Counted are all frames of an orbit, eclipse included, for a
satellite flies through all of it; and, apart, the frames that are due an answer. Where it gives no answer or a wrong
one is told by what was in view, from the truth alone.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

from horizonval.core.outcome import Outcome
from horizonval.scoring.rates import proportion
from horizonval.scoring.row import Row

NOT_MADE = "in frames that could not be made"
NO_LIMB = "with too little limb in view"
SUN = "with the Sun in the frame"
NIGHT = "on the night side"
TERMINATOR = "at the terminator"
SATURATED = "with a saturated limb"
CLEAR = "with a clear limb"


def condition_of(row: Row) -> str:
    """Return what was in view, as words of a sentence: the first that applies of those above, in their order."""
    if row.epoch_utc is None:
        return NOT_MADE
    if row.lit_fraction is None or row.expected in (Outcome.NO_LIMB, Outcome.SHORT_ARC):
        return NO_LIMB
    if row.sun_in_frame:
        return SUN
    if row.lit_fraction < 1.0:
        return TERMINATOR if row.lit_fraction > 0.0 else NIGHT
    return SATURATED if row.expected == Outcome.SATURATED else CLEAR


def headline(rows: Sequence[Row], orbit: Collection[str] = ()) -> dict[str, Any]:
    """Return what a line says of rows of one estimator.

    Parameters
    ----------
    rows : sequence of Row
    orbit : collection of str, optional
        Names of the cases that are samples of an orbit, evenly spread along it.

    Returns
    -------
    dict
        ``orbit`` and ``due``: of the frames along an orbit, and of those that are due an answer, how many it worked in,
        as :func:`horizonval.scoring.rates.proportion`; samples of an orbit are no random ones, so that its interval
        is left out. ``false``, ``crashed``, ``silent``: where, as ``[condition, n, of]`` the most first, ``of`` all
        frames of that condition. ``worst_arcsec``: the largest error of any claim, with ``n``, the claims.
    """
    flown = [row for row in rows if row.case in orbit]
    due = [row for row in rows if row.is_due]
    errors = [row.nadir_error_arcsec for row in rows if row.is_claim and row.nadir_error_arcsec is not None]
    crashed = [row for row in rows if row.status == Outcome.CRASHED]
    silent = [row for row in rows if not row.is_claim and row.status != Outcome.CRASHED]
    return {
        "orbit": {**proportion(sum(row.is_right for row in flown), len(flown)), "interval": None},
        "due": proportion(sum(row.is_right for row in due), len(due)),
        "false": _where([row for row in rows if row.is_claim and row.false_valid], rows),
        "crashed": _where(crashed, rows),
        "silent": _where(silent, rows),
        "worst_arcsec": max(errors, default=None),
        "n": len(errors),
    }


def _where(some: Sequence[Row], rows: Sequence[Row]) -> list[list[Any]]:
    conditions = [condition_of(row) for row in some]
    everywhere = [condition_of(row) for row in rows]
    return [
        [condition, conditions.count(condition), everywhere.count(condition)]
        for condition in sorted(set(conditions), key=lambda name: (-conditions.count(name), name))
    ]
