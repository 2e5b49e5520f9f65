"""Answers of a night and the baseline's answers to the same images: pairs, changes, and answers without a partner.

A night that does not ask a method, render a scene or take an image of the baseline cannot say that nothing is worse.
Such answers are named, by what the suite lacks of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from horizonval.core.outcome import Outcome
from horizonval.spec.load import Suite
from horizonval.studies.regression.row import ERRORS, ReplicateRow
from horizonval.suites.plan import CasePlan, units_of
from horizonval.suites.record import camera_name

ANGLE_LIMIT_ARCSEC = 1e-6 * 3600
"""Angles that differ by less than 1e-6 deg count as equal: ten times the rounding of stored ones."""
CLAIM_LIMIT = 1e-4
"""The same of squared errors over claims, relative."""
MOST_NAMED = 12
Pair = tuple[ReplicateRow, ReplicateRow]
"""Tonight's answer and the baseline's."""


class Group(NamedTuple):
    """What is judged by itself: a method on a table of the suite, of one camera and band. Images have no method."""

    estimator: str
    cases: str
    camera: str
    band: str


class Asked(NamedTuple):
    """What a night asks of a scene."""

    camera: str
    bands: frozenset[str]
    estimators: frozenset[str]


@dataclass(frozen=True)
class Promise:
    """What a night of a suite asks: by scene, and replicates of every image."""

    scenes: Mapping[str, Asked]
    replicates: int

    def lacks(self, row: ReplicateRow, camera: str) -> tuple[str, str]:
        """Return the kind and the name of what is missing for an answer of the baseline; empty if nothing is."""
        asked = self.scenes.get(row.case)
        if asked is None:
            return "scene", row.case
        if camera != asked.camera:
            return "camera", f"{camera} of {row.table}"
        if row.band not in asked.bands:
            return "band", f"{row.band} of {row.table}"
        if row.replicate >= self.replicates:
            return "replicate", str(row.replicate)
        if row.estimator not in asked.estimators:
            return "method", f"{row.estimator} in {row.table}"
        return "", ""


def promise_of(suite: Suite, plan: CasePlan, replicates: int) -> Promise:
    """Return what a night of a suite asks."""
    scenes = {}
    for unit in units_of(suite.cases, plan):
        bands = [frozenset(band.name for band in case.camera.band) for case in unit.cases]
        cameras = [camera_name(case) for case in unit.cases]
        for case, camera, own in zip(unit.cases, cameras, bands, strict=True):
            scenes[case.name] = Asked(camera, own, frozenset(plan.alone(case)))
        if unit.heads:
            scenes[unit.name] = Asked(
                cameras[0], frozenset.intersection(*bands), frozenset(plan.together(unit.cases[0]))
            )
    return Promise(scenes, replicates)


def cameras_of(scenes: Mapping[str, Any], together: Mapping[str, Any]) -> dict[str, str]:
    """Return the camera by scene; where a method sees all heads, the first one's."""
    cameras = {name: str(record["camera"]) for name, record in scenes.items()}
    return cameras | {name: cameras.get(record["heads"][0][1], "") for name, record in together.items()}


def pairs_of(now: Iterable[ReplicateRow], base: Iterable[ReplicateRow]) -> list[Pair]:
    """Return (now, base) of every common scene, band, replicate and estimator.

    A crash without a partner is a new one all the same: its partner is a refusal.
    """
    before = {row.key: row for row in base}
    crashed = str(Outcome.CRASHED)
    return [
        (row, before.get(row.key) or replace(row, status=str(Outcome.BAD_INPUT)))
        for row in now
        if row.key in before or row.status == crashed
    ]


def missing(
    promise: Promise, base: Sequence[ReplicateRow], cameras: Mapping[str, str], answered: Iterable[Any] | None
) -> list[str]:
    """Return sentences about answers of the baseline without a partner tonight.

    ``answered``: keys of tonight's answers to the frozen images; None if they were not replayed.
    """
    known = None if answered is None else set(answered)
    lacking: dict[str, dict[str, int]] = {}
    for row in base:
        kind, name = promise.lacks(row, cameras.get(row.case, ""))
        if not kind and known is not None and row.key not in known:
            kind, name = "answer", f"{row.estimator} on {row.case} ({row.band}, replicate {row.replicate})"
        if kind:
            names = lacking.setdefault(kind, {})
            names[name] = names.get(name, 0) + 1
    return [
        f"not compared: {listed(kind, list(names))} of the baseline {'is' if len(names) == 1 else 'are'} missing "
        f"tonight, {sum(names.values())} answers without a partner"
        for kind, names in lacking.items()
    ]


def new(promise: Promise, base: Sequence[ReplicateRow], scenes: Iterable[str]) -> list[str]:
    """Return sentences about what the suite asks and the baseline does not have; it is compared once accepted."""
    known = {*scenes, *(row.case for row in base)}
    methods = {(row.case, row.estimator) for row in base}
    bands = {(row.case, row.band) for row in base}
    found: dict[str, dict[str, None]] = {"scene": {}, "band": {}, "method": {}, "replicate": {}}
    for case, asked in promise.scenes.items():
        if case not in known:
            found["scene"][case] = None
            continue
        found["method"] |= {name: None for name in sorted(asked.estimators) if (case, name) not in methods}
        found["band"] |= {band: None for band in sorted(asked.bands) if asked.estimators and (case, band) not in bands}
    most = 1 + max((row.replicate for row in base), default=-1)
    found["replicate"] |= {str(k): None for k in range(most, promise.replicates)} if base else {}
    return [
        f"new, and not compared until a baseline with it is accepted: {listed(kind, list(names))}"
        for kind, names in found.items()
        if names
    ]


def listed(kind: str, names: Sequence[str]) -> str:
    """Return names after their kind, at most :data:`MOST_NAMED` of them."""
    more = len(names) - MOST_NAMED
    text = ", ".join(names[:MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
    return f"{kind}{'' if len(names) == 1 else 's'} {text}"


def changed(pairs: Iterable[Pair]) -> list[dict[str, Any]]:
    """Return all pairs with another outcome, angle or claim.

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
                name, unit = key.rsplit("_", 1)
                what.append(f"{name.replace('_', ' ')} {before:.4g} -> {after:.4g} {unit}")
        if now.is_claim and base.is_claim and now.without_sigma != base.without_sigma and base.states_claim:
            what.append("no sigma" if now.without_sigma else "a sigma")
        nees, old = now.nees_nadir_total, base.nees_nadir_total
        if not what and nees is not None and old is not None and not math.isclose(nees, old, rel_tol=CLAIM_LIMIT):
            what.append(f"squared error over claim {old:.4g} -> {nees:.4g}")
        if what:
            names = dict(zip(("scene", "band", "replicate", "estimator"), now.key, strict=True))
            moved = abs((now.nadir_error_arcsec or 0.0) - (base.nadir_error_arcsec or 0.0))
            same = now.status == base.status and now.false_valid == base.false_valid
            found.append(((same, -moved), {**names, "what": "; ".join(what)}))
    return [one for _, one in sorted(found, key=lambda item: item[0])]
