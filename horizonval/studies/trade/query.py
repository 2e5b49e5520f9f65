"""The cheapest design that reaches what is asked for, and what the sample is too small to say.

A design *meets* the requirement if the one-sided 95 % bound of its share of frames within the error lies above the
availability, *fails* if the upper one lies below it, and is *open* in between. With no miss at all n independent frames
show an availability A only if A^n <= 5 %: 99 % takes 299. Each design's bound is its own: among many, one may pass by
chance.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from horizonval.core.json_types import JsonObject
from horizonval.spec.suite import Requirement
from horizonval.studies.trade.cost import is_tie
from horizonval.studies.trade.misses import words_of
from horizonval.studies.trade.sample import CONFIDENCE

Verdict = Literal["meets", "fails", "open"]


def verdict_of(within: Mapping[str, Any], availability: float) -> Verdict:
    """Return what a share of frames within the error says of a required availability."""
    if not within["of"]:
        return "open"
    if within["lower"] >= availability:
        return "meets"
    return "fails" if within["upper"] < availability else "open"


def frames_needed(availability: float) -> int:
    """Return how many independent frames without a miss show an availability."""
    return math.ceil(math.log(1.0 - CONFIDENCE) / math.log(availability) - 1e-9)


def cheapest(
    designs: Sequence[Mapping[str, Any]], requirement: Requirement, by: str, prices: Mapping[str, JsonObject]
) -> JsonObject:
    """Return the answer to "which is the cheapest design that meets the requirement?".

    Parameters
    ----------
    designs : sequence of mapping
        ``name``, ``within`` and ``misses`` (:func:`horizonval.studies.trade.misses.misses_of`) of each.
    requirement : Requirement
    by : str
        The expression that the prices are of.
    prices : mapping
        By name, as :func:`horizonval.studies.trade.cost.price_of`; designs without a price come last.

    Returns
    -------
    dict
        ``meets``, ``open``, ``fails``: names, cheapest first; ``cheapest``: the first that meets, or None, and
        ``tied``: all that meet at a cost that is not told apart from its; ``candidate``: the cheapest open one whose
        measured share reaches the availability, or None, and ``tied_candidates``; ``closest``: the one with the largest
        share, the first of ``tied_closest``; ``needed``: frames without a miss that would show it; ``misses``: by name;
        ``text``: the answer in words.
    """

    def place(design: Mapping[str, Any]) -> tuple[float, float, str]:
        value = prices[design["name"]]["value"]
        return (math.inf if value is None else value, -(design["within"]["rate"] or 0.0), design["name"])

    def tied_with_first(names: Sequence[str]) -> list[str]:
        return [name for name in names if is_tie(prices[names[0]], prices[name])]

    ordered = sorted(designs, key=place)
    by_verdict: dict[str, list[str]] = {"meets": [], "open": [], "fails": []}
    for design in ordered:
        by_verdict[verdict_of(design["within"], requirement.availability)].append(design["name"])
    by_name = {design["name"]: design for design in ordered}
    candidates = [
        name for name in by_verdict["open"] if (by_name[name]["within"]["rate"] or 0.0) >= requirement.availability
    ]
    best = max((design["within"]["rate"] or 0.0 for design in designs), default=0.0)
    closest = [design["name"] for design in designs if (design["within"]["rate"] or 0.0) == best]
    answer: JsonObject = {
        **by_verdict,
        "error_deg": requirement.error_deg,
        "availability": requirement.availability,
        "by": by,
        "cheapest": by_verdict["meets"][0] if by_verdict["meets"] else None,
        "tied": tied_with_first(by_verdict["meets"]),
        "candidate": candidates[0] if candidates else None,
        "tied_candidates": tied_with_first(candidates),
        "closest": closest[0] if closest else None,
        "tied_closest": closest,
        "needed": frames_needed(requirement.availability),
        "misses": {design["name"]: design["misses"] for design in designs},
    }
    return answer | {"text": _text(answer, by_name, prices)}


BY_WORDS = {"pixel_rate": "pixel rate", "processor_s": "processor time"}
MOST_NAMED = 6


def _text(answer: JsonObject, by_name: Mapping[str, Mapping[str, Any]], prices: Mapping[str, JsonObject]) -> str:
    requirement = f"{answer['error_deg']:g} deg in {100 * answer['availability']:g} % of all conditions"
    by = BY_WORDS.get(answer["by"], answer["by"])

    def share(name: str) -> str:
        within = by_name[name]["within"]
        return (
            f"{within['n']} of {within['of']} frames within {answer['error_deg']:g} deg, "
            f"95 % interval {100 * within['interval'][0]:.1f} to {100 * within['interval'][1]:.1f} %"
        )

    def named(names: Sequence[str]) -> str:
        if not names[1:]:
            return f"{names[0]} ({share(names[0])})"
        shares = [by_name[name]["within"] for name in names[:MOST_NAMED]]
        words = [f"{name} ({found['n']} of {found['of']})" for name, found in zip(names, shares, strict=False)]
        if len(names) > MOST_NAMED:
            words.append(f"{len(names) - MOST_NAMED} more")
        return f"{', '.join(words)}: {len(names)} designs {_tie([prices[name] for name in names])}"

    if not by_name:
        return "no design has a result"
    if answer["cheapest"] is not None:
        verb = "meet" if answer["tied"][1:] else "meets"
        parts = [f"cheapest by {by} that {verb} {requirement}: {named(answer['tied'])}"]
        if answer["candidate"] is not None and _is_cheaper(answer, prices):
            parts.append(f"cheaper ones may meet it, too few frames to say: {', '.join(answer['tied_candidates'])}")
        return "; ".join(parts)
    if answer["candidate"] is not None:
        worth = by_name[answer["candidate"]]["within"]["effective"]
        return (
            f"none is shown to meet {requirement}: the sample is too small to say. Cheapest by {by} that may: "
            f"{named(answer['tied_candidates'])}; {'its' if not answer['tied_candidates'][1:] else 'their'} sample is "
            f"worth {worth:.0f} independent frames, {answer['needed']} without a miss would show it"
        )
    closest = answer["closest"]
    others = answer["tied_closest"][1:]
    alike = f"; as close: {', '.join(others[:MOST_NAMED])}" if others else ""
    more = f" and {len(others) - MOST_NAMED} more" if len(others) > MOST_NAMED else ""
    missed = f"Closest: {closest} ({share(closest)}), missed by {words_of(by_name[closest]['misses'])}{alike}{more}"
    if answer["open"]:
        return (
            f"none is shown to meet {requirement}, and none reached it here; not excluded: {len(answer['open'])} of "
            f"{len(by_name)} designs. {missed}"
        )
    return f"none meets {requirement}. {missed}"


def _tie(prices: Sequence[JsonObject]) -> str:
    """Return why designs are tied: at one cost, or at costs that are not known well enough."""
    values = [price["value"] for price in prices]
    if None in values:
        return "without a cost"
    low, high = min(values), max(values)
    if math.isclose(low, high, rel_tol=1e-9) and all(price["interval"] is None and price["known"] for price in prices):
        return f"at the same cost, {low:.4g}"
    return f"whose costs, {low:.3g} to {high:.3g}, their uncertainty does not tell apart"


def _is_cheaper(answer: JsonObject, prices: Mapping[str, JsonObject]) -> bool:
    """Whether the candidate costs less than the cheapest that meets, and not only by chance."""
    candidate, meets = prices[answer["candidate"]], prices[answer["cheapest"]]
    if candidate["value"] is None or meets["value"] is None:
        return candidate["value"] is not None
    return bool(candidate["value"] < meets["value"] and not is_tie(candidate, meets))
