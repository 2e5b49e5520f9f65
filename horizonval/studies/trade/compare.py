"""Two designs on the same frames: the difference of each pair, which has lost what the frames have in common."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.studies.trade.effects import FLOOR_DEG
from horizonval.studies.trade.measures import FEWEST_DRAWN, rms
from horizonval.studies.trade.sample import Sample, interval_of


def compare(a: Sample, b: Sample, draws: FloatArray, error_deg: float) -> JsonObject:
    """Return how design ``b`` differs from design ``a`` on the frames of both.

    Returns
    -------
    dict
        ``n`` (frames of both), ``both`` (answered by both). On the latter: ``mean_difference_deg`` of the nadir errors,
        b - a, ``rms_ratio`` and ``typical_ratio`` (of the geometric means), b / a, each ``{value, interval}``;
        ``correlation`` of the log errors. ``answered`` and ``within`` (answered with at most ``error_deg``):
        ``{only_a, only_b, difference, interval, p}`` over all frames, ``p`` of McNemar's exact test
        (Psychometrika 12, 153, 1947), with frames as independent.
    """
    place = {key: i for i, key in enumerate(b.keys)}
    pairs = [(i, place[key]) for i, key in enumerate(a.keys) if key in place]
    ia = np.array([i for i, _ in pairs], dtype=np.int64)
    ib = np.array([j for _, j in pairs], dtype=np.int64)
    weights = draws[:, a.cluster[ia]] if pairs else np.zeros((len(draws), 0))
    ea, eb = a.error_deg[ia], b.error_deg[ib]
    both = np.isfinite(ea) & np.isfinite(eb)
    common_weights, n = weights[:, both], int(both.sum())
    la, lb = (np.log10(np.maximum(e[both], FLOOR_DEG)) for e in (ea, eb))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = rms(eb[both], common_weights) / rms(ea[both], common_weights)
    varied = both.sum() > 2 and np.ptp(la) > 0 and np.ptp(lb) > 0
    return {
        "n": len(pairs),
        "both": n,
        "mean_difference_deg": _with_interval(_mean(eb[both] - ea[both], common_weights), n),
        "rms_ratio": _with_interval(ratio, n),
        "typical_ratio": _with_interval(10.0 ** _mean(lb - la, common_weights), n),
        "correlation": float(np.corrcoef(la, lb)[0, 1]) if varied else None,
        "answered": _discordant(a.claimed[ia], b.claimed[ib], weights),
        "within": _discordant(a.within(error_deg)[ia], b.within(error_deg)[ib], weights),
    }


def _mean(values: FloatArray, weights: FloatArray) -> FloatArray:
    count = weights.sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean: FloatArray = np.where(count > 0, weights @ values / count, np.nan)
    return mean


def _with_interval(values: FloatArray, n: int) -> JsonObject:
    value = float(values[0])
    if not math.isfinite(value):
        return {"value": None, "interval": None}
    return {"value": value, "interval": interval_of(values) if n >= FEWEST_DRAWN else None}


def _discordant(a: NDArray[np.bool_], b: NDArray[np.bool_], weights: FloatArray) -> JsonObject:
    only_a, only_b = int(np.sum(a & ~b)), int(np.sum(b & ~a))
    difference = _mean(b.astype(np.float64) - a.astype(np.float64), weights)
    odd = only_a + only_b
    p = float(stats.binomtest(only_b, odd, 0.5).pvalue) if odd else None
    bounded = _with_interval(difference, len(a))
    return {
        "only_a": only_a,
        "only_b": only_b,
        "difference": bounded["value"],
        "interval": bounded["interval"],
        "p": p,
    }
