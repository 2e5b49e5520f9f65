"""Differences of means: paired by scene and noise seed, or between two independent sets of scenes.

Pairs of one scene (other noise, other estimators) share what is hard about the scene. The scene is therefore the unit:
its pairs are averaged, and Student's t is used on the averages, which holds for any dependence within a scene. Common
random numbers take what the scenes and the noise have in common out of the difference: with errors of two runs
correlated by rho its variance falls by 1 - rho.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.studies.regression.statistics.estimate import FAIL_CONFIDENCE, PASS_CONFIDENCE, Estimate, exact

FEWEST_CLUSTERS = 5
"""With fewer scenes nothing is decided: a bound on four differences is a statement about normality, not about them."""


def paired_difference(differences: Sequence[float], clusters: Sequence[Hashable]) -> Estimate | None:
    """Return the mean difference over scenes; None with fewer than :data:`FEWEST_CLUSTERS` of them.

    Parameters
    ----------
    differences : sequence of float
        Now minus baseline, one for each pair.
    clusters : sequence
        The scene that each pair belongs to.
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
    """Return the mean of every cluster, in the order in which the clusters first come."""
    groups: dict[Hashable, list[float]] = {}
    for value, cluster in zip(values, clusters, strict=True):
        groups.setdefault(cluster, []).append(value)
    return np.array([np.mean(group) for group in groups.values()], dtype=np.float64)


def _bounds(value: float, error: float, freedom: float) -> tuple[float, float, float, float]:
    pass_t, fail_t = (float(stats.t.ppf(c, freedom)) * error for c in (PASS_CONFIDENCE, FAIL_CONFIDENCE))
    return value - pass_t, value + pass_t, value - fail_t, value + fail_t
