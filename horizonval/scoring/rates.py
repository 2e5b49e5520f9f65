"""Rates of rare things, with intervals that do not flatter.

The interval is Clopper and Pearson's (Biometrika 26, 404, 1934): it holds at least its confidence for any true rate,
also where nothing was seen. None in n trials still allows 3 / n (J. A. Hanley and A. Lippman-Hand, JAMA 249, 1743,
1983).

Frames that are borderline (:mod:`horizonval.scoring.expected`) take no part in availability and refusal. A false claim
or a crash counts wherever it is made.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from scipy import stats

from horizonval.core.outcome import Outcome
from horizonval.scoring.confusion import BEYOND_LIMIT, BEYOND_SIGMA, why_false
from horizonval.scoring.row import Row

CONFIDENCE = 0.95


def proportion(k: int, n: int) -> dict[str, Any]:
    """``{n: k, of: n, rate, interval}`` with the Clopper-Pearson 95 % interval; ``None`` for 0 of 0."""
    if n == 0:
        return {"n": 0, "of": 0, "rate": None, "interval": None}
    interval = stats.binomtest(k, n).proportion_ci(confidence_level=CONFIDENCE, method="exact")
    return {"n": k, "of": n, "rate": k / n, "interval": [float(interval.low), float(interval.high)]}


def upper_bound(k: int, n: int) -> float | None:
    """One-sided 95 % upper bound of a rate of which ``k`` of ``n`` were seen: the bound of "below 0.1 %"."""
    if n == 0:
        return None
    one_sided = stats.binomtest(k, n, alternative="less").proportion_ci(confidence_level=CONFIDENCE, method="exact")
    return float(one_sided.high)


def rates(rows: Sequence[Row]) -> dict[str, Any]:
    """Return what an estimator delivers and at what risk, from rows of results.

    Returns
    -------
    dict
        ``availability``: claims among the frames that should give an attitude. ``refusal``: the rest of them.
        ``bonus``: claims among the frames that should not. ``false_valid``: false ones among all claims, with
        ``upper_bound`` and, of them, how many are ``beyond_limit`` and ``beyond_sigma``; ``false_valid_frames``: false
        ones among all frames. ``claims_without_sigma``: how many claims claim no uncertainty and are judged by the
        default (:data:`horizonval.scoring.limits.DEFAULT_SIGMA_RAD`). ``crashed``: frames on which the estimator
        crashed, among all. ``n_borderline``: frames not counted in the first three.
    """
    claims = [row for row in rows if row.is_claim]
    clear = [row for row in rows if not row.borderline]
    due = [row for row in clear if row.is_due]
    others = [row for row in clear if not row.is_due]
    answered = sum(row.is_claim for row in due)
    reasons = Counter(why_false(row) for row in claims if row.false_valid)
    false = reasons.total()
    return {
        "availability": proportion(answered, len(due)),
        "refusal": proportion(len(due) - answered, len(due)),
        "bonus": proportion(sum(row.is_claim for row in others), len(others)),
        "false_valid": proportion(false, len(claims))
        | {"upper_bound": upper_bound(false, len(claims))}
        | {"beyond_limit": reasons[BEYOND_LIMIT], "beyond_sigma": reasons[BEYOND_SIGMA]},
        "false_valid_frames": proportion(false, len(rows)) | {"upper_bound": upper_bound(false, len(rows))},
        "claims_without_sigma": sum(row.without_sigma for row in claims),
        "crashed": proportion(sum(row.status == Outcome.CRASHED for row in rows), len(rows)),
        "n_borderline": len(rows) - len(clear),
    }
