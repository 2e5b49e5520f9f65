"""From an estimate and a margin to a verdict; four words, never merged.

With the margin delta declared beforehand and bounds that are one-sided:

* PASS: the upper 95 % bound lies below delta (not worse by as much as matters);
* FAIL: the lower 99 % bound lies above 0 after Holm's adjustment over all gates, and the estimate above delta / 2 (a
  difference that is certain but of no matter is none);
* IMPROVED: the mirror of FAIL; it asks for a new baseline and passes;
* INCONCLUSIVE: everything else.

FAIL goes before PASS: a difference may be both certain and inside the margin, and then it is a regression that the
margin would let through bit by bit. A gate with two sides (a bias, of which neither sign is better) passes inside
+-delta and fails on either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

from horizonval.studies.regression.statistics.estimate import Estimate
from horizonval.studies.regression.statistics.holm import holm

ALPHA = 0.01
"""Chance of any FAIL in a night in which nothing has changed; the same again for any IMPROVED."""


class Verdict(StrEnum):
    """What came of a gate, an anchor or a night."""

    PASS = "PASS"
    FAIL = "FAIL"
    IMPROVED = "IMPROVED"
    INCONCLUSIVE = "INCONCLUSIVE"


def decide(
    estimates: Sequence[Estimate | None], margins: Sequence[float], two_sided: Sequence[bool], looks: int = 1
) -> list[tuple[Verdict, float | None]]:
    """Return the verdict and the adjusted p-value of every gate of a night.

    Parameters
    ----------
    estimates : sequence of Estimate or None
        None where there is too little to estimate from: INCONCLUSIVE.
    margins : sequence of float
        Above 0, in the estimates' units.
    two_sided : sequence of bool
    looks : int
        How often the data may be looked at before the verdict is final; the level is shared among them.
    """
    known = [i for i, estimate in enumerate(estimates) if estimate is not None]
    worse = dict(zip(known, holm([_p_worse(estimates[i], two_sided[i]) for i in known]), strict=True))
    better = dict(zip(known, holm([_p_better(estimates[i]) for i in known]), strict=True))
    level = ALPHA / looks
    found: list[tuple[Verdict, float | None]] = []
    for i, (estimate, margin) in enumerate(zip(estimates, margins, strict=True)):
        if estimate is None:
            found.append((Verdict.INCONCLUSIVE, None))
        elif two_sided[i]:
            found.append((_two_sided(estimate, margin, worse[i] < level), worse[i]))
        else:
            found.append((_one_sided(estimate, margin, worse[i] < level, better[i] < level), worse[i]))
    return found


def night_verdict(verdicts: Sequence[Verdict]) -> Verdict:
    """Return the night's verdict: any FAIL, else any INCONCLUSIVE, else any IMPROVED, else PASS."""
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.IMPROVED):
        if verdict in verdicts:
            return verdict
    return Verdict.PASS if verdicts else Verdict.INCONCLUSIVE


def _one_sided(estimate: Estimate, margin: float, surely_worse: bool, surely_better: bool) -> Verdict:
    if surely_worse and estimate.value > margin / 2:
        return Verdict.FAIL
    if surely_better and estimate.value < -margin / 2:
        return Verdict.IMPROVED
    return Verdict.PASS if estimate.upper95 < margin else Verdict.INCONCLUSIVE


def _two_sided(estimate: Estimate, margin: float, surely_different: bool) -> Verdict:
    if surely_different and abs(estimate.value) > margin / 2:
        return Verdict.FAIL
    return Verdict.PASS if -margin < estimate.lower95 and estimate.upper95 < margin else Verdict.INCONCLUSIVE


def _p_worse(estimate: Estimate | None, two_sided: bool) -> float:
    assert estimate is not None
    return min(1.0, 2 * min(estimate.p_worse, estimate.p_better)) if two_sided else estimate.p_worse


def _p_better(estimate: Estimate | None) -> float:
    assert estimate is not None
    return estimate.p_better
