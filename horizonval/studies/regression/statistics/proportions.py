"""Differences of proportions: of the same frames twice, or of two independent sets of frames.

*Paired.* Only frames whose outcome changed tell anything: ``lost`` of them became worse, ``gained`` better. The
interval is the score interval (T. Tango, Statistics in Medicine 17, 891, 1998), which keeps its confidence where hardly
any frame changes: none changed in n still allows z^2 / (n + z^2). The p-value is exact: if nothing has become worse,
each scene's net loss is as likely to be its opposite, so the sum over scenes is compared with all its sign changes. Of
scenes with one changed frame each that is McNemar's exact test (Psychometrika 12, 153, 1947).

*Independent.* Newcombe's hybrid of two Wilson intervals (Statistics in Medicine 17, 873, 1998, method 10), and Fisher's
exact test.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

import numpy as np
from scipy import optimize, stats

from horizonval.studies.regression.statistics.estimate import FAIL_CONFIDENCE, PASS_CONFIDENCE, Estimate
from horizonval.studies.regression.statistics.means import FEWEST_CLUSTERS


def paired_loss(before: Sequence[bool], now: Sequence[bool], clusters: Sequence[Hashable]) -> Estimate | None:
    """Return the loss, the share of good frames before minus that of now; None with too few scenes.

    Parameters
    ----------
    before, now : sequence of bool
        Whether a frame is good.
    clusters : sequence
        The scene of each frame. The interval is widened by how much the changes clump in scenes (design effect).
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
    """Return the chance that the sum of ``net`` with random signs is at least what it is.

    Exact: the distribution of the sum is the convolution of two-point distributions.
    """
    sizes = [abs(k) for k in net if k]
    total = sum(sizes)
    chance = np.zeros(2 * total + 1)
    chance[total] = 1.0
    for size in sizes:
        chance = 0.5 * (np.roll(chance, size) + np.roll(chance, -size))
    return min(1.0, float(chance[total + sum(net) :].sum()))


def score_interval(lost: float, gained: float, n: float, confidence: float) -> tuple[float, float]:
    """Return the score interval of the paired difference ``(lost - gained) / n``.

    Counts may be fractions: real ones over a design effect.
    """
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
