"""Results of a design by frame; its accuracy, shares and misses, each with an interval.

Intervals come from the cluster bootstrap over conditions (A. C. Davison and D. V. Hinkley, *Bootstrap Methods and their
Application*, 1997, section 3.8). A single condition is a cluster; so are all samples of one flight. All designs share
the draws, so differences are paired. The draws come from a hash of the study's name and seed; a statistic is computed
for all draws at once, with the frequency of each frame as its weight.

Shares have the interval of :func:`horizonval.scoring.requirements.proportion`.

Of the measures (:func:`measures_of`) *bias* is the length of the mean error in roll and pitch, *noise* the square root
of the sum of their variances over the conditions, including detector noise. For small angles rms^2 = bias^2 + noise^2
up to 1/n. *p95* and *three sigma* (99.7 %) are quantiles of the nadir error without an assumed distribution; below 333
claims the latter is nearly the largest error. Its interval is that of the order statistics (W. J. Conover, *Practical
Nonparametric Statistics*, 3rd ed., section 3.2) with frames as independent, and open at the top below 1228 claims.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.core.outcome import Outcome
from horizonval.scoring.requirements import CONFIDENCE, Answers, BoolArray, columns_of, proportion
from horizonval.scoring.row import Row
from horizonval.spec.expand import seed_of

DRAWS = 1000
NOT_MADE = "not_made"
SUN_DECIDES = (Outcome.VALID, Outcome.SUN_GLARE, Outcome.SATURATED)
"""Expected outcomes in which the Sun's position decides: with a limb, and not in the dark."""


@dataclass(frozen=True, kw_only=True)
class Sample(Answers):
    """A design's frames in the order of ``keys``; all arrays have shape (n,).

    ``keys``: condition, and band if there are several; equal keys of two designs are a pair. ``due``, ``right``: must
    be answered (borderline frames excluded); claim that is not false. ``sun_deg``: the Sun's angle from the boresight
    where it is visible and decides, else NaN. ``outcome``: the reported status; ``not_made`` if the frame failed.
    """

    keys: tuple[str, ...]
    due: BoolArray
    sun_deg: FloatArray
    right: BoolArray
    outcome: tuple[str, ...]

    @property
    def n(self) -> int:
        return len(self.keys)


def sample_of(rows: Mapping[str, Row], cluster_of: Mapping[str, int], seconds: Mapping[str, float]) -> Sample:
    """Return the sample of rows by key; ``cluster_of`` is the cluster of every key, ``seconds`` its processor time."""
    keys = tuple(sorted(rows))
    ordered = [rows[key] for key in keys]

    sun = [
        row.sun_boresight_deg
        if row.sun_boresight_deg is not None and (row.sun_visible_fraction or 0.0) > 0.0 and row.expected in SUN_DECIDES
        else np.nan
        for row in ordered
    ]
    return Sample(
        keys=keys,
        cluster=np.array([cluster_of[key] for key in keys], dtype=np.int64),
        seconds=np.array([seconds.get(key, np.nan) for key in keys], dtype=np.float64),
        due=np.array([row.is_due for row in ordered], dtype=np.bool_),
        sun_deg=np.array(sun, dtype=np.float64),
        right=np.array([row.is_right for row in ordered], dtype=np.bool_),
        outcome=tuple(row.status if row.epoch_utc is not None else NOT_MADE for row in ordered),
        **columns_of(ordered),
    )


def cluster_draws(clusters: int, name: str, seed: int, draws: int = DRAWS) -> FloatArray:
    """Return the frequency of each cluster in each draw, shape (1 + draws, clusters); the first line is the sample."""
    random = np.random.default_rng(np.random.SeedSequence(seed_of("study bootstrap", name, seed)))
    counts = random.multinomial(clusters, np.full(clusters, 1.0 / clusters), size=draws)
    return np.concatenate([np.ones((1, clusters)), counts.astype(np.float64)])


def interval_of(values: FloatArray) -> list[float] | None:
    """Return the middle 95 % of the draws (all but the first value), None if fewer than 95 % have a value."""
    drawn = values[1:]
    known = drawn[np.isfinite(drawn)]
    if known.size < CONFIDENCE * drawn.size or known.size == 0:
        return None
    low, high = np.percentile(known, [50.0 * (1.0 - CONFIDENCE), 50.0 * (1.0 + CONFIDENCE)])
    return [float(low), float(high)]


THREE_SIGMA = 0.997
P95 = 0.95
FEWEST_CLAIMS = 2
FEWEST_DRAWN = 5
"""Minimum number of items for a bootstrap interval."""


def measures_of(sample: Sample, draws: FloatArray, error_deg: float) -> JsonObject:
    """Return the measures of a design; ``draws`` has shape (1 + draws, clusters), ``error_deg`` limits a usable answer.

    The result has ``n``, ``clusters``, ``claims``; ``bias_deg``, ``noise_deg``, ``rms_deg``, ``p95_deg``,
    ``three_sigma_deg``, ``exclusion_deg`` as ``{value, interval, n}``; ``availability``, ``answered_due``,
    ``false_valid``, ``within`` as :func:`proportion`.
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
    """Return a weighted quantile for every line of weights, with linear interpolation between ranks."""
    if values.size == 0:
        return np.full(len(weights), np.nan)
    order = np.argsort(values, kind="stable")
    ranked, upto = values[order], np.cumsum(weights[:, order], axis=1)
    count = upto[:, -1]
    place = np.maximum(count - 1.0, 0.0) * q
    below = np.floor(place)

    def at(rank: FloatArray) -> FloatArray:
        # The first value with a cumulative weight above ``rank``.
        index = np.minimum((upto <= rank[:, None]).sum(axis=1), len(ranked) - 1)
        values_at_rank: FloatArray = ranked[index]
        return values_at_rank

    low, high = at(below), at(np.minimum(below + 1.0, np.maximum(count - 1.0, 0.0)))
    mixed: FloatArray = np.where(count > 0, low + (high - low) * (place - below), np.nan)
    return mixed


def exclusion_angle(angle: FloatArray, right: NDArray[np.bool_], weights: FloatArray) -> FloatArray:
    """Return for every line of weights the smallest angle from which on every answer is right, else NaN.

    Vectorised :func:`horizonval.scoring.expected.exclusion_angle_deg`.
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


FALSE, INACCURATE = "false claim", "too inaccurate"
"""Causes in addition to refusals: false claims, and other claims beyond the required error."""


def misses_of(sample: Sample, error_deg: float) -> JsonObject:
    """Return by cause, largest first, the number of missed frames (``n``), and of those to be answered (``due``)."""
    within = sample.within(error_deg)
    causes: Counter[str] = Counter()
    due: Counter[str] = Counter()
    for i, outcome in enumerate(sample.outcome):
        if within[i]:
            continue
        cause = (FALSE if sample.false[i] else INACCURATE) if sample.claimed[i] else outcome.replace("_", " ")
        causes[cause] += 1
        due[cause] += bool(sample.due[i])
    return {
        name: {"n": n, "due": due[name]} for name, n in sorted(causes.items(), key=lambda item: (-item[1], item[0]))
    }


def words_of(misses: Mapping[str, JsonObject]) -> str:
    """Return the misses of a design as ``8 dark, 1 too inaccurate``."""
    return ", ".join(f"{found['n']} {cause}" for cause, found in misses.items())


def causes_of(misses: Iterable[Mapping[str, JsonObject]]) -> list[str]:
    """Return the causes of several designs, the most frequent first."""
    total: Counter[str] = Counter()
    for found in misses:
        total.update({cause: count["n"] for cause, count in found.items()})
    return [cause for cause, _ in sorted(total.items(), key=lambda item: (-item[1], item[0]))]
