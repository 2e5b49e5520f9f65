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
from horizonval.spec.study import Price, Requirement
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
    designs: Sequence[Mapping[str, Any]], requirement: Requirement, by: Price, prices: Mapping[str, float | None]
) -> JsonObject:
    """Return the answer to "which is the cheapest design that meets the requirement?".

    Parameters
    ----------
    designs : sequence of mapping
        ``name`` and ``within`` of each.
    requirement : Requirement
    by : {"pixel_rate", "processor"}
    prices : mapping
        By name; designs without a price come last.

    Returns
    -------
    dict
        ``meets``, ``open``, ``fails``: names, cheapest first; ``cheapest``: the first that meets, or None;
        ``candidate``: the cheapest open one whose measured share reaches the availability, or None; ``closest``: the
        one with the largest share; ``needed``: frames without a miss that would show it; ``text``: the answer in words.
    """

    def price(design: Mapping[str, Any]) -> tuple[float, float, str]:
        cost = prices.get(design["name"])
        return (math.inf if cost is None else cost, -(design["within"]["rate"] or 0.0), design["name"])

    ordered = sorted(designs, key=price)
    by_verdict: dict[str, list[str]] = {"meets": [], "open": [], "fails": []}
    for design in ordered:
        by_verdict[verdict_of(design["within"], requirement.availability)].append(design["name"])
    by_name = {design["name"]: design for design in ordered}
    candidates = [
        name for name in by_verdict["open"] if (by_name[name]["within"]["rate"] or 0.0) >= requirement.availability
    ]
    closest = max(ordered, key=lambda d: d["within"]["rate"] or 0.0)["name"] if ordered else None
    answer: JsonObject = {
        **by_verdict,
        "error_deg": requirement.error_deg,
        "availability": requirement.availability,
        "by": by,
        "cheapest": by_verdict["meets"][0] if by_verdict["meets"] else None,
        "candidate": candidates[0] if candidates else None,
        "closest": closest,
        "needed": frames_needed(requirement.availability),
    }
    return answer | {"text": _text(answer, by_name)}


def _text(answer: JsonObject, by_name: Mapping[str, Mapping[str, Any]]) -> str:
    requirement = f"{answer['error_deg']:g} deg in {100 * answer['availability']:g} % of all conditions"
    by = {"pixel_rate": "pixel rate", "processor": "processor time"}[answer["by"]]

    def share(name: str) -> str:
        within = by_name[name]["within"]
        return (
            f"{within['n']} of {within['of']} frames within {answer['error_deg']:g} deg, "
            f"95 % interval {100 * within['interval'][0]:.1f} to {100 * within['interval'][1]:.1f} %"
        )

    if not by_name:
        return "no design has a result"
    if answer["cheapest"] is not None:
        parts = [f"cheapest by {by} that meets {requirement}: {answer['cheapest']} ({share(answer['cheapest'])})"]
        if answer["candidate"] is not None and _first(answer, by_name):
            parts.append(f"cheaper ones may meet it, too few frames to say: {answer['candidate']}")
        return "; ".join(parts)
    if answer["candidate"] is not None:
        worth = by_name[answer["candidate"]]["within"]["effective"]
        return (
            f"none is shown to meet {requirement}: the sample is too small to say. Cheapest by {by} that may: "
            f"{answer['candidate']} ({share(answer['candidate'])}); it is worth {worth:.0f} independent frames, "
            f"{answer['needed']} without a miss would show it"
        )
    closest = answer["closest"]
    if answer["open"]:
        return (
            f"none is shown to meet {requirement}, and none reached it here; not excluded: {len(answer['open'])} of "
            f"{len(by_name)} designs. Closest: {closest} ({share(closest)})"
        )
    return f"none meets {requirement}. Closest: {closest} ({share(closest)})"


def _first(answer: JsonObject, by_name: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether the candidate stands before the cheapest that meets; names keep the order of prices."""
    order = list(by_name)
    return order.index(answer["candidate"]) < order.index(answer["cheapest"])
