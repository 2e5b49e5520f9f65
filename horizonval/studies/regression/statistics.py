"""Statistics of scenes drawn anew: estimates of a difference with their bounds, and the resulting verdicts.

*Means.* Answers on one scene are correlated. The scene is therefore the unit: its values are averaged, and the
averages of the two sets are compared with Welch's t (B. L. Welch, Biometrika 34, 28, 1947), which holds for any
dependence within a scene.

*Proportions.* Newcombe's hybrid of two Wilson intervals (Statistics in Medicine 17, 873, 1998, method 10), and Fisher's
exact test.

*Several gates.* Holm's adjusted p-values (S. Holm, Scand. J. Statist. 6, 65, 1979): the k-th smallest of m is
multiplied by m - k + 1, and no adjusted value may be smaller than one before it. The probability of rejecting any true
null hypothesis at level alpha is then at most alpha, for any dependence of the tests.

*Verdicts*, with the margin delta declared beforehand and one-sided bounds:

* PASS: the upper 95 % bound is below delta;
* FAIL: the lower 99 % bound is above 0 after Holm's adjustment over all gates, and the estimate above delta / 2 (a
  smaller difference does not matter, however certain);
* IMPROVED: the mirror of FAIL; it needs a new baseline and passes;
* INCONCLUSIVE: everything else.

FAIL goes before PASS: a certain difference inside the margin is a regression that would otherwise accumulate.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from scipy import stats

from horizonval.core.arrays import FloatArray

PASS_CONFIDENCE = 0.95
FAIL_CONFIDENCE = 0.99


@dataclass(frozen=True)
class Estimate:
    """A difference "now minus baseline", positive where now is worse, in the gate's unit.

    ``lower95`` to ``upper99``: one-sided bounds, 95 % for PASS, 99 % for FAIL and IMPROVED. ``p_worse``, ``p_better``:
    one-sided p-values of "no difference". ``n``: values of this night; ``clusters``: scenes among them.
    """

    value: float
    lower95: float
    upper95: float
    lower99: float
    upper99: float
    p_worse: float
    p_better: float
    n: int
    clusters: int

    def to_dict(self) -> dict[str, Any]:
        """Return plain data; infinite bounds (too few data) as None."""
        return {key: value if abs(value) != float("inf") else None for key, value in asdict(self).items()}


def exact(value: float, n: int, clusters: int) -> Estimate:
    """Return the estimate of a difference without random variation."""
    worse, better = (0.0 if value > 0 else 1.0), (0.0 if value < 0 else 1.0)
    return Estimate(value, value, value, value, value, worse, better, n, clusters)


FEWEST_CLUSTERS = 5
"""Minimum number of scenes: bounds from four differences would depend on the assumed normality."""


def independent_difference(
    now: Sequence[float], now_clusters: Sequence[Hashable], base: Sequence[float], base_clusters: Sequence[Hashable]
) -> Estimate | None:
    """Return the difference of means over different scenes; None below :data:`FEWEST_CLUSTERS` scenes."""
    a, b = cluster_means(now, now_clusters), cluster_means(base, base_clusters)
    if min(len(a), len(b)) < FEWEST_CLUSTERS:
        return None
    value = float(np.mean(a) - np.mean(b))
    if np.ptp(a) == np.ptp(b) == 0.0:
        return exact(value, len(now), len(a))
    worse = stats.ttest_ind(a, b, equal_var=False, alternative="greater")
    better = stats.ttest_ind(a, b, equal_var=False, alternative="less")
    error = float(np.hypot(stats.sem(a), stats.sem(b)))
    return Estimate(
        value,
        *_bounds(value, error, float(worse.df)),
        float(worse.pvalue),
        float(better.pvalue),
        len(now),
        len(a),
    )


def cluster_means(values: Sequence[float], clusters: Sequence[Hashable]) -> FloatArray:
    """Return the mean of every cluster, in the order of first occurrence."""
    groups: dict[Hashable, list[float]] = {}
    for value, cluster in zip(values, clusters, strict=True):
        groups.setdefault(cluster, []).append(value)
    return np.array([np.mean(group) for group in groups.values()], dtype=np.float64)


def _bounds(value: float, error: float, freedom: float) -> tuple[float, float, float, float]:
    pass_t, fail_t = (float(stats.t.ppf(c, freedom)) * error for c in (PASS_CONFIDENCE, FAIL_CONFIDENCE))
    return value - pass_t, value + pass_t, value - fail_t, value + fail_t


def independent_loss(good_before: int, n_before: int, good_now: int, n_now: int) -> Estimate | None:
    """Return the loss between two independent sets of frames, one frame a scene; None with too few."""
    if min(n_before, n_now) < FEWEST_CLUSTERS:
        return None
    bounds = [
        newcombe_interval(good_before, n_before, good_now, n_now, 2 * c - 1) for c in (PASS_CONFIDENCE, FAIL_CONFIDENCE)
    ]
    table = [[good_before, n_before - good_before], [good_now, n_now - good_now]]
    worse = float(stats.fisher_exact(table, alternative="greater").pvalue)
    better = float(stats.fisher_exact(table, alternative="less").pvalue)
    value = good_before / n_before - good_now / n_now
    return Estimate(value, *bounds[0], *bounds[1], min(worse, 1.0), min(better, 1.0), n_now, n_now)


def newcombe_interval(k1: int, n1: int, k2: int, n2: int, confidence: float) -> tuple[float, float]:
    """Return the hybrid score interval of ``k1 / n1 - k2 / n2``."""
    p1, p2 = k1 / n1, k2 / n2
    l1, u1 = stats.binomtest(k1, n1).proportion_ci(confidence, method="wilson")
    l2, u2 = stats.binomtest(k2, n2).proportion_ci(confidence, method="wilson")
    difference = p1 - p2
    return difference - math.hypot(p1 - l1, u2 - p2), difference + math.hypot(u1 - p1, p2 - l2)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return adjusted p-values in the given order. Raises ``ValueError``: a value outside 0 to 1."""
    p = np.asarray(p_values, dtype=np.float64)
    if p.size == 0:
        return []
    if not np.all((p >= 0.0) & (p <= 1.0)):
        raise ValueError("p-values lie between 0 and 1")
    order = np.argsort(p, kind="stable")
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(p.size, 0, -1)), 1.0)
    return [float(value) for value in adjusted]


ALPHA = 0.01
"""Probability of any FAIL in a night without changes; the same again for any IMPROVED."""


class Verdict(StrEnum):
    """Verdict on a gate or a night; INCOMPLETE is a night's only."""

    PASS = "PASS"
    FAIL = "FAIL"
    IMPROVED = "IMPROVED"
    INCONCLUSIVE = "INCONCLUSIVE"
    INCOMPLETE = "INCOMPLETE"


def decide(
    estimates: Sequence[Estimate | None], margins: Sequence[float], looks: int = 1
) -> list[tuple[Verdict, float | None]]:
    """Return the verdict and the adjusted p-value of every gate of a night.

    ``estimates``: None gives INCONCLUSIVE. ``margins``: above 0, in the estimates' units. ``looks``: number of interim
    analyses that share the level.
    """
    known = [(i, estimate) for i, estimate in enumerate(estimates) if estimate is not None]
    worse, better = (
        dict(zip([i for i, _ in known], holm(p), strict=True))
        for p in ([e.p_worse for _, e in known], [e.p_better for _, e in known])
    )
    level = ALPHA / looks
    found: list[tuple[Verdict, float | None]] = []
    for i, (estimate, margin) in enumerate(zip(estimates, margins, strict=True)):
        if estimate is None:
            found.append((Verdict.INCONCLUSIVE, None))
            continue
        if worse[i] < level and estimate.value > margin / 2:
            verdict = Verdict.FAIL
        elif better[i] < level and estimate.value < -margin / 2:
            verdict = Verdict.IMPROVED
        else:
            verdict = Verdict.PASS if estimate.upper95 < margin else Verdict.INCONCLUSIVE
        found.append((verdict, worse[i]))
    return found
