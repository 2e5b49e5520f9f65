"""Statistics of a night: estimates of a difference with their bounds, and the resulting verdicts.

*Means.* Pairs of one scene (other noise, other estimators) are correlated. The scene is therefore the unit: its pairs
are averaged, and Student's t is used on the averages, which holds for any dependence within a scene. Pairs with the
same scene and noise seed also share their errors: with a correlation rho between two runs, the variance of the
difference falls by 1 - rho.

*Proportions of the same frames.* Only frames with a changed outcome count: ``lost`` became worse, ``gained`` better.
The interval is the score interval (T. Tango, Statistics in Medicine 17, 891, 1998), which keeps its confidence with
hardly any changes: none in n still allows z^2 / (n + z^2). The p-value is exact: under the null hypothesis the net loss
of each scene is as likely to have the opposite sign, so the sum over scenes is compared with all its sign changes. For
scenes with one changed frame each, this is McNemar's exact test (Psychometrika 12, 153, 1947).

*Proportions of two independent sets.* Newcombe's hybrid of two Wilson intervals (Statistics in Medicine 17, 873, 1998,
method 10), and Fisher's exact test.

*Several gates.* Holm's adjusted p-values (S. Holm, Scand. J. Statist. 6, 65, 1979): the k-th smallest of m is
multiplied by m - k + 1, and no adjusted value may be smaller than one before it. The probability of rejecting any true
null hypothesis at level alpha is then at most alpha, for any dependence of the tests.

*Verdicts*, with the margin delta declared beforehand and one-sided bounds:

* PASS: the upper 95 % bound is below delta;
* FAIL: the lower 99 % bound is above 0 after Holm's adjustment over all gates, and the estimate above delta / 2 (a
  smaller difference does not matter, however certain);
* IMPROVED: the mirror of FAIL; it needs a new baseline and passes;
* INCONCLUSIVE: everything else.

FAIL goes before PASS: a certain difference inside the margin is a regression that would otherwise accumulate. A gate
with two sides (a bias, of which neither sign is better) passes inside +-delta and fails on either side.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from scipy import optimize, stats

from horizonval.core.arrays import FloatArray

PASS_CONFIDENCE = 0.95
FAIL_CONFIDENCE = 0.99


@dataclass(frozen=True)
class Estimate:
    """A difference "now minus baseline", positive where now is worse, in the gate's unit.

    ``lower95`` to ``upper99``: one-sided bounds, 95 % for PASS, 99 % for FAIL and IMPROVED. ``p_worse``, ``p_better``:
    one-sided p-values of "no difference". ``n``: pairs, or values of this night without pairs; ``clusters``: scenes
    among them.
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


def paired_difference(differences: Sequence[float], clusters: Sequence[Hashable]) -> Estimate | None:
    """Return the mean difference (now minus baseline) over scenes; None below :data:`FEWEST_CLUSTERS` scenes.

    ``clusters``: the scene of each pair.
    """
    means = cluster_means(differences, clusters)
    if len(means) < FEWEST_CLUSTERS:
        return None
    value, n = float(np.mean(means)), len(differences)
    if np.ptp(means) == 0.0:
        return exact(value, n, len(means))
    return Estimate(
        value,
        *_bounds(value, float(stats.sem(means)), len(means) - 1),
        float(stats.ttest_1samp(means, 0.0, alternative="greater").pvalue),
        float(stats.ttest_1samp(means, 0.0, alternative="less").pvalue),
        n,
        len(means),
    )


def independent_difference(
    now: Sequence[float], now_clusters: Sequence[Hashable], base: Sequence[float], base_clusters: Sequence[Hashable]
) -> Estimate | None:
    """Return the difference of means over different scenes (B. L. Welch, Biometrika 34, 28, 1947); None as above."""
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


def paired_loss(before: Sequence[bool], now: Sequence[bool], clusters: Sequence[Hashable]) -> Estimate | None:
    """Return the share of good frames before minus the share now; None with too few scenes.

    ``clusters``: the scene of each frame. The design effect of changes within scenes inflates the interval.
    """
    net: dict[Hashable, int] = {}
    lost = gained = 0
    for good, still_good, cluster in zip(before, now, clusters, strict=True):
        step = int(good) - int(still_good)
        net[cluster] = net.get(cluster, 0) + step
        lost, gained = lost + (step > 0), gained + (step < 0)
    n, scenes = len(before), len(net)
    if scenes < FEWEST_CLUSTERS:
        return None
    effect = max(1.0, sum(k * k for k in net.values()) / max(lost + gained, 1))
    effective = (lost / effect, gained / effect, n / effect)
    bounds = [score_interval(*effective, 2 * c - 1) for c in (PASS_CONFIDENCE, FAIL_CONFIDENCE)]
    worse = sign_change_p(list(net.values()))
    better = sign_change_p([-k for k in net.values()])
    return Estimate((lost - gained) / n, *bounds[0], *bounds[1], worse, better, n, scenes)


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


def sign_change_p(net: Sequence[int]) -> float:
    """Return the probability that the sum of ``net`` with random signs is at least the given sum.

    Exact: a convolution of two-point distributions.
    """
    sizes = [abs(k) for k in net if k]
    total = sum(sizes)
    chance = np.zeros(2 * total + 1)
    chance[total] = 1.0
    for size in sizes:
        chance = 0.5 * (np.roll(chance, size) + np.roll(chance, -size))
    return min(1.0, float(chance[total + sum(net) :].sum()))


def score_interval(lost: float, gained: float, n: float, confidence: float) -> tuple[float, float]:
    """Return the score interval of ``(lost - gained) / n``; counts over a design effect may be fractional."""
    z = float(stats.norm.ppf(0.5 + confidence / 2))
    estimate = (lost - gained) / n

    def excess(delta: float, sign: float) -> float:
        return sign * _score(lost, gained, n, delta) - z

    edge = 1.0 - 1e-12
    low = high = estimate
    if estimate > -edge:
        low = -1.0 if excess(-edge, 1.0) < 0 else optimize.brentq(excess, -edge, estimate, args=(1.0,), xtol=1e-12)
    if estimate < edge:
        high = 1.0 if excess(edge, -1.0) < 0 else optimize.brentq(excess, estimate, edge, args=(-1.0,), xtol=1e-12)
    return float(low), float(high)


def _score(lost: float, gained: float, n: float, delta: float) -> float:
    """Return Tango's statistic for a true difference ``delta``: positive where more is lost than that.

    ``q`` is the likeliest share of gained frames under that difference, the root of a quadratic.
    """
    b = -lost - gained + (2.0 * n - lost + gained) * delta
    c = -gained * delta * (1.0 - delta)
    q = (math.sqrt(max(b * b - 8.0 * n * c, 0.0)) - b) / (4.0 * n)
    variance = n * (2.0 * q + delta * (1.0 - delta))
    deviation = lost - gained - n * delta
    if variance <= 0.0:
        return 0.0 if deviation == 0.0 else math.copysign(math.inf, deviation)
    return deviation / math.sqrt(variance)


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
    """Verdict on a gate or a night."""

    PASS = "PASS"
    FAIL = "FAIL"
    IMPROVED = "IMPROVED"
    INCONCLUSIVE = "INCONCLUSIVE"


def decide(
    estimates: Sequence[Estimate | None], margins: Sequence[float], two_sided: Sequence[bool], looks: int = 1
) -> list[tuple[Verdict, float | None]]:
    """Return the verdict and the adjusted p-value of every gate of a night.

    ``estimates``: None gives INCONCLUSIVE. ``margins``: above 0, in the estimates' units. ``looks``: number of interim
    analyses that share the level.
    """
    known = [i for i, estimate in enumerate(estimates) if estimate is not None]
    chances = [_chances(estimates[i], two_sided[i]) for i in known]
    worse, better = (dict(zip(known, holm(p), strict=True)) for p in ([p for p, _ in chances], [p for _, p in chances]))
    level = ALPHA / looks
    found: list[tuple[Verdict, float | None]] = []
    for i, (estimate, margin) in enumerate(zip(estimates, margins, strict=True)):
        if estimate is None:
            found.append((Verdict.INCONCLUSIVE, None))
            continue
        off = abs(estimate.value) if two_sided[i] else estimate.value
        if worse[i] < level and off > margin / 2:
            verdict = Verdict.FAIL
        elif not two_sided[i] and better[i] < level and estimate.value < -margin / 2:
            verdict = Verdict.IMPROVED
        else:
            inside = estimate.upper95 < margin and (not two_sided[i] or -margin < estimate.lower95)
            verdict = Verdict.PASS if inside else Verdict.INCONCLUSIVE
        found.append((verdict, worse[i]))
    return found


def night_verdict(verdicts: Sequence[Verdict]) -> Verdict:
    """Return the night's verdict: any FAIL, else any INCONCLUSIVE, else any IMPROVED, else PASS."""
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.IMPROVED):
        if verdict in verdicts:
            return verdict
    return Verdict.PASS if verdicts else Verdict.INCONCLUSIVE


def _chances(estimate: Estimate | None, two_sided: bool) -> tuple[float, float]:
    """Return the p-values against worse (of a gate with two sides against any difference) and against better."""
    assert estimate is not None
    either = min(1.0, 2 * min(estimate.p_worse, estimate.p_better))
    return either if two_sided else estimate.p_worse, estimate.p_better
