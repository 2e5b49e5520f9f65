"""Statistics of a run: what each estimator delivers with each camera.

Four questions are separate. *Availability*: of the frames that should give an attitude, how many did. *Accuracy*: the
errors of all claims. *Integrity*: how many claims were false. *Consistency*: the mean normalised error squared, 2 for
an honest covariance. ``nees_nadir_total`` tests a claim: all errors by all that is claimed. ``nees_nadir`` has the same
errors by the claimed noise alone; atmosphere and oblateness bring it above 2.

**Rates** have the interval of Clopper and Pearson (Biometrika 26, 404, 1934), which holds at least its confidence for
any true rate: none in n trials still allows 3 / n (J. A. Hanley and A. Lippman-Hand, JAMA 249, 1743, 1983). Borderline
frames (:mod:`horizonval.scoring.expected`) take no part in availability and refusal. A false claim or a crash counts on
every frame.

**Noise.** ``nees_noise`` tests the claimed noise by fits of one frame under N draws of the detector's noise. Their
scatter about their own mean is noise alone; a deviation from the mean has the share (N - 1) / N of one draw's
covariance, hence::

    nees_i = N / (N - 1)  (n_i - mean n)^T C_i^-1 (n_i - mean n)

in the plane across the mean nadir: 2 on average for an honest covariance C_i.

**Headline.** An estimator *works* on a frame where it claims an attitude that is not false. All frames of an orbit
count, eclipse included, and separately the frames that should give an attitude. Frames without a right answer are
grouped by what was in view, from the truth alone.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.estimation.observation import Fit
from horizonval.geometry.rotation import tangent_basis
from horizonval.scoring import limits
from horizonval.scoring.limits import claim_limits
from horizonval.scoring.row import Row

BORDERLINE = "borderline"
"""Line of a matrix for frames that may fairly go either way."""
BEYOND_LIMIT = "false_beyond_limit"
BEYOND_SIGMA = "false_beyond_sigma"
"""Columns of a matrix for claims that are false; the column ``valid`` holds the others."""


def why_false(row: Row, likelihood: Collection[str] = ()) -> str | None:
    """Return what makes a claim false: its error, else an error beyond its own sigma; ``None`` where it is not.

    A claim whose error is no number is beyond every limit. ``likelihood`` names the estimators whose entry states that
    their claims are those of a likelihood fit (``Estimator.claim``); the record of a run has them.
    """
    if not row.false_valid:
        return None
    limit_arcsec = (
        math.degrees(claim_limits("likelihood" if row.estimator in likelihood else "cone").nadir_error_rad) * 3600.0
    )
    if row.nadir_error_arcsec is None or row.nadir_error_arcsec > limit_arcsec:
        return BEYOND_LIMIT
    return BEYOND_SIGMA


def confusion(rows: Iterable[Row]) -> dict[str, dict[str, int]]:
    """Return ``{expected: {reported: n}}``, both in the order of the outcomes, empty cells left out."""
    return _matrix((row.expected, row.status) for row in rows)


def strict_confusion(rows: Iterable[Row], likelihood: Collection[str] = ()) -> dict[str, dict[str, int]]:
    """Return the same with borderline frames on a line and false claims in a column of their own."""
    return _matrix(
        (BORDERLINE if row.borderline else row.expected, why_false(row, likelihood) or row.status) for row in rows
    )


def _matrix(cells: Iterable[tuple[str, str]]) -> dict[str, dict[str, int]]:
    counts: dict[str, Counter[str]] = {}
    for expected, reported in cells:
        counts.setdefault(expected, Counter())[reported] += 1
    return {expected: in_order(counts[expected]) for expected in sorted(counts, key=_rank)}


def in_order(counts: Mapping[str, int]) -> dict[str, int]:
    """Return counts in the order of the outcomes, false claims behind the valid ones; anything else last by name."""
    return {outcome: counts[outcome] for outcome in sorted(counts, key=_rank)}


_FIRST = (str(Outcome.VALID), BEYOND_LIMIT, BEYOND_SIGMA)
_NAMES = (*_FIRST, *(str(outcome) for outcome in Outcome if str(outcome) not in _FIRST), BORDERLINE)
_ORDER = {name: i for i, name in enumerate(_NAMES)}


def _rank(name: str) -> tuple[int, str]:
    return _ORDER.get(name, len(_ORDER)), name


CONFIDENCE = 0.95


def proportion(k: int, n: int) -> dict[str, Any]:
    """``{n: k, of: n, rate, interval}`` with the Clopper-Pearson 95 % interval; ``None`` for 0 of 0."""
    if n == 0:
        return {"n": 0, "of": 0, "rate": None, "interval": None}
    interval = stats.binomtest(k, n).proportion_ci(confidence_level=CONFIDENCE, method="exact")
    return {"n": k, "of": n, "rate": k / n, "interval": [float(interval.low), float(interval.high)]}


def upper_bound(k: int, n: int) -> float | None:
    """One-sided 95 % upper bound of a rate of which ``k`` of ``n`` were seen: the bound of "below 0.1 %"."""
    if n == 0:
        return None
    one_sided = stats.binomtest(k, n, alternative="less").proportion_ci(confidence_level=CONFIDENCE, method="exact")
    return float(one_sided.high)


def rates(rows: Sequence[Row], likelihood: Collection[str] = ()) -> dict[str, Any]:
    """Return what an estimator delivers and at what risk, from rows of results.

    Returns
    -------
    dict
        ``availability``: claims among the frames that should give an attitude. ``refusal``: the rest of them.
        ``bonus``: claims among the frames that should not. ``false_valid``: false ones among all claims, with
        ``upper_bound`` and, of them, how many are ``beyond_limit`` and ``beyond_sigma``; ``false_valid_frames``: false
        ones among all frames. ``claims_without_sigma``: how many claims claim no uncertainty and are judged by the
        default (:data:`horizonval.scoring.limits.DEFAULT_SIGMA_RAD`). ``crashed``: frames on which the estimator
        crashed, among all. ``n_borderline``: frames not counted in the first three.
    """
    claims = [row for row in rows if row.is_claim]
    clear = [row for row in rows if not row.borderline]
    due = [row for row in clear if row.is_due]
    others = [row for row in clear if not row.is_due]
    answered = sum(row.is_claim for row in due)
    reasons = Counter(why_false(row, likelihood) for row in claims if row.false_valid)
    false = reasons.total()
    return {
        "availability": proportion(answered, len(due)),
        "refusal": proportion(len(due) - answered, len(due)),
        "bonus": proportion(sum(row.is_claim for row in others), len(others)),
        "false_valid": proportion(false, len(claims))
        | {"upper_bound": upper_bound(false, len(claims))}
        | {"beyond_limit": reasons[BEYOND_LIMIT], "beyond_sigma": reasons[BEYOND_SIGMA]},
        "false_valid_frames": proportion(false, len(rows)) | {"upper_bound": upper_bound(false, len(rows))},
        "claims_without_sigma": sum(row.without_sigma for row in claims),
        "crashed": proportion(sum(row.status == Outcome.CRASHED for row in rows), len(rows)),
        "n_borderline": len(rows) - len(clear),
    }


def noise_nees(fits: Sequence[Fit]) -> FloatArray:
    """Return the normalised error squared of every draw of one frame (2 degrees of freedom); ValueError below two."""
    if len(fits) < 2:
        raise ValueError(f"{len(fits)} draws have no scatter; at least 2 are needed")
    off, covariances = _across_mean(fits)
    squares = np.einsum("ij,ij->i", off, np.linalg.solve(covariances, off[..., None])[..., 0])
    return np.asarray(squares * len(fits) / (len(fits) - 1))


def mean_noise_nees(fits: Sequence[Fit]) -> float | None:
    """Return the mean of :func:`noise_nees`, ``None`` where the fits say nothing of their noise.

    That is with fewer than two of them, and where a claim is not finite or of a direction known perfectly.
    """
    if len(fits) < 2 or not all(np.isfinite(fit.nadir_cam).all() for fit in fits):
        return None
    _, covariances = _across_mean(fits)
    if not np.isfinite(covariances).all():
        return None
    smaller, larger = np.linalg.eigvalsh((covariances + covariances.swapaxes(1, 2)) / 2).T
    if not (smaller > limits.SHARPEST * larger).all():
        return None
    mean = float(noise_nees(fits).mean())
    return mean if np.isfinite(mean) else None


def _across_mean(fits: Sequence[Fit]) -> tuple[FloatArray, FloatArray]:
    """Deviations from the mean nadir, shape (n, 2), and covariances, shape (n, 2, 2), in the plane across it."""
    nadirs = np.array([fit.nadir_cam for fit in fits], dtype=np.float64)
    mean = nadirs.mean(axis=0)
    basis = tangent_basis(mean / np.linalg.norm(mean))
    covariances = np.array([basis.T @ fit.covariance_nadir_cam @ basis for fit in fits], dtype=np.float64)
    return (nadirs - mean) @ basis, covariances


NOT_MADE = "in frames that could not be made"
NO_LIMB = "with too little limb in view"
SUN = "with the Sun in the frame"
NIGHT = "on the night side"
TERMINATOR = "at the terminator"
SATURATED = "with a saturated limb"
CLEAR = "with a clear limb"


def condition_of(row: Row) -> str:
    """Return what was in view, as words of a sentence: the first that applies of those above, in their order."""
    if row.epoch_utc is None:
        return NOT_MADE
    if row.lit_fraction is None or row.expected in (Outcome.NO_LIMB, Outcome.SHORT_ARC):
        return NO_LIMB
    if row.sun_in_frame:
        return SUN
    if row.lit_fraction < 1.0:
        return TERMINATOR if row.lit_fraction > 0.0 else NIGHT
    return SATURATED if row.expected == Outcome.SATURATED else CLEAR


def headline(rows: Sequence[Row], orbit: Collection[str] = ()) -> dict[str, Any]:
    """Return what a line says of rows of one estimator.

    ``orbit`` names the cases that are samples of an orbit, evenly spread along it.

    Returns
    -------
    dict
        ``orbit`` and ``due``: of the frames along an orbit, and of those that should give an attitude, how many it
        worked in, as :func:`proportion`; samples of an orbit are not random, so they have no interval. ``false``,
        ``crashed``, ``silent``: where, as ``[condition, n, of]`` the most first, ``of`` all frames of that condition.
        ``worst_arcsec``: the largest error of any claim, with ``n``, the claims.
    """
    flown = [row for row in rows if row.case in orbit]
    due = [row for row in rows if row.is_due]
    errors = [row.nadir_error_arcsec for row in rows if row.is_claim and row.nadir_error_arcsec is not None]
    crashed = [row for row in rows if row.status == Outcome.CRASHED]
    silent = [row for row in rows if not row.is_claim and row.status != Outcome.CRASHED]
    return {
        "orbit": {**proportion(sum(row.is_right for row in flown), len(flown)), "interval": None},
        "due": proportion(sum(row.is_right for row in due), len(due)),
        "false": _where([row for row in rows if row.is_claim and row.false_valid], rows),
        "crashed": _where(crashed, rows),
        "silent": _where(silent, rows),
        "worst_arcsec": max(errors, default=None),
        "n": len(errors),
    }


def _where(some: Sequence[Row], rows: Sequence[Row]) -> list[list[Any]]:
    conditions = [condition_of(row) for row in some]
    everywhere = [condition_of(row) for row in rows]
    return [
        [condition, conditions.count(condition), everywhere.count(condition)]
        for condition in sorted(set(conditions), key=lambda name: (-conditions.count(name), name))
    ]


SUMMARY_SCHEMA = 1
NEES_EXPECTED = 2.0

Summary = dict[str, Any]


def summarise(
    rows: Sequence[Row],
    given_pose: Collection[str] = (),
    orbit: Collection[str] = (),
    likelihood: Collection[str] = (),
) -> Summary:
    """Summarise rows of results.

    Parameters
    ----------
    rows : sequence of Row
    given_pose : collection of str, optional
        Estimators that are given the true pose: they test the scoring and are left out of ``rates``.
    orbit : collection of str, optional
        Cases that are samples of an orbit.
    likelihood : collection of str, optional
        Estimators whose claims are those of a likelihood fit.

    Returns
    -------
    dict
        JSON data: ``schema``, ``n_cases``, ``n_rows``, ``rates`` (:func:`rates`), and ``groups`` by estimator and
        camera: :func:`summarise_group` with ``given_pose`` and ``headline`` (:func:`headline`).
    """
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.estimator, row.camera), []).append(row)
    return {
        "schema": SUMMARY_SCHEMA,
        "n_cases": len({row.case for row in rows}),
        "n_rows": len(rows),
        "rates": rates([row for row in rows if row.estimator not in given_pose], likelihood),
        "groups": [
            {
                "estimator": estimator,
                "camera": camera,
                "given_pose": estimator in given_pose,
                "headline": headline(groups[estimator, camera], orbit),
                **summarise_group(groups[estimator, camera], likelihood),
            }
            for estimator, camera in sorted(groups)
        ],
    }


def summarise_group(rows: Sequence[Row], likelihood: Collection[str] = ()) -> dict[str, Any]:
    """Return statistics over rows that belong together; None where there is nothing to compute from.

    Returns
    -------
    dict
        ``n``; ``n_expected_valid``, borderline frames left out; ``n_valid`` (claims); the keys of :func:`rates`;
        ``nadir_error_arcsec``, ``error_over_bound`` and ``bound_arcsec`` of claims: ``{n, rms, median, p95, max}``;
        ``roll_error_arcsec``, ``pitch_error_arcsec``, ``altitude_error_km``: ``{n, mean, std}``; ``refusals``:
        ``{status: n}``; ``confusion`` and ``strict_confusion``: ``{expected: {reported: n}}``; ``nees_nadir`` by the
        claimed noise, ``nees_nadir_total`` by noise and model error: ``{n, mean, expected, interval}`` where
        ``interval`` contains the mean of an honest covariance with 95 %; ``nees_noise``: the same of ``n`` frames with
        at least two fits, with ``draws``, their fits, and ``standard_error`` of the mean.
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
        "strict_confusion": strict_confusion(rows, likelihood),
        "nees_nadir": _nees(_column(claims, "nees_nadir")),
        "nees_nadir_total": _nees(_column(claims, "nees_nadir_total")),
        "nees_noise": _noise(rows),
        **rates(rows, likelihood),
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
