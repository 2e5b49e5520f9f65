"""Why frames were missed: for each design, how many by which outcome."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from horizonval.core.json_types import JsonObject
from horizonval.studies.trade.sample import Sample

FALSE, INACCURATE = "false claim", "too inaccurate"
"""Causes beside the outcomes of refusals: claims that are false, and other claims beyond the required error."""


def misses_of(sample: Sample, error_deg: float) -> JsonObject:
    """Return by cause, the most first, how many frames were missed (``n``), and how many of them were due (``due``)."""
    within = sample.within(error_deg)
    causes: Counter[str] = Counter()
    due: Counter[str] = Counter()
    for i, outcome in enumerate(sample.outcome):
        if within[i]:
            continue
        cause = (FALSE if sample.false[i] else INACCURATE) if sample.claimed[i] else outcome.replace("_", " ")
        causes[cause] += 1
        due[cause] += bool(sample.due[i])
    return {
        name: {"n": n, "due": due[name]} for name, n in sorted(causes.items(), key=lambda item: (-item[1], item[0]))
    }


def words_of(misses: Mapping[str, JsonObject]) -> str:
    """Return the misses of a design as ``8 dark, 1 too inaccurate``."""
    return ", ".join(f"{found['n']} {cause}" for cause, found in misses.items())


def causes_of(misses: Iterable[Mapping[str, JsonObject]]) -> list[str]:
    """Return the causes of several designs, the most frequent first."""
    total: Counter[str] = Counter()
    for found in misses:
        total.update({cause: count["n"] for cause, count in found.items()})
    return [cause for cause, _ in sorted(total.items(), key=lambda item: (-item[1], item[0]))]
