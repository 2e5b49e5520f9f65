"""A night's judgements in plain English."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from horizonval.studies.regression.statistics import Verdict

Gate = Mapping[str, Any]
LANE_WORDS = {
    "replay": "frozen images",
    "rerender": "images rendered again",
    "fresh": "other scenes",
}
SIZES = {
    "roll_scatter": "scatter of the roll error",
    "pitch_scatter": "scatter of the pitch error",
    "nadir_error": "nadir error (rms)",
    "nadir_error_median": "median nadir error",
    "altitude_error": "altitude error (rms)",
    "error_over_bound": "nadir error over the bound",
}
MEANS = {"roll_mean": "mean roll error", "pitch_mean": "mean pitch error", "altitude_mean": "mean altitude error"}
IMAGES = {
    "limb_radiance": "radiance of the limb",
    "disc_radiance": "radiance of the disc",
    "limb_displacement": "displacement of the limb",
    "noise": "noise of the detector",
}


def figure(value: float | None, digits: int = 3) -> str:
    """Return a number with the given digits; an en dash for None."""
    if value is None:
        return "–"
    return f"{value:.{digits}g}" if abs(value) < 999.5 else f"{value:.0f}"


def subject(gate: Gate) -> str:
    """Return the method, table, camera and band that a judgement is about."""
    return f"{gate['estimator'] or 'images'} in {gate['cases']} ({gate['camera']}, {gate['band']})"


def scenes(gate: Gate) -> str:
    """Return the scenes with the largest weight, and the number of others."""
    more = gate["n_scenes"] - len(gate["scenes"])
    return ", ".join(gate["scenes"]) + (f" and {more} more" if more > 0 else "")


def gate_sentence(gate: Gate) -> str:
    """Return what changed, and its margin."""
    metric, now, before, n = gate["metric"], gate["now"], gate["before"], gate["n"]
    unit = "" if gate["unit"] in ("1", "factor", "frames") else "points" if "points" in gate["unit"] else gate["unit"]
    margin = f"{figure(gate['margin'])} {unit}".rstrip()
    if gate["lane"] == "fresh" and metric != "crashes":
        return _fresh_sentence(gate, unit, margin)
    change = gate["change"]
    if metric == "crashes":
        allowed = figure(gate["margin"]) if gate["margin"] else "none"
        return f"crashed in {now:.0f} of {n} images, before in {before:.0f} (new ones allowed: {allowed})"
    if metric == "availability":
        if gate["verdict"] == Verdict.IMPROVED:
            return f"new answers in {figure(-change)} % of the images"
        return f"{before - now:.0f} of {n} answers are lost, {figure(max(change, 0.0))} % (margin {margin})"
    if metric == "false_valid":
        points = f"{figure(change)} points (margin {margin})"
        return f"false claims in {now:.0f} of {n} images, before in {before:.0f}: {points}"
    if metric in MEANS:
        return f"{MEANS[metric]} moved by {figure(now - before)} {unit}, from {figure(before)} (margin {margin})"
    if metric == "honesty":
        sense = "surer" if now > before else "less sure"
        return (
            f"squared error over claim {figure(before)} -> {figure(now)}: claims are {sense} of themselves, "
            f"by a factor of {figure(change)} (margin {margin})"
        )
    if metric == "claimed_sigma":
        return (
            f"{figure(change)} % of {n} claimed sigmas changed by more than a factor of 1.5, in the median "
            f"{figure(before)} -> {figure(now)} arcsec (margin {margin})"
        )
    if metric == "without_sigma":
        return f"claims without a sigma {before:.0f} -> {now:.0f} of {n} (margin: a factor of {margin})"
    if metric in IMAGES:
        return f"{IMAGES[metric]} differs by {figure(now)} {unit} in one scene of {n} (margin {margin})"
    return f"{SIZES[metric]} {figure(before)} -> {figure(now)} {unit}".rstrip() + f" (margin {margin})"


def _fresh_sentence(gate: Gate, unit: str, margin: str) -> str:
    name = {"availability": "availability", "false_valid": "false claims"}.get(gate["metric"], "mean nadir error")
    if gate["metric"] == "error_over_bound":
        name = "mean error over the bound"
    estimate = gate["estimate"]
    if estimate is None:
        return f"{name}: too few scenes (margin {margin})"
    return (
        f"{name} {figure(gate['before'])} -> {figure(gate['now'])}, worse by {figure(estimate['value'])} {unit} "
        f"({figure(estimate['lower95'])} to {figure(estimate['upper95'])} at 95 %, margin {margin}, "
        f"adjusted p = {figure(gate['p_adjusted'], 2)})"
    )


def by_subject(gates: Iterable[Gate]) -> list[tuple[Gate, Verdict, list[Gate]]]:
    """Return by lane, baseline and subject the first gate, the verdict of all, and the gates that decide it."""
    groups: dict[tuple[str, ...], list[Gate]] = {}
    for gate in gates:
        key = tuple(gate[k] for k in ("against", "lane", "estimator", "cases", "camera", "band"))
        groups.setdefault(key, []).append(gate)
    found = []
    for own in groups.values():
        verdict = worst([Verdict(gate["verdict"]) for gate in own])
        found.append((own[0], verdict, [gate for gate in own if gate["verdict"] == verdict]))
    return found


def worst(verdicts: Sequence[Verdict]) -> Verdict:
    """Return FAIL if any is, else INCONCLUSIVE, else IMPROVED, else PASS; without any, INCONCLUSIVE."""
    for verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE, Verdict.IMPROVED):
        if verdict in verdicts:
            return verdict
    return Verdict.PASS if verdicts else Verdict.INCONCLUSIVE


def subject_sentence(first: Gate, deciding: Sequence[Gate], *, lane: bool = True) -> str:
    """Return a subject, with its lane or without, and the sentences of the gates that decide about it."""
    against = " since the last release" if first["against"] == "release" else ""
    text = "; ".join(gate_sentence(gate) for gate in deciding)
    named = next((gate for gate in deciding if gate["scenes"]), None)
    where = f"; scenes: {scenes(named)}" if named is not None and first["lane"] != "fresh" else ""
    which = f", {LANE_WORDS[first['lane']]}" if lane else ""
    return f"{subject(first)}{which}{against}: {text}{where}"
