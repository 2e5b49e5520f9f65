"""Shares of frames with intervals that hold for few frames and for frames along a flight.

Independent frames have the interval of Clopper and Pearson (Biometrika 26, 404, 1934). Samples of one flight resemble
each other: what they are worth together is the effective sample size, n over the design effect, which takes the place
of n in the same formula (E. L. Korn and B. I. Graubard, Survey Methodology 24, 193, 1998). Where all frames went the
same way nothing is known of how flights differ, and every flight counts once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core.json_types import JsonObject
from horizonval.studies.trade.sample import CONFIDENCE


def proportion(flags: NDArray[np.bool_], cluster: NDArray[np.int64]) -> JsonObject:
    """Return a share with its two-sided 95 % interval and its one-sided 95 % bounds.

    Parameters
    ----------
    flags : ndarray of bool, shape (n,)
    cluster : ndarray of int, shape (n,)

    Returns
    -------
    dict
        ``n`` (flags that are set), ``of``, ``rate``, ``interval``, ``lower``, ``upper`` (each one-sided), ``effective``
        (frames that the sample is worth). All but the counts are ``None`` for 0 of 0.
    """
    n, k = int(flags.size), int(np.count_nonzero(flags))
    if n == 0:
        none = dict.fromkeys(("rate", "interval", "lower", "upper", "effective"))
        return {"n": 0, "of": 0, **none}
    effective = effective_size(flags, cluster)
    rate = k / n
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = _bounds(rate, effective, tail)
    lower, upper = _bounds(rate, effective, 2.0 * tail)
    return {
        "n": k,
        "of": n,
        "rate": rate,
        "interval": [low, high],
        "lower": lower,
        "upper": upper,
        "effective": effective,
    }


def effective_size(flags: NDArray[np.bool_], cluster: NDArray[np.int64]) -> float:
    """Return how many independent frames a sample is worth, at most as many as it has."""
    n = int(flags.size)
    _, index = np.unique(cluster, return_inverse=True)
    clusters = int(index.max()) + 1
    if clusters == n:
        return float(n)
    rate = float(np.mean(flags))
    if rate in (0.0, 1.0) or clusters == 1:
        return float(clusters)
    excess = np.bincount(index, weights=flags - rate)
    variance = clusters / (clusters - 1.0) * float(np.sum(excess**2)) / n**2
    if variance == 0.0:
        return float(n)
    return min(float(n), rate * (1.0 - rate) / variance)


def _bounds(rate: float, n: float, tail: float) -> tuple[float, float]:
    """Return Clopper and Pearson's bounds, each of which a share beyond passes with the probability ``tail``."""
    k = rate * n
    low = 0.0 if rate == 0.0 else float(stats.beta.ppf(tail, k, n - k + 1.0))
    high = 1.0 if rate == 1.0 else float(stats.beta.ppf(1.0 - tail, k + 1.0, n - k))
    return low, high
