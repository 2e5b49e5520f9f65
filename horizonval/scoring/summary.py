"""Statistics of a run: what each estimator delivers with each camera.

Four questions are kept apart. *Availability*: of the frames that should give an attitude, how many did. *Accuracy*: the
errors of all claimed attitudes. *Integrity*: how many claims were false, with the exact (Clopper-Pearson 1934) 95 %
interval, because none seen in n frames still allows 3/n. *Consistency*: the mean normalised error squared, 2 for an
honest covariance. ``nees_nadir_total`` is the test of a claim: all errors by all that is claimed. ``nees_nadir`` is the
same errors by the claimed noise alone: above 2 by what atmosphere and oblateness add, it is no test of the noise. That
is ``nees_noise``, of several draws of the noise of one frame (:mod:`horizonval.scoring.repeats`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from scipy import stats

from horizonval.scoring.confusion import confusion, in_order, strict_confusion
from horizonval.scoring.headline import headline
from horizonval.scoring.rates import rates
from horizonval.scoring.row import Row

SUMMARY_SCHEMA = 1
NEES_EXPECTED = 2.0

Summary = dict[str, Any]


def summarise(rows: Sequence[Row], given_pose: Collection[str] = (), orbit: Collection[str] = ()) -> Summary:
    """Summarise rows of results.

    Parameters
    ----------
    rows : sequence of Row
    given_pose : collection of str, optional
        Estimators that are told the true pose: they test the scoring, and their claims are no merit of a method.
    orbit : collection of str, optional
        Cases that are samples of an orbit.

    Returns
    -------
    dict
        JsonObject data: ``schema``, ``n_cases``, ``n_rows``, ``rates`` of all rows together but those of ``given_pose``
        as :func:`horizonval.scoring.rates.rates`, and ``groups``, a list sorted by estimator and camera of what
        :func:`summarise_group` returns, each with ``given_pose``, whether its estimator is one of those, and
        ``headline`` as :func:`horizonval.scoring.headline.headline`.
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.estimator, row.camera), []).append(row)
    return {
        "schema": SUMMARY_SCHEMA,
        "n_cases": len({row.case for row in rows}),
        "n_rows": len(rows),
        "rates": rates([row for row in rows if row.estimator not in given_pose]),
        "groups": [
            {
                "estimator": estimator,
                "camera": camera,
                "given_pose": estimator in given_pose,
                "headline": headline(groups[estimator, camera], orbit),
                **summarise_group(groups[estimator, camera]),
            }
            for estimator, camera in sorted(groups)
        ],
    }


def summarise_group(rows: Sequence[Row]) -> dict[str, Any]:
    """Statistics over rows that belong together; ``None`` wherever there is nothing to compute from.

    Returns
    -------
    dict
        ``n``; ``n_expected_valid``, borderline frames left out; ``n_valid`` (claims); ``availability``, ``refusal``,
        ``bonus``, ``false_valid``, ``false_valid_frames``, ``claims_without_sigma``, ``crashed``,
        ``n_borderline`` as :func:`horizonval.scoring.rates.rates`;
        ``nadir_error_arcsec``: ``{n, rms, median, p95, max}``; ``roll_error_arcsec`` and ``pitch_error_arcsec``:
        ``{n, mean, std}``; ``altitude_error_km``: the same; ``refusals``: ``{status: n}``; ``confusion``:
        ``{expected: {reported: n}}``; ``strict_confusion``: the same with borderline frames and false claims apart;
        ``error_over_bound``: the same over what the limb allows (:mod:`horizonval.scoring.bound`), and ``bound_arcsec``
        of the frames with a claim; ``nees_nadir`` by the claimed noise and ``nees_nadir_total`` by noise and claimed
        model error:
        ``{n, mean, expected, interval}`` where ``interval`` holds the mean of an honest covariance with 95 %;
        ``nees_noise`` of fits about their mean where only the noise differs: the same of ``n`` frames with at least two
        fits, claimed at the first draw or not, and ``draws``, their fits, and ``standard_error`` of the mean.
        Proportions carry ``interval``, the Clopper-Pearson 95 % one. ``p95`` interpolates linearly between the ranks.
    """
    claims = [row for row in rows if row.is_claim]
    due = [row for row in rows if row.is_due]
    return {
        "n": len(rows),
        "n_expected_valid": len(due),
        "n_valid": len(claims),
        "nadir_error_arcsec": _magnitude(_column(claims, "nadir_error_arcsec")),
        "roll_error_arcsec": _bias(_column(claims, "roll_error_arcsec")),
        "pitch_error_arcsec": _bias(_column(claims, "pitch_error_arcsec")),
        "altitude_error_km": _bias(_column(claims, "altitude_error_km")),
        "error_over_bound": _magnitude(_column(claims, "error_over_bound")),
        "bound_arcsec": _magnitude(_column(claims, "bound_arcsec")),
        "refusals": in_order(Counter(row.status for row in rows if not row.is_claim)),
        "confusion": confusion(rows),
        "strict_confusion": strict_confusion(rows),
        "nees_nadir": _nees(_column(claims, "nees_nadir")),
        "nees_nadir_total": _nees(_column(claims, "nees_nadir_total")),
        "nees_noise": _noise(rows),
        **rates(rows),
    }


def _column(rows: Sequence[Row], name: str) -> np.ndarray:
    return np.array([value for row in rows if (value := getattr(row, name)) is not None], dtype=np.float64)


def _magnitude(values: np.ndarray) -> dict[str, Any]:
    if values.size == 0:
        return {"n": 0, "rms": None, "median": None, "p95": None, "max": None}
    return {
        "n": int(values.size),
        "rms": math.sqrt(math.fsum(values**2) / values.size),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(values.max()),
    }


def _bias(values: np.ndarray) -> dict[str, Any]:
    n = int(values.size)
    if n == 0:
        return {"n": 0, "mean": None, "std": None}
    mean = math.fsum(values) / n
    std = math.sqrt(math.fsum((values - mean) ** 2) / (n - 1)) if n > 1 else None
    return {"n": n, "mean": mean, "std": std}


def _nees(values: np.ndarray) -> dict[str, Any]:
    n = int(values.size)
    if n == 0:
        return {"n": 0, "mean": None, "expected": NEES_EXPECTED, "interval": None}
    # n times the mean of n honest values is chi-squared distributed with 2n degrees of freedom.
    low, high = stats.chi2.interval(0.95, NEES_EXPECTED * n)
    mean = math.fsum(values) / n
    return {"n": n, "mean": mean, "expected": NEES_EXPECTED, "interval": [float(low) / n, float(high) / n]}


def _noise(rows: Sequence[Row]) -> dict[str, Any]:
    """Mean over frames, each by its degrees of freedom: k fits about their own mean have 2 (k - 1).

    The standard error is that of such a ratio of sums, from the scatter between frames.
    """
    frames = [
        (row.nees_noise, row.noise_draws) for row in rows if row.nees_noise is not None and row.noise_draws is not None
    ]
    n = len(frames)
    draws = sum(fits for _, fits in frames)
    if n == 0:
        none: dict[str, Any] = dict.fromkeys(("mean", "standard_error", "interval"))
        return {"n": 0, "draws": 0, "expected": NEES_EXPECTED} | none
    weights = np.array([fits - 1 for _, fits in frames], dtype=np.float64)
    values = np.array([value for value, _ in frames], dtype=np.float64)
    free = draws - n
    mean = math.fsum(weights * values) / free
    error = math.sqrt(math.fsum((weights * (values - mean)) ** 2) * n / (n - 1)) / free if n > 1 else None
    low, high = stats.chi2.interval(0.95, NEES_EXPECTED * free)
    return {
        "n": n,
        "draws": draws,
        "mean": mean,
        "standard_error": error,
        "expected": NEES_EXPECTED,
        "interval": [float(low) / free, float(high) / free],
    }
