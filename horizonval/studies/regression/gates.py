"""Facts of a night: what changed on the same images, counted for every method, camera and band, against its margin.

Images, scenes and noise seeds are the baseline's, so an answer differs only because the code does. The frozen set is
the whole population: a change is a number without an interval, and one beyond its margin is a regression.

A mean is compared by the change of each answer, which hides neither behind the errors' scatter nor behind another axis.
Scatter, total and median may grow by a tenth of the baseline's value, so that equally good answers may differ. Lost and
gained answers do not cancel, nor do answers that became false and others that no longer are.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome
from horizonval.spec.suite import IMAGE_METRICS, STANDING, Lane, Metric, RegressionSpec
from horizonval.studies.regression.partners import MOST_NAMED, Group, Pair
from horizonval.studies.regression.row import ERRORS, ReplicateRow
from horizonval.studies.regression.statistics import Verdict

PERCENT = 100.0
ROUNDING = 1e-9
"""Relative excess over a margin that is rounding."""
SMALL_NEES = 0.1, 1e-6
"""Squared errors over claims below the first do not count in ratios of single frames, below the second in ratios of
means: an error may be zero by chance."""
SAME_SIGMA = 1.5
"""Factor between two claimed sigmas of one image up to which they count as the same."""
NONE_IS = 0.5
"""Number of claims in place of none, in a ratio."""


@dataclass(frozen=True)
class GateInputs:
    """Inputs of the gates.

    ``rows``: :class:`horizonval.studies.regression.row.ReplicateRow`. ``images``: by (scene, band) ``{table,
    limb_radiance, disc_radiance, limb_displacement, noise, ...}``, this set against the base; None where a metric does
    not apply; empty for a base. ``fresh``: rows of the fresh lane. ``fresh_night``: night of the fresh scenes; sets of
    the same night are paired.
    """

    rows: Sequence[ReplicateRow] = ()
    images: Mapping[tuple[str, str], Mapping[str, Any]] = field(default_factory=dict)
    fresh: Sequence[ReplicateRow] = ()
    fresh_night: str = ""


@dataclass(frozen=True)
class Measured:
    """A metric before and now, its changes for the worse and for the better in the margin's unit, in ``n`` answers, and
    the weights of the scenes.
    """

    before: float
    now: float
    worse: float
    better: float
    n: int
    weights: Sequence[tuple[float, str]] = ()


def margin_of(
    spec: RegressionSpec, lane: Lane, metric: Metric, group: Group, before: float
) -> tuple[float | None, str | None]:
    """Return the margin of a metric and the reason of the suite's gate that sets it, if one does."""
    own = [
        gate
        for gate in spec.gate
        if (gate.lane, gate.metric) == (lane, metric)
        and (not gate.estimators or not group.estimator or group.estimator in gate.estimators)
        and (not gate.cases or group.cases in gate.cases)
    ]
    if own:
        gate = min(own, key=lambda gate: gate.margin)
        return gate.margin, gate.reason
    standing = STANDING[metric]
    if lane == "fresh":
        return None if standing.fresh is None else max(standing.fresh[0], standing.fresh[1] * before), None
    return None if standing.margin is None else max(standing.margin, standing.of_base * before), None


def judge_rows(
    spec: RegressionSpec, lane: Lane, pairs: Iterable[Pair], cameras: Mapping[str, str], against: str = "accepted"
) -> list[dict[str, Any]]:
    """Return every metric of every method, camera and band with its verdict, as plain data."""
    groups: dict[Group, list[Pair]] = {}
    for now, base in pairs:
        groups.setdefault(group_of(base, cameras), []).append((now, base))
    found = []
    for group, own in sorted(groups.items()):
        measured = {metric: one for metric, measure in ROW_METRICS.items() if (one := measure(own)) is not None}
        judged = {metric: _judged(spec, lane, metric, group, one, against) for metric, one in measured.items()}
        _settle_means(judged)
        found += [one for one in judged.values() if one is not None]
    return found


def judge_images(
    spec: RegressionSpec,
    images: Mapping[tuple[str, str], Mapping[str, Any]],
    cameras: Mapping[str, str],
    against: str = "accepted",
) -> list[dict[str, Any]]:
    """Return every metric of the rendered images of a table, camera and band: the scene that differs most decides."""
    values: dict[tuple[Group, Metric], list[tuple[float, str]]] = {}
    for (scene, band), image in images.items():
        for metric in IMAGE_METRICS:
            if image.get(metric) is not None:
                group = Group("", image["table"], cameras.get(scene, ""), band)
                values.setdefault((group, metric), []).append((float(image[metric]), scene))
    found = []
    for (group, metric), own in sorted(values.items()):
        most = max((value for value, _ in own), key=abs)
        one = Measured(0.0, most, abs(most), 0.0, len(own), [(abs(value), scene) for value, scene in own])
        judged = _judged(spec, "rerender", metric, group, one, against)
        found += [judged] if judged is not None else []
    return found


def group_of(row: ReplicateRow, cameras: Mapping[str, str]) -> Group:
    """Return the method, table, camera and band of a row; a fresh scene has the camera of the fixed one."""
    return Group(row.estimator, row.table, cameras.get(row.case.rpartition("/")[2], ""), row.band)


def _judged(
    spec: RegressionSpec, lane: Lane, metric: Metric, group: Group, one: Measured, against: str
) -> dict[str, Any] | None:
    margin, reason = margin_of(spec, lane, metric, group, one.before)
    if margin is None:
        return None
    limit = margin * (1 + ROUNDING)
    verdict = Verdict.FAIL if one.worse > limit else Verdict.IMPROVED if one.better > limit else Verdict.PASS
    scenes = weightiest(one.weights)
    return {
        "against": against,
        "lane": lane,
        "metric": metric,
        **group._asdict(),
        "verdict": str(verdict),
        "before": one.before,
        "now": one.now,
        "change": one.worse if one.worse >= one.better else -one.better,
        "margin": margin,
        "unit": STANDING[metric].unit,
        "reason": reason,
        "n": one.n,
        "estimate": None,
        "scenes": list(scenes[:MOST_NAMED]),
        "n_scenes": len(scenes),
    }


def _settle_means(judged: Mapping[Metric, dict[str, Any] | None]) -> None:
    """Count a mean that came nearer to zero as better, if the total error fell beyond its margin, too."""
    total = judged.get("nadir_error")
    for metric in ("roll_mean", "pitch_mean"):
        one = judged.get(metric)
        if one is None or total is None or one["verdict"] != Verdict.FAIL or total["verdict"] != Verdict.IMPROVED:
            continue
        if abs(one["now"]) < abs(one["before"]):
            one["verdict"] = str(Verdict.IMPROVED)


def _crashes(pairs: Sequence[Pair]) -> Measured:
    crashed = [(n.status == Outcome.CRASHED, b.status == Outcome.CRASHED, n.case) for n, b in pairs]
    return _counted(crashed, len(pairs), 1.0)


def _is_missed(now: ReplicateRow, base: ReplicateRow) -> bool:
    """Whether a claim is gone, or an angle or the altitude of it."""
    return not now.is_claim or any(getattr(base, e) is not None and getattr(now, e) is None for e in ERRORS)


def _availability(pairs: Sequence[Pair]) -> Measured | None:
    """Loss among right answers, and answers of images that must be answered; gains among all images."""
    answered = [(n, b) for n, b in pairs if b.is_claim and (b.is_due or not b.false_valid)]
    gained = [n for n, b in pairs if n.is_right and not b.is_claim]
    if not answered and not gained:
        return None
    lost = [n for n, b in answered if _is_missed(n, b) and not n.false_valid]
    return Measured(
        len(answered),
        len(answered) - len(lost),
        PERCENT * len(lost) / max(len(answered), 1),
        PERCENT * len(gained) / len(pairs),
        len(answered),
        [(1.0, row.case) for row in lost],
    )


def _false_valid(pairs: Sequence[Pair]) -> Measured:
    return _counted([(n.false_valid, b.false_valid, n.case) for n, b in pairs], len(pairs), PERCENT / len(pairs))


def _counted(flags: Sequence[tuple[bool, bool, str]], n: int, scale: float) -> Measured:
    """Return the measure of something bad that is true or false of a frame (now, before, scene)."""
    became = [scene for now, before, scene in flags if now and not before]
    ended = sum(before and not now for now, before, _ in flags)
    before = sum(before for _, before, _ in flags)
    count = before + len(became) - ended
    return Measured(before, count, scale * len(became), scale * ended, n, [(1.0, scene) for scene in became])


def _errors(pairs: Sequence[Pair], name: str) -> tuple[FloatArray, FloatArray, list[str]]:
    """Return a number of all pairs that have it, now and before, and their scenes."""
    own = [(getattr(n, name), getattr(b, name), n.case) for n, b in pairs]
    known = [one for one in own if one[0] is not None and one[1] is not None]
    now, before = (np.array([one[k] for one in known], dtype=np.float64) for k in (0, 1))
    return now, before, [scene for _, _, scene in known]


def _mean(name: str) -> Callable[[Sequence[Pair]], Measured | None]:
    """Return the measure of a mean's change, of which neither sign is better."""

    def measure(pairs: Sequence[Pair]) -> Measured | None:
        now, before, scenes = _errors(pairs, name)
        if not len(now):
            return None
        moved = now - before
        change = float(np.mean(moved))
        weights = zip((moved * math.copysign(1.0, change)).tolist(), scenes, strict=True)
        return Measured(float(np.mean(before)), float(np.mean(now)), abs(change), 0.0, len(now), list(weights))

    return measure


def _grown(
    name: str, size: Callable[[FloatArray], Any], weight: Callable[[FloatArray, FloatArray], FloatArray]
) -> Callable[[Sequence[Pair]], Measured | None]:
    """Return the measure of the change of a size, of which less is better."""

    def measure(pairs: Sequence[Pair]) -> Measured | None:
        now, before, scenes = _errors(pairs, name)
        if not len(now):
            return None
        was, is_now = float(size(before)), float(size(now))
        weights = list(zip(weight(now, before).tolist(), scenes, strict=True))
        return Measured(was, is_now, is_now - was, was - is_now, len(now), weights)

    return measure


def _squares(now: FloatArray, before: FloatArray) -> FloatArray:
    return now**2 - before**2


def _difference(now: FloatArray, before: FloatArray) -> FloatArray:
    return now - before


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _honesty(pairs: Sequence[Pair]) -> Measured | None:
    """Factor of the mean, or of single frames in the geometric mean: there a few large squares hide nothing."""
    now, before, scenes = _errors(pairs, "nees_nadir_total")
    if not len(now):
        return None
    small, tiny = SMALL_NEES
    of_means = math.log((float(np.mean(now)) + tiny) / (float(np.mean(before)) + tiny))
    single = np.log((now + small) / (before + small))
    factor = math.exp(max(abs(of_means), abs(float(np.mean(single)))))
    weights = list(zip(np.abs(single).tolist(), scenes, strict=True))
    return Measured(float(np.mean(before)), float(np.mean(now)), factor, 0.0, len(now), weights)


def _without_sigma(pairs: Sequence[Pair]) -> Measured | None:
    own = [(n, b) for n, b in pairs if n.is_claim and b.is_claim and b.states_claim]
    if not own:
        return None
    now, before = sum(n.without_sigma for n, _ in own), sum(b.without_sigma for _, b in own)
    factor = max(now, before) / max(min(now, before), NONE_IS) if now or before else 1.0
    weights = [(1.0, n.case) for n, b in own if n.without_sigma != b.without_sigma]
    return Measured(before, now, factor, 0.0, len(own), weights)


def _claimed_sigma(pairs: Sequence[Pair]) -> Measured | None:
    """Share of claims whose sigma changed, either way: a mean does not show that some became useless."""
    now, before, scenes = _errors(pairs, "sigma_total_arcsec")
    stated = (now > 0.0) & (before > 0.0)
    if not stated.any():
        return None
    factors = np.abs(np.log(now[stated] / before[stated]))
    changed = factors > math.log(SAME_SIGMA) + ROUNDING
    was, is_now = (float(np.median(values[stated][changed])) if changed.any() else 0.0 for values in (before, now))
    own = [scene for scene, is_stated in zip(scenes, stated, strict=True) if is_stated]
    weights = list(zip((factors * changed).tolist(), own, strict=True))
    return Measured(was, is_now, PERCENT * float(np.mean(changed)), 0.0, len(own), weights)


def _altitude(measure: Callable[[Sequence[Pair]], Measured | None]) -> Callable[[Sequence[Pair]], Measured | None]:
    """Return a measure of the altitude's error: one that was not claimed before had none."""

    def of_claims(pairs: Sequence[Pair]) -> Measured | None:
        known = [(n, b) for n, b in pairs if b.states_altitude and n.altitude_error_km is not None]
        return measure([(n, replace(b, altitude_error_km=b.altitude_error_km or 0.0)) for n, b in known])

    return of_claims


def _over_bound(pairs: Sequence[Pair]) -> Measured | None:
    return _grown("error_over_bound", np.mean, _difference)(pairs)


ROW_METRICS: Mapping[Metric, Callable[[Sequence[Pair]], Measured | None]] = {
    "crashes": _crashes,
    "availability": _availability,
    "false_valid": _false_valid,
    "roll_mean": _mean("roll_error_arcsec"),
    "pitch_mean": _mean("pitch_error_arcsec"),
    "roll_scatter": _grown("roll_error_arcsec", np.std, _squares),
    "pitch_scatter": _grown("pitch_error_arcsec", np.std, _squares),
    "nadir_error": _grown("nadir_error_arcsec", _rms, _squares),
    "nadir_error_median": _grown("nadir_error_arcsec", np.median, _difference),
    "altitude_mean": _altitude(_mean("altitude_error_km")),
    "altitude_error": _altitude(_grown("altitude_error_km", _rms, _squares)),
    "error_over_bound": _over_bound,
    "honesty": _honesty,
    "claimed_sigma": _claimed_sigma,
    "without_sigma": _without_sigma,
}


def weightiest(values: Sequence[tuple[float, str]]) -> tuple[str, ...]:
    """Return the scenes with positive weights in sum, the largest first."""
    sums: dict[str, float] = {}
    for value, scene in values:
        sums[scene] = sums.get(scene, 0.0) + value
    return tuple(scene for scene, value in sorted(sums.items(), key=lambda item: (-item[1], item[0])) if value > 0)
