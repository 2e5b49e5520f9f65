"""What one row means, in a word, a glyph and a colour; none of the three is needed to tell the others apart.

Colours are those of Okabe and Ito (2008), which people with any of the common colour vision deficiencies can tell
apart, darkened where they must be read as text on white.
"""

from __future__ import annotations

from dataclasses import dataclass

from horizonval.core.outcome import Outcome
from horizonval.scoring.row import Row


@dataclass(frozen=True)
class VerdictMark:
    """One kind of result: ``key`` for the page's code, ``marker`` for matplotlib."""

    key: str
    glyph: str
    label: str
    colour: str
    marker: str


FALSE_VALID = VerdictMark("false", "✖", "false claim", "#b34700", "X")
CRASHED = VerdictMark("crashed", "✱", "the estimator crashed", "#b34700", "*")
MISSED = VerdictMark("missed", "▼", "refused, though the limb is usable", "#8a6100", "v")
OTHER = VerdictMark("other", "◇", "refused, for another reason than expected", "#555555", "D")
FAIR = VerdictMark("fair", "▽", "refused, on a borderline frame", "#555555", "v")
REFUSED = VerdictMark("refused", "○", "refused, as expected", "#555555", "o")
BONUS = VerdictMark("bonus", "◐", "valid, though a refusal was expected", "#0072b2", "s")
VALID = VerdictMark("valid", "●", "valid", "#0072b2", "o")
BROKEN = VerdictMark("broken", "!", "the frame failed", "#b34700", "P")
NONE = VerdictMark("none", "–", "no result", "#555555", "_")

VERDICTS = (FALSE_VALID, CRASHED, MISSED, OTHER, FAIR, REFUSED, BONUS, VALID, BROKEN, NONE)
"""Worst first."""


def verdict_of(row: Row | None, *, broken: bool = False) -> VerdictMark:
    """Return the verdict on one row; ``broken``: the frame itself failed, so the row is not the estimator's doing.

    A crash is as bad on every frame. On a borderline frame a refusal is as fair as a claim that is not false.
    """
    if broken:
        return BROKEN
    if row is None:
        return NONE
    if row.false_valid:
        return FALSE_VALID
    if row.is_claim:
        return VALID if row.borderline or row.is_due else BONUS
    if row.status == Outcome.CRASHED:
        return CRASHED
    if row.borderline:
        return FAIR
    if row.is_due:
        return MISSED
    return REFUSED if row.status == row.expected else OTHER
