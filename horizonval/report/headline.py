"""What an estimator does with a camera, in a sentence: on the report's first page and in the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from horizonval.report.angle_unit import AngleUnit
from horizonval.report.formatting import count, interval, percent

_MOST_PLACES = 3


def headline(group: Mapping[str, Any], unit: AngleUnit) -> str:
    """Return how often an estimator works with a camera, where it does not, and how far off it is at most.

    ``group`` is one of the summary's.
    """
    line = group["headline"]
    orbit, due = line["orbit"], line["due"]
    parts = []
    if orbit["of"]:
        parts.append(f"works {percent(orbit['rate'])} of the orbit ({orbit['n']} of {count(orbit['of'], 'frame')})")
    elif due["of"]:
        parts.append(
            f"works in {percent(due['rate'])} of the frames due an answer ({due['n']} of {due['of']}; "
            f"{interval(due['interval'], as_percent=True)} with 95 %)"
        )
    else:
        parts.append(f"none of {count(group['n'], 'frame')} is due an answer")
    for key, words in (("crashed", "crashes"), ("false", "false"), ("silent", "no answer")):
        if line[key]:
            parts.append(f"{words} {_places(line[key])}")
    if group["claims_without_sigma"]:
        parts.append(f"{count(group['claims_without_sigma'], 'claim')} without uncertainty")
    if line["n"]:
        parts.append(f"worst {unit.text(line['worst_arcsec'])} (n = {line['n']})")
    return "; ".join(parts) + "."


def _places(found: Sequence[tuple[str, int, int]]) -> str:
    words = [f"{condition} ({n} of {of})" for condition, n, of in found[:_MOST_PLACES]]
    if rest := sum(n for _, n, _ in found[_MOST_PLACES:]):
        words.append(f"elsewhere ({rest})")
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
