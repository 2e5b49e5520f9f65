"""The nights before: one line each, and where their figures step."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from horizonval.core import atomic, files
from horizonval.core.json_types import JsonObject
from horizonval.studies.regression.statistics.steps import pieces

FILE = "history.jsonl"
NIGHTS = 60
"""Shown and searched for steps: a release cycle."""
MAX_FILE_BYTES = 1024**3
"""Of a history; a night is a line of some 50 kB."""


def append(path: Path, verdict: Mapping[str, Any]) -> None:
    """Add a night; one of the same label is replaced, because it was done again."""
    line = {
        "night": verdict["night"],
        "version": verdict["environment"]["version"],
        "commit": verdict["environment"]["commit"],
        "verdict": verdict["verdict"],
        "complete": verdict["complete"],
        "gates": {
            g["name"]: {"verdict": g["verdict"], "unit": g["unit"], "margin": g["margin"], **(g["estimate"] or {})}
            for g in verdict["gates"]
            if g["against"] == "accepted"
        },
        "levels": verdict["levels"],
    }
    lines = [one for one in read(path, most=None) if one["night"] != line["night"]] + [line]
    text = "".join(json.dumps(one, sort_keys=True, allow_nan=False) + "\n" for one in lines)
    atomic.write_text(path, text)


def read(path: Path, most: int | None = NIGHTS) -> list[JsonObject]:
    """Return the last nights in the order of their labels; a line that is none (a torn write) is left out."""
    try:
        data = files.read_bytes(path, largest=MAX_FILE_BYTES, expected="a history of nights")
    except files.MissingFileError:
        return []
    found = []
    for text in data.decode("utf-8", "replace").splitlines():
        try:
            line = json.loads(text)
        except (ValueError, RecursionError):
            continue
        if isinstance(line, dict) and isinstance(line.get("night"), str) and "levels" in line:
            found.append(line)
    found.sort(key=lambda line: line["night"])
    return found if most is None else found[-most:]


def series(nights: Sequence[Mapping[str, Any]]) -> dict[str, JsonObject]:
    """Return every figure's values by its name: ``{unit, nights, values, n}``; nights without it are left out."""
    found: dict[str, JsonObject] = {}
    for line in nights:
        for name, level in line["levels"].items():
            one = found.setdefault(name, {"unit": level["unit"], "nights": [], "values": [], "n": []})
            one["nights"].append(line["night"])
            one["values"].append(level["value"])
            one["n"].append(level["n"])
    return found


def steps_of(nights: Sequence[Mapping[str, Any]]) -> list[JsonObject]:
    """Return every step: ``{figure, unit, night, before, after}``, ``night`` the first of the new level."""
    found = []
    for name, one in series(nights).items():
        parts = pieces(one["values"])
        for old, new in pairwise(parts):
            found.append(
                {
                    "figure": name,
                    "unit": one["unit"],
                    "night": one["nights"][new.start],
                    "before": old.level,
                    "after": new.level,
                }
            )
    return sorted(found, key=lambda step: (step["night"], step["figure"]))
