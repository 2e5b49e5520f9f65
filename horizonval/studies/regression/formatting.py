"""Gates, anchors and published figures in sentences, with units and counts: for the terminal, JUnit and the page."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def figure(value: float | None, digits: int = 3) -> str:
    """Return a number with so many digits; an en dash for none."""
    if value is None:
        return "–"
    return f"{value:.{digits}g}" if abs(value) < 999.5 else f"{value:.0f}"


def gate_sentence(gate: Mapping[str, Any]) -> str:
    """Return what a gate found and what it allows."""
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
    """Return the scenes that weigh most, and how many more there are."""
    more = gate["n_scenes"] - len(gate["scenes"])
    return ", ".join(gate["scenes"]) + (f" and {more} more" if more > 0 else "")


def published_sentence(one: Mapping[str, Any]) -> str:
    """Return a key figure of a published system, tonight and accepted."""
    if one["accepted"] is None:
        return f"{figure(one['measured'], 6)} {one['unit']}; its page has no such figure"
    return f"{figure(one['measured'], 6)} {one['unit']}, accepted {figure(one['accepted'], 6)}"


def anchor_sentence(anchor: Mapping[str, Any]) -> str:
    """Return what an anchor found and its limit."""
    if anchor["found"] is None:
        return str(anchor["what"])
    return (
        f"{anchor['what']}: largest {figure(anchor['found'])}, limit {figure(anchor['limit'])} "
        f"{anchor['unit']}, n = {anchor['n']}"
    )
