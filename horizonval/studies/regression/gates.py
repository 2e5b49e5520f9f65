"""From two sets of results to the estimate of each gate, and the scenes it comes from.

A set of results holds rows (one for each image and estimator), what images of each scene are like, and fresh rows. The
present night is compared with the accepted baseline and with the last release in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any

from horizonval.spec.suite import IMAGE_METRICS, TWO_SIDED, GateSpec
from horizonval.studies.regression.row import ERRORS, ReplicateRow
from horizonval.studies.regression.statistics import (
    Estimate,
    decide,
    independent_difference,
    independent_loss,
    paired_difference,
    paired_loss,
)

PERCENT = 100.0
ANGLE_LIMIT_ARCSEC = 1e-6 * 3600
"""Angles that differ by less than 1e-6 deg count as equal: ten times the rounding of stored ones."""
MOST_NAMED = 12
"""Scenes of a gate that are named; ``n_scenes`` counts all changed ones."""


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
    """A gate's estimate in its unit, None with too few data; and the scenes with the largest weight."""

    gate: GateSpec
    estimate: Estimate | None
    scenes: tuple[str, ...]
    paired: bool


def measure(gate: GateSpec, now: GateInputs, base: GateInputs) -> Measured:
    """Return a gate's estimate of the difference between two sets of results."""
    if gate.metric in IMAGE_METRICS:
        return _images(gate, now)
    if gate.lane == "fresh":
        mine, theirs = _chosen(gate, now.fresh), _chosen(gate, base.fresh)
        if now.fresh_night != base.fresh_night or not now.fresh_night:
            # A method in only one of them would look like a change of all.
            both = {row.estimator for row in mine} & {row.estimator for row in theirs}
            mine, theirs = ([row for row in rows if row.estimator in both] for rows in (mine, theirs))
            return Measured(gate, _independent(gate, mine, theirs), (), paired=False)
    else:
        mine, theirs = _chosen(gate, now.rows), _chosen(gate, base.rows)
    return _paired(gate, pairs_of(mine, theirs))


def pairs_of(now: Iterable[ReplicateRow], base: Iterable[ReplicateRow]) -> list[tuple[ReplicateRow, ReplicateRow]]:
    """Return (now, base) of every common scene, band, replicate and estimator."""
    before = {row.key: row for row in base}
    return [(row, before[row.key]) for row in now if row.key in before]


def changed(pairs: Iterable[tuple[ReplicateRow, ReplicateRow]]) -> list[dict[str, Any]]:
    """Return all pairs with another status or an angle beyond :data:`ANGLE_LIMIT_ARCSEC`.

    Changed statuses come first, then the largest changes of the nadir error.
    """
    found: list[tuple[tuple[bool, float], dict[str, Any]]] = []
    for now, base in pairs:
        what = []
        if now.status != base.status:
            what.append(f"{base.status} -> {now.status}")
        if now.false_valid != base.false_valid:
            what.append("became false" if now.false_valid else "no longer false")
        for key in ERRORS:
            before, after = getattr(base, key), getattr(now, key)
            if before is not None and after is not None and abs(after - before) > ANGLE_LIMIT_ARCSEC:
                what.append(f"{key.removesuffix('_error_arcsec')} error {before:.4g} -> {after:.4g} arcsec")
        if what:
            names = dict(zip(("scene", "band", "replicate", "estimator"), now.key, strict=True))
            moved = abs((now.nadir_error_arcsec or 0.0) - (base.nadir_error_arcsec or 0.0))
            same = now.status == base.status and now.false_valid == base.false_valid
            found.append(((same, -moved), {**names, "what": "; ".join(what)}))
    return [one for _, one in sorted(found, key=lambda item: item[0])]


def _chosen(gate: GateSpec, rows: Iterable[ReplicateRow]) -> list[ReplicateRow]:
    return [
        row
        for row in rows
        if (not gate.estimators or row.estimator in gate.estimators) and (not gate.cases or row.table in gate.cases)
    ]


ERROR_OF: dict[str, Callable[[ReplicateRow], float | None]] = {
    "nadir_error": attrgetter("nadir_error_arcsec"),
    "error_over_bound": attrgetter("error_over_bound"),
}
"""Metrics whose mean over claims is compared; the others are shares."""
_is_claim: Callable[[ReplicateRow], bool] = attrgetter("is_claim")


def _is_sound(row: ReplicateRow) -> bool:
    return not row.false_valid


def _paired(gate: GateSpec, pairs: Sequence[tuple[ReplicateRow, ReplicateRow]]) -> Measured:
    if gate.metric in ERROR_OF:
        values = [(ERROR_OF[gate.metric](n), ERROR_OF[gate.metric](b), n.case) for n, b in pairs]
        both = [(now - before, scene) for now, before, scene in values if now is not None and before is not None]
        estimate = paired_difference([d for d, _ in both], [scene for _, scene in both])
        return Measured(gate, estimate, _weightiest(both), paired=True)
    good: Callable[[ReplicateRow], bool] = _is_sound
    if gate.metric == "availability":
        good, pairs = _is_claim, [(n, b) for n, b in pairs if b.is_due]
    estimate = paired_loss([good(b) for _, b in pairs], [good(n) for n, _ in pairs], [n.case for n, _ in pairs])
    moved = [(PERCENT * (int(good(b)) - int(good(n))), n.case) for n, b in pairs]
    return Measured(gate, _scaled(estimate), _weightiest(moved), paired=True)


def _independent(gate: GateSpec, now: Sequence[ReplicateRow], base: Sequence[ReplicateRow]) -> Estimate | None:
    if gate.metric in ERROR_OF:
        mine, theirs = (
            [(error, r.case) for r in rows if (error := ERROR_OF[gate.metric](r)) is not None] for rows in (now, base)
        )
        return independent_difference(
            [error for error, _ in mine],
            [scene for _, scene in mine],
            [error for error, _ in theirs],
            [scene for _, scene in theirs],
        )
    good: Callable[[ReplicateRow], bool] = _is_sound
    if gate.metric == "availability":
        good = _is_claim
        now, base = [r for r in now if r.is_due], [r for r in base if r.is_due]
    # Several estimators on one frame are not several frames: a frame is good if all of them are.
    mine_by, theirs_by = _all_good(now, good), _all_good(base, good)
    return _scaled(independent_loss(sum(theirs_by), len(theirs_by), sum(mine_by), len(mine_by)))


def _all_good(rows: Iterable[ReplicateRow], good: Callable[[ReplicateRow], bool]) -> list[bool]:
    frames: dict[tuple[str, str, int], bool] = {}
    for row in rows:
        key = (row.case, row.band, row.replicate)
        frames[key] = frames.get(key, True) and good(row)
    return list(frames.values())


def _images(gate: GateSpec, now: GateInputs) -> Measured:
    found = [
        (float(image[gate.metric]), scene)
        for (scene, _), image in now.images.items()
        if image.get(gate.metric) is not None and (not gate.cases or image["table"] in gate.cases)
    ]
    estimate = paired_difference([value for value, _ in found], [scene for _, scene in found])
    return Measured(gate, estimate, _weightiest(found), paired=True)


def _weightiest(values: Sequence[tuple[float, str]]) -> tuple[str, ...]:
    """Return the scenes with the largest changes, worse first, without unchanged ones."""
    sums: dict[str, float] = {}
    for value, scene in values:
        sums[scene] = sums.get(scene, 0.0) + value
    return tuple(
        scene for scene, value in sorted(sums.items(), key=lambda item: (-item[1], item[0])) if value > 0
    ) + tuple(scene for scene, value in sorted(sums.items(), key=lambda item: (item[1], item[0])) if value < 0)


def _scaled(estimate: Estimate | None) -> Estimate | None:
    """Return a share in percentage points."""
    if estimate is None:
        return None
    e, p = estimate, PERCENT
    bounds = (e.lower95 * p, e.upper95 * p, e.lower99 * p, e.upper99 * p)
    return Estimate(e.value * p, *bounds, e.p_worse, e.p_better, e.n, e.clusters)


def judge(measured: Sequence[tuple[str, Measured]], looks: int = 1) -> list[dict[str, Any]]:
    """Return every gate with its verdict as plain data; p-values are adjusted over all gates together.

    ``measured``: base (``accepted``, ``release``) and estimates. ``looks``: as for
    :func:`horizonval.studies.regression.statistics.decide`.
    """
    decided = decide(
        [one.estimate for _, one in measured],
        [one.gate.margin for _, one in measured],
        [one.gate.metric in TWO_SIDED for _, one in measured],
        looks,
    )
    return [
        {
            "against": name,
            "name": one.gate.name,
            "lane": one.gate.lane,
            "metric": one.gate.metric,
            "margin": one.gate.margin,
            "unit": one.gate.unit,
            "reason": one.gate.reason,
            "two_sided": one.gate.metric in TWO_SIDED,
            "paired": one.paired,
            "verdict": str(verdict),
            "p_adjusted": p,
            "estimate": None if one.estimate is None else one.estimate.to_dict(),
            "scenes": list(one.scenes[:MOST_NAMED]),
            "n_scenes": len(one.scenes),
        }
        for (name, one), (verdict, p) in zip(measured, decided, strict=True)
    ]


def figure(value: float | None, digits: int = 3) -> str:
    """Return a number with the given digits; an en dash for None."""
    if value is None:
        return "–"
    return f"{value:.{digits}g}" if abs(value) < 999.5 else f"{value:.0f}"


def gate_sentence(gate: Mapping[str, Any]) -> str:
    """Return a gate's estimate and margin in words."""
    estimate, unit = gate["estimate"], gate["unit"]
    if estimate is None:
        return f"too few scenes to say anything about {gate['metric']} (margin {figure(gate['margin'])} {unit})"
    sign = "+" if estimate["value"] > 0 else ""
    text = (
        f"{gate['metric']} {sign}{figure(estimate['value'])} {unit} "
        f"(95 % bounds {figure(estimate['lower95'])} to {figure(estimate['upper95'])}), "
        f"margin {figure(gate['margin'])} {unit}, {'paired' if gate['paired'] else 'other scenes'}, "
        f"n = {estimate['n']} in {estimate['clusters']} scenes, p = {figure(gate['p_adjusted'])}"
    )
    if gate["verdict"] in ("FAIL", "IMPROVED") and gate["scenes"]:
        text += f"; scenes: {scenes(gate)}"
    return text


def scenes(gate: Mapping[str, Any]) -> str:
    """Return the scenes with the largest weight, and the number of others."""
    more = gate["n_scenes"] - len(gate["scenes"])
    return ", ".join(gate["scenes"]) + (f" and {more} more" if more > 0 else "")
