"""Main effects and two-axis interactions on the logarithm of the error.

The response of a design is the mean of log10 of its nadir error over the frames that all compared designs answered. Up
to a quarter of the designs are left out to obtain common frames; if that is not enough, each design's claims are used.
The sum of squares of a term is the growth of the residual when the term is removed from the model with all terms of its
order and below ("type II": R. Langsrud, Statistics and Computing 13, 163, 2003). On a full grid these are the classical
ones and add up to the total; on a grid with gaps they need not.

The uncertainty of the shares comes from resampling the conditions. A share cannot be negative, so a term without effect
has a small positive one: compare the lower end. Also here: :func:`compare` and :func:`front`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.studies.trade.sample import FEWEST_DRAWN, Sample, interval_of, rms

FLOOR_DEG = 1e-6
"""Minimum error, since a logarithm has no zero."""
FEWEST_COMMON = 5
MOST_LEFT_OUT = 0.25
"""Share of the designs that may be left out to obtain common frames."""


def effects_of(designs: Sequence[tuple[str, Mapping[str, Any], Sample]], draws: FloatArray) -> JsonObject | None:
    """Return the effects of the axes on the designs' mean log error.

    ``designs``: (name, settings, sample) of each. ``draws``: shape (1 + draws, clusters).

    Returns
    -------
    dict or None
        ``basis`` (``common`` or ``own`` claims), ``n`` (common frames, or fewest claims), ``designs``, ``left_out``,
        ``complete`` (full grid), ``variance`` of log10; ``terms``: ``{axes, dof, share: {value, interval}}`` by falling
        share, the remainder last; ``levels``: by axis a list of ``{level, factor, interval, designs}``, the factor
        by which the level multiplies the error. ``None`` where nothing is varied or fewer than two designs answered.
    """
    kept = _with_frames_in_common([d for d in designs if np.isfinite(d[2].error_deg).any()])
    axes = {key: _levels(kept, key) for key in (kept[0][1] if kept else {})}
    factors = [key for key, levels in axes.items() if len(levels) > 1]
    if len(kept) < 2 or not factors:
        return None
    response, basis, n = _responses([sample for *_, sample in kept], draws)
    usable = np.asarray(np.isfinite(response).all(axis=0))
    if not usable[0]:
        return None
    response = response[:, usable]
    columns = {key: _coded([settings.get(key) for _, settings, _ in kept], axes[key]) for key in factors}
    terms = _terms(factors, columns, response)
    return {
        "basis": basis,
        "n": n,
        "designs": len(kept),
        "left_out": [name for name, *_ in designs if name not in {kept_name for kept_name, *_ in kept}],
        "complete": len(kept) == int(np.prod([len(axes[key]) for key in factors])),
        "variance": float(np.var(response[:, 0])),
        "terms": terms,
        "levels": _level_factors(factors, axes, columns, kept, response),
    }


def _with_frames_in_common(
    designs: Sequence[tuple[str, Mapping[str, Any], Sample]],
) -> list[tuple[str, Mapping[str, Any], Sample]]:
    """Leave out, one by one, the design that costs most common frames, until there are enough."""
    answered = [{k for k, e in zip(d[2].keys, d[2].error_deg, strict=True) if np.isfinite(e)} for d in designs]
    kept = list(range(len(designs)))

    def common(indices: Sequence[int]) -> int:
        return len(set.intersection(*(answered[i] for i in indices))) if indices else 0

    while common(kept) < FEWEST_COMMON:
        if len(designs) - len(kept) + 1 > MOST_LEFT_OUT * len(designs):
            return list(designs)
        kept.remove(max(kept, key=lambda i: common([j for j in kept if j != i])))
    return [designs[i] for i in kept]


def _levels(designs: Sequence[tuple[str, Mapping[str, Any], Sample]], key: str) -> list[Any]:
    return list(dict.fromkeys(_word(settings.get(key)) for _, settings, _ in designs))


def _word(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool) or value is None else repr(value)


def _responses(samples: Sequence[Sample], draws: FloatArray) -> tuple[FloatArray, str, int]:
    """Return mean log errors, shape (designs, 1 + draws), their basis, and the number of frames."""
    errors = [
        dict(zip(sample.keys, zip(sample.error_deg, sample.cluster, strict=True), strict=True)) for sample in samples
    ]
    common = [key for key in errors[0] if all(key in error and np.isfinite(error[key][0]) for error in errors)]
    if len(common) >= FEWEST_COMMON:
        weights = draws[:, [errors[0][key][1] for key in common]]
        logs = np.array([[_log(error[key][0]) for key in common] for error in errors])
        return _means(logs @ weights.T, weights.sum(axis=1)), "common", len(common)
    lines, fewest = [], []
    for sample in samples:
        claims = np.isfinite(sample.error_deg)
        weights = draws[:, sample.cluster[claims]]
        lines.append(_means(weights @ _log(sample.error_deg[claims]), weights.sum(axis=1)))
        fewest.append(int(claims.sum()))
    return np.array(lines), "own", min(fewest)


def _means(sums: FloatArray, counts: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", divide="ignore"):
        means: FloatArray = np.where(counts > 0, sums / counts, np.nan)
    return means


def _log(error_deg: Any) -> Any:
    return np.log10(np.maximum(error_deg, FLOOR_DEG))


def _coded(values: Sequence[Any], levels: Sequence[Any]) -> NDArray[np.float64]:
    """Return sum-to-zero columns of a factor, shape (designs, levels - 1)."""
    code = np.vstack([np.eye(len(levels) - 1), -np.ones(len(levels) - 1)])
    coded: NDArray[np.float64] = code[[levels.index(_word(value)) for value in values]]
    return coded


def _terms(factors: Sequence[str], columns: Mapping[str, FloatArray], response: FloatArray) -> list[JsonObject]:
    pairs = list(itertools.combinations(factors, 2))
    cross = {(a, b): (columns[a][:, :, None] * columns[b][:, None, :]).reshape(len(response), -1) for a, b in pairs}
    total, _ = _residual([], response)
    mains = [columns[key] for key in factors]
    all_mains, rank_mains = _residual(mains, response)
    everything, rank_all = _residual([*mains, *cross.values()], response)
    terms = []
    for i, key in enumerate(factors):
        without, rank = _residual(mains[:i] + mains[i + 1 :], response)
        terms.append(([key], rank_mains - rank, without - all_mains))
    for pair in pairs:
        without, rank = _residual([*mains, *(c for p, c in cross.items() if p != pair)], response)
        if rank_all > rank:
            terms.append((list(pair), rank_all - rank, without - everything))
    # Rounding errors of a zero sum must not become a share.
    whole = np.where(total > 1e-18, total, np.nan)
    terms.sort(key=lambda term: -float(np.nan_to_num(term[2][0] / whole[0])))
    left = len(response) - rank_all
    if left > 0:
        terms.append((["remainder"], left, everything))
    return [
        {
            "axes": axes,
            "dof": dof,
            "share": {"value": _finite(float(share[0])), "interval": interval_of(share)},
        }
        for axes, dof, squares in terms
        for share in (np.maximum(squares, 0.0) / whole,)
    ]


def _residual(columns: Sequence[FloatArray], response: FloatArray) -> tuple[FloatArray, int]:
    """Return the residual sum of squares for every draw, and the rank of the model with its mean."""
    model = np.concatenate([np.ones((len(response), 1)), *columns], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(model, response, rcond=None)
    return np.sum((response - model @ solution) ** 2, axis=0), int(rank)


def _level_factors(
    factors: Sequence[str],
    axes: Mapping[str, Sequence[Any]],
    columns: Mapping[str, FloatArray],
    designs: Sequence[tuple[str, Mapping[str, Any], Sample]],
    response: FloatArray,
) -> dict[str, list[JsonObject]]:
    """Return 10 to the power of each level's coefficient in the model of main effects alone."""
    model = np.concatenate([np.ones((len(response), 1)), *(columns[key] for key in factors)], axis=1)
    solution, *_ = np.linalg.lstsq(model, response, rcond=None)
    factors_by_axis, start = {}, 1
    for key in factors:
        width = len(axes[key]) - 1
        coefficients = solution[start : start + width]
        start += width
        lines = []
        for level, values in zip(axes[key], [*coefficients, -coefficients.sum(axis=0)], strict=True):
            factor = 10.0**values
            count = sum(_word(settings.get(key)) == level for _, settings, _ in designs)
            lines.append(
                {"level": level, "factor": float(factor[0]), "interval": interval_of(factor), "designs": count}
            )
        factors_by_axis[key] = lines
    return factors_by_axis


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def compare(a: Sample, b: Sample, draws: FloatArray, error_deg: float) -> JsonObject:
    """Return the difference of design ``b`` from design ``a`` on the frames of both.

    The result has ``n`` (common frames) and ``both`` (answered by both). On the latter: ``mean_difference_deg`` of the
    nadir errors, b - a, ``rms_ratio`` and ``typical_ratio`` (of the geometric means), b / a, each ``{value,
    interval}``; ``correlation`` of the log errors. Over all frames: ``answered`` and ``within`` (answered with at most
    ``error_deg``) as ``{only_a, only_b, difference, interval, p}``, ``p`` of McNemar's exact test (Psychometrika 12,
    153, 1947), with frames as independent.
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


def front(points: Sequence[Sequence[float | None]]) -> list[bool]:
    """Return which points are on the Pareto front; smaller coordinates are better.

    A point dominates another if it is nowhere larger and somewhere smaller; equal points do not dominate each other. A
    point with an unknown (None) coordinate is on no front.
    """
    known = [i for i, point in enumerate(points) if all(value is not None for value in point)]
    on_front = [False] * len(points)
    values = np.array([points[i] for i in known], dtype=np.float64)
    for i, point in zip(known, values, strict=True):
        beaten = (values <= point).all(axis=1) & (values < point).any(axis=1)
        on_front[i] = not bool(beaten.any())
    return on_front
