"""Statistics of error series over flights and times: two-level sampling, knowledge errors, correlation in time.

**Two levels** (ECSS-E-ST-60-10C, section 4.2). A flight is one draw of everything that is constant in it (calibration);
its frames are times. *Ensemble*: the standard deviation over flights at the worst time. *Temporal*: over time in the
worst flight. *Mixed*: over all frames of all flights.

**Knowledge errors** of a series ``e(t)``, over windows of a stated length: *AKE* is ``e``; *MKE* its mean over a
window; *RKE* the difference of the two; *KDE* (drift) the change of the MKE from one window to the next; *KRE*
(reproducibility) the change from the first window of a flight to its last.

**Correlation.** With the mean removed, the autocovariance ``C`` at the time differences of the samples is fitted by
``C(0) = w^2 + c^2`` and ``C(dt) = c^2 exp(-dt / tau)``: a white part ``w`` and a correlated one ``c`` with the
e-fold time ``tau``, which a filter must assume. Where ``C`` of neighbouring samples is not significantly positive
(below ``2 / sqrt(n)`` of ``C(0)``) all of it is white.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject

THREE_SIGMA = 0.9973
FEWEST_FOR_TAILS = 100
"""Smallest sample whose tails are compared with a normal distribution."""
DRAWS = 500
CONFIDENCE = 0.95
TAIL_FACTOR = 1.5
"""Ratio of the 99 % to the 68 % quantile, relative to a normal distribution's, above which tails are flagged."""
SHORTEST_FALL = 0.1
"""Smallest fall of the logarithm of the autocovariance over the longest time difference that gives an e-fold time."""
SIGNIFICANT = 0.3
"""Smallest autocovariance, relative to its value for neighbouring samples, that enters the e-fold time."""


def two_levels(series: Sequence[FloatArray], noise_variance: float = 0.0, seed: int = 0) -> JsonObject:
    """Return mean and standard deviations of errors, one array (times,) for each flight, NaN where there is none.

    ``noise_variance``: variance of the values by detector noise, taken out of the standard deviations.
    The result has ``n``, ``mean``, ``mixed``, ``interval`` of mixed (95 %, bootstrap over flights, or over frames of a
    single flight), ``ensemble``, ``temporal``, ``q9973``: the quantile of ``|e|``, ``three_sigma``: ``|mean| + 3
    mixed``, and ``tails``: whether they are heavier than normal, None in a small sample. None: too few values.
    """
    table = np.full((len(series), max((len(one) for one in series), default=0)), np.nan)
    for row, one in zip(table, series, strict=True):
        row[: len(one)] = one
    values = table[np.isfinite(table)]
    n = len(values)
    empty = dict.fromkeys(("mean", "mixed", "interval", "ensemble", "temporal", "q9973", "three_sigma", "tails"))
    if n < 2:
        return {"n": n, **empty, "mean": float(values[0]) if n else None}
    mean, raw = float(values.mean()), float(values.std(ddof=1))
    mixed = _less(raw, noise_variance)
    interval = _interval(table, seed)
    heavy = None
    if n >= FEWEST_FOR_TAILS:
        middle, far = np.quantile(np.abs(values - mean), [0.6827, 0.99])
        heavy = bool(far > TAIL_FACTOR * 2.576 * middle)
    return {
        "n": n,
        "mean": mean,
        "mixed": mixed,
        "interval": None if interval is None else [_less(end, noise_variance) for end in interval],
        "ensemble": _largest_spread(table.T, noise_variance),
        "temporal": _largest_spread(table, noise_variance),
        "q9973": float(np.quantile(np.abs(values), THREE_SIGMA)),
        "three_sigma": abs(mean) + 3.0 * mixed,
        "tails": heavy,
    }


def _largest_spread(lines: FloatArray, noise_variance: float) -> float | None:
    """Return the largest standard deviation of a line with two or more values."""
    spreads = [float(known.std(ddof=1)) for line in lines if len(known := line[np.isfinite(line)]) > 1]
    return _less(max(spreads), noise_variance) if spreads else None


def _less(sigma: float, variance: float) -> float:
    """Return a standard deviation without an independent part of this variance."""
    return math.sqrt(max(sigma**2 - variance, 0.0))


def _interval(table: FloatArray, seed: int) -> list[float] | None:
    units = table if len(table) > 1 else table.T
    units = units[np.isfinite(units).any(axis=1)]
    if len(units) < 5:
        return None
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    spreads = []
    for chosen in rng.integers(0, len(units), (DRAWS, len(units))):
        drawn = units[chosen]
        spreads.append(np.std(drawn[np.isfinite(drawn)], ddof=1))
    tail = 50.0 * (1.0 - CONFIDENCE)
    return [float(value) for value in np.percentile(spreads, [tail, 100.0 - tail])]


def knowledge_errors(series: Sequence[FloatArray], times_s: Sequence[FloatArray], window_s: float) -> JsonObject:
    """Return AKE, MKE, RKE, KDE and KRE, each as :func:`two_levels`; ``times_s`` as ``series``, window in seconds."""
    means, relative, drift, again = [], [], [], []
    for errors, times in zip(series, times_s, strict=True):
        index = np.floor((times - times[0]) / window_s + 1e-9).astype(int) if len(times) else np.zeros(0, int)
        by_window = [errors[index == k] for k in np.unique(index)]
        mean = np.array([np.nanmean(one) if np.isfinite(one).any() else np.nan for one in by_window])
        means.append(mean)
        relative.append(np.concatenate([one - m for one, m in zip(by_window, mean, strict=True)]))
        drift.append(np.diff(mean))
        again.append(mean[-1:] - mean[:1] if len(mean) > 1 else np.zeros(0))
    parts = {"AKE": series, "MKE": means, "RKE": relative, "KDE": drift, "KRE": again}
    return {name: two_levels(list(one)) for name, one in parts.items()}


def correlation(series: Sequence[FloatArray], times_s: Sequence[FloatArray], noise_variance: float = 0.0) -> JsonObject:
    """Return the white and correlated standard deviations and the e-fold time [s] of errors.

    ``white``, ``correlated``, ``e_fold_s``, and ``curve``: time difference, autocorrelation and number of pairs. Time
    differences are rounded to the median distance of samples. ``noise_variance`` is taken out of the white part. None:
    too few pairs, no correlation, or one that hardly falls within the duration of the flights.
    """
    known = [(e[np.isfinite(e)], t[np.isfinite(e)]) for e, t in zip(series, times_s, strict=True)]
    values = np.concatenate([e for e, _ in known]) if known else np.zeros(0)
    gaps = np.concatenate([np.diff(t) for _, t in known]) if known else np.zeros(0)
    result: JsonObject = {"white": None, "correlated": None, "e_fold_s": None, "curve": []}
    if len(values) < 3 or not len(gaps) or np.median(gaps) <= 0.0:
        return result
    mean, step = values.mean(), float(np.median(gaps))
    lags, products = [], []
    for e, t in known:
        i, j = np.triu_indices(len(e), 1)
        lags.append(np.rint(np.abs(t[j] - t[i]) / step).astype(int))
        products.append((e[i] - mean) * (e[j] - mean))
    lag, product = np.concatenate(lags), np.concatenate(products)
    variance = float(np.mean((values - mean) ** 2))
    if variance == 0.0:
        return result
    count = np.bincount(lag)
    covariance = np.bincount(lag, weights=product) / np.maximum(count, 1)
    shown = [k for k in range(1, len(count)) if count[k] >= 3]
    result["curve"] = [[k * step, float(covariance[k] / variance), int(count[k])] for k in shown]
    near = covariance[1] / variance if len(count) > 1 and count[1] >= 3 else 0.0
    if near < 2.0 / math.sqrt(len(values)):
        return result | {"white": _less(math.sqrt(variance), noise_variance), "correlated": 0.0}
    used = []
    for k in shown:
        if covariance[k] < SIGNIFICANT * covariance[1]:
            break
        used.append(k)
    if len(used) < 2:
        # One lag alone cannot tell white from correlated errors: the fall to the next one bounds the time.
        e_fold_s = -step / math.log(near) if near < 1.0 else None
        return result | {"white": 0.0, "correlated": math.sqrt(variance), "e_fold_s": e_fold_s}
    slope, level = np.polyfit(step * np.array(used), np.log(covariance[used]), 1, w=np.sqrt(count[used]))
    correlated = min(math.exp(level), variance)
    return result | {
        "white": math.sqrt(max(variance - correlated - noise_variance, 0.0)),
        "correlated": math.sqrt(correlated),
        "e_fold_s": float(-1.0 / slope) if slope * step * (len(count) - 1) < -SHORTEST_FALL else None,
    }
