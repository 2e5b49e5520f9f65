"""What a design delivers: accuracy of its claims, rates, exclusion angle; each with an interval.

*Bias* is the length of the mean error in roll and pitch, *noise* the square root of the sum of their variances: the
scatter over the conditions, detector noise among it. For small angles rms^2 = bias^2 + noise^2 up to 1/n. *p95* and
*three sigma* are quantiles of the nadir error, the latter at 99.7 %, no distribution assumed; of fewer than 333 claims
it is nearly the largest error. Its interval is that of the order statistics (W. J. Conover, *Practical Nonparametric
Statistics*, 3rd ed., section 3.2) with frames as independent, and open at the top below 1228 claims.

Weights stand for the draws of :mod:`horizonval.studies.trade.sample`: a statistic is worked out for all of them at
once.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.studies.trade.proportion import proportion
from horizonval.studies.trade.sample import CONFIDENCE, Sample, interval_of

THREE_SIGMA = 0.997
P95 = 0.95
FEWEST_CLAIMS = 2
FEWEST_DRAWN = 5
"""Drawing fewer than this anew says nothing about their scatter: no interval then."""


def measures_of(sample: Sample, draws: FloatArray, error_deg: float) -> JsonObject:
    """Return the measures of a design.

    Parameters
    ----------
    sample : Sample
    draws : ndarray, shape (1 + draws, clusters)
    error_deg : float
        Largest error of a usable answer.

    Returns
    -------
    dict
        ``n``, ``clusters``, ``claims``; ``bias_deg``, ``noise_deg``, ``rms_deg``, ``p95_deg``, ``three_sigma_deg``,
        ``exclusion_deg``: ``{value, interval, n}``; ``availability``, ``answered_due``, ``false_valid``, ``within``:
        as :func:`horizonval.studies.trade.proportion.proportion`.
    """
    weights = draws[:, sample.cluster]
    clusters = len(np.unique(sample.cluster))
    claims = np.isfinite(sample.error_deg)
    claim_weights = weights[:, claims]
    error = sample.error_deg[claims]
    angles = np.isfinite(sample.roll_deg) & np.isfinite(sample.pitch_deg)
    bias, noise = bias_and_noise(sample.roll_deg[angles], sample.pitch_deg[angles], weights[:, angles])
    sun = np.isfinite(sample.sun_deg)
    exclusion = exclusion_angle(sample.sun_deg[sun], sample.right[sun], weights[:, sun])
    return {
        "n": sample.n,
        "clusters": clusters,
        "claims": int(np.count_nonzero(sample.claimed)),
        "bias_deg": _measure(bias, int(angles.sum()), clusters),
        "noise_deg": _measure(noise, int(angles.sum()), clusters),
        "rms_deg": _measure(rms(error, claim_weights), error.size, clusters),
        "p95_deg": _measure(quantile(error, claim_weights, P95), error.size, clusters),
        "three_sigma_deg": _three_sigma(error),
        "exclusion_deg": _measure(exclusion, int(sun.sum()), clusters),
        "availability": proportion(sample.claimed, sample.cluster),
        "answered_due": proportion(sample.claimed[sample.due], sample.cluster[sample.due]),
        "false_valid": proportion(sample.false[sample.claimed], sample.cluster[sample.claimed]),
        "within": proportion(sample.within(error_deg), sample.cluster),
    }


def bias_and_noise(
    roll: NDArray[np.float64], pitch: NDArray[np.float64], weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return bias and noise for every line of weights; NaN below two claims."""
    count = weights.sum(axis=1)
    means, sums = [], []
    with np.errstate(invalid="ignore", divide="ignore"):
        for values in (roll, pitch):
            mean = weights @ values / count
            means.append(mean)
            sums.append(np.maximum(weights @ values**2 - count * mean**2, 0.0))
        bias = np.hypot(*means)
        noise = np.sqrt((sums[0] + sums[1]) / (count - 1.0))
    few = count < FEWEST_CLAIMS
    return np.where(few, np.nan, bias), np.where(few, np.nan, noise)


def rms(values: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the root mean square for every line of weights."""
    count = weights.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        root: FloatArray = np.where(count > 0, np.sqrt(weights @ values**2 / count), np.nan)
    return root


def quantile(values: FloatArray, weights: FloatArray, q: float) -> FloatArray:
    """Return a quantile for every line of weights, each value taken as often as it weighs; linear between ranks."""
    if values.size == 0:
        return np.full(len(weights), np.nan)
    order = np.argsort(values, kind="stable")
    ranked, upto = values[order], np.cumsum(weights[:, order], axis=1)
    count = upto[:, -1]
    place = np.maximum(count - 1.0, 0.0) * q
    below = np.floor(place)

    def at(rank: FloatArray) -> FloatArray:
        # The first value that more than ``rank`` copies stand up to.
        index = np.minimum((upto <= rank[:, None]).sum(axis=1), len(ranked) - 1)
        values_at_rank: FloatArray = ranked[index]
        return values_at_rank

    low, high = at(below), at(np.minimum(below + 1.0, np.maximum(count - 1.0, 0.0)))
    mixed: FloatArray = np.where(count > 0, low + (high - low) * (place - below), np.nan)
    return mixed


def exclusion_angle(angle: FloatArray, right: NDArray[np.bool_], weights: FloatArray) -> FloatArray:
    """Return for every line of weights the smallest angle from which on every answer is right, NaN where there is none.

    The same as :func:`horizonval.scoring.expected.exclusion_angle_deg`, for all draws at once.
    """
    if angle.size == 0:
        return np.full(len(weights), np.nan)
    there = weights > 0
    wrong = np.where(there & ~right, angle, -1.0).max(axis=1)
    beyond = np.where(there & (angle > wrong[:, None]), angle, np.inf).min(axis=1)
    angles: FloatArray = np.where(np.isfinite(beyond), beyond, np.nan)
    return angles


def _measure(values: FloatArray, n: int, clusters: int) -> JsonObject:
    value = float(values[0]) if math.isfinite(values[0]) else None
    known = value is not None and min(n, clusters) >= FEWEST_DRAWN
    return {"value": value, "interval": interval_of(values) if known else None, "n": n}


def _three_sigma(error: FloatArray) -> JsonObject:
    if error.size < FEWEST_CLAIMS:
        return {"value": None, "interval": None, "n": int(error.size)}
    value = float(np.quantile(error, THREE_SIGMA))
    interval = stats.quantile_test(error, q=value, p=THREE_SIGMA).confidence_interval(CONFIDENCE)
    bounds = [float(interval.low), float(interval.high)]
    return {
        "value": value,
        "interval": [x if math.isfinite(x) else None for x in bounds],
        "n": int(error.size),
    }
