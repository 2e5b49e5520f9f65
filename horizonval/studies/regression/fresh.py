"""Scenes drawn anew: would the verdict on the frozen scenes hold on others? Estimates with intervals.

Every method, camera and band is judged by itself. Other scenes than the baseline's differ by chance, so the margins are
coarse and a gate may be INCONCLUSIVE. A crash needs no interval.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from horizonval.core.outcome import Outcome
from horizonval.spec.suite import FRESH_METRICS, STANDING, Metric, RegressionSpec
from horizonval.studies.regression.gates import PERCENT, group_of, margin_of
from horizonval.studies.regression.partners import Group
from horizonval.studies.regression.row import ReplicateRow
from horizonval.studies.regression.statistics import (
    Estimate,
    Verdict,
    decide,
    exact,
    independent_difference,
    independent_loss,
)

ERRORS: Mapping[Metric, str] = {"nadir_error": "nadir_error_arcsec", "error_over_bound": "error_over_bound"}
"""Metrics whose mean over claims is compared."""


def judge_fresh(
    spec: RegressionSpec,
    now: Iterable[ReplicateRow],
    base: Iterable[ReplicateRow],
    cameras: Mapping[str, str],
    against: str = "accepted",
) -> list[dict[str, Any]]:
    """Return every metric of every method, camera and band on other scenes, with its verdict.

    p-values are adjusted over all of them together. A method that one of the sets does not have is left out.
    """
    mine, theirs = _groups(now, cameras), _groups(base, cameras)
    found: list[tuple[dict[str, Any], Estimate | None]] = []
    for group in sorted(mine.keys() & theirs.keys()):
        for metric in FRESH_METRICS:
            one = _measured(spec, metric, group, mine[group], theirs[group])
            if one is not None:
                found.append(
                    (one[0] | {"against": against, "lane": "fresh", "metric": metric, **group._asdict()}, one[1])
                )
    judged = decide([estimate for _, estimate in found], [gate["margin"] for gate, _ in found], spec.most_batches)
    return [
        gate | {"verdict": gate["verdict"] or str(verdict), "p_adjusted": p}
        for (gate, _), (verdict, p) in zip(found, judged, strict=True)
    ]


def _groups(rows: Iterable[ReplicateRow], cameras: Mapping[str, str]) -> dict[Group, list[ReplicateRow]]:
    groups: dict[Group, list[ReplicateRow]] = {}
    for row in rows:
        groups.setdefault(group_of(row, cameras), []).append(row)
    return groups


def _measured(
    spec: RegressionSpec, metric: Metric, group: Group, now: Sequence[ReplicateRow], base: Sequence[ReplicateRow]
) -> tuple[dict[str, Any], Estimate | None] | None:
    """Return what is known of a gate and its estimate; None where the metric does not apply."""
    verdict = ""
    estimate: Estimate | None
    if metric in ERRORS:
        name = ERRORS[metric]
        values, others = (
            [(v, row.case) for row in rows if (v := getattr(row, name)) is not None] for rows in (now, base)
        )
        if not others:
            return None
        before, after = (float(np.mean([v for v, _ in own])) if own else 0.0 for own in (others, values))
        estimate = independent_difference(
            [v for v, _ in values],
            [scene for _, scene in values],
            [v for v, _ in others],
            [scene for _, scene in others],
        )
    elif metric == "crashes":
        before, after = (float(sum(row.status == Outcome.CRASHED for row in rows)) for rows in (base, now))
        verdict = str(Verdict.FAIL if after and not before else Verdict.PASS)
        estimate = exact(0.0, len(now), len({row.case for row in now}))
    else:
        if metric == "availability":
            now, base = ([row for row in rows if row.is_due] for rows in (now, base))
        if not now or not base:
            return None
        good = [
            [row.is_claim if metric == "availability" else not row.false_valid for row in rows] for rows in (base, now)
        ]
        shares = [PERCENT * float(np.mean(own)) for own in good]
        before, after = shares if metric == "availability" else [PERCENT - share for share in shares]
        estimate = _in_points(independent_loss(sum(good[0]), len(good[0]), sum(good[1]), len(good[1])))
    margin, reason = margin_of(spec, "fresh", metric, group, before)
    if margin is None:
        return None
    plain = None if estimate is None else estimate.to_dict()
    change = None if estimate is None else estimate.value
    about = {"verdict": verdict, "before": before, "now": after, "change": change, "margin": margin, "reason": reason}
    return about | {
        "unit": STANDING[metric].unit,
        "n": len(now),
        "estimate": plain,
        "scenes": [],
        "n_scenes": 0,
    }, estimate


def _in_points(estimate: Estimate | None) -> Estimate | None:
    """Return a share in percentage points."""
    if estimate is None:
        return None
    names = ("value", "lower95", "upper95", "lower99", "upper99")
    return replace(estimate, **{name: PERCENT * getattr(estimate, name) for name in names})
