"""Earlier nights, one line each, and the steps of their figures.

Steps are the boundaries between the pieces of the best piecewise constant fit. The Potts functional

    sum over pieces of sum |y - median of the piece|  +  gamma * (number of pieces - 1)

is minimised exactly by dynamic programming (F. Friedrich et al., J. Comput. Graph. Statist. 17, 201, 2008). With
medians a single bad night is not a step. The number of pieces minimises the Bayesian information criterion under
Laplace noise, ``2 n ln(cost / n) + k ln n``, with k = 3 for each further piece: level, position, and one more for the
search of the position.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from horizonval.core import atomic, files
from horizonval.core.json_types import JsonObject

FILE = "history.jsonl"
NIGHTS = 60
"""Nights on the page and in the search for steps: a release cycle."""
MAX_FILE_BYTES = 1024**3
"""Maximum size of a history; a night is a line of some 50 kB."""
FEWEST = 4
"""Minimum length of a piece [nights]: shorter steps cannot be distinguished from noise."""
PARAMETERS_PER_PIECE = 3


def append(path: Path, verdict: Mapping[str, Any]) -> None:
    """Add a night; a repeated one replaces that of the same label."""
    line = {
        "night": verdict["night"],
        "version": verdict["environment"]["version"],
        "commit": verdict["environment"]["commit"],
        "verdict": verdict["verdict"],
        "complete": verdict["complete"],
        "levels": verdict["levels"],
    }
    lines = [one for one in read(path, most=None) if one["night"] != line["night"]] + [line]
    text = "".join(json.dumps(one, sort_keys=True, allow_nan=False) + "\n" for one in lines)
    atomic.write_text(path, text)


def read(path: Path, most: int | None = NIGHTS) -> list[JsonObject]:
    """Read the last nights in the order of their labels, ignoring invalid lines (a torn write)."""
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
        if _is_night(line):
            found.append(line)
    found.sort(key=lambda line: line["night"])
    return found if most is None else found[-most:]


def _is_night(line: object) -> bool:
    """Whether a line is one that :func:`append` writes."""
    if not isinstance(line, dict) or not all(isinstance(line.get(key), str) for key in ("night", "verdict")):
        return False
    levels = line.get("levels")
    return isinstance(levels, dict) and all(
        isinstance(one, dict)
        and isinstance(one.get("value"), int | float)
        and math.isfinite(one["value"])
        and isinstance(one.get("unit"), str)
        and isinstance(one.get("n"), int)
        for one in levels.values()
    )


def series(nights: Sequence[Mapping[str, Any]]) -> dict[str, JsonObject]:
    """Return ``{unit, nights, values, n}`` by figure; nights without it are left out."""
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


@dataclass(frozen=True)
class Piece:
    """Values ``start`` to ``stop`` (excluded) around one level."""

    start: int
    stop: int
    level: float


def pieces(values: Sequence[float], fewest: int = FEWEST) -> list[Piece]:
    """Return the pieces of a series of finite values in order, each of at least ``fewest`` values."""
    y = np.asarray(values, dtype=np.float64)
    n = len(y)
    if n == 0:
        return []
    most = max(1, n // fewest)
    cost = _costs(y, fewest)
    best = np.full((most + 1, n + 1), np.inf)
    first = np.zeros((most + 1, n + 1), dtype=int)
    best[0, 0] = 0.0
    for k in range(1, most + 1):
        for end in range(1, n + 1):
            totals = best[k - 1, :end] + cost[:end, end]
            first[k, end] = int(np.argmin(totals))
            best[k, end] = totals[first[k, end]]
    # Rounding of stored values sets a floor under the noise: a constant series has no steps.
    floor = n * max(float(np.abs(y).max()), 1e-300) * 1e-9
    criterion = [
        2 * n * math.log(max(best[k, n], floor) / n) + PARAMETERS_PER_PIECE * k * math.log(n)
        if math.isfinite(best[k, n])
        else math.inf
        for k in range(1, most + 1)
    ]
    count = 1 + int(np.argmin(criterion)) if any(map(math.isfinite, criterion)) else 0
    if count == 0:
        return [Piece(0, n, float(np.median(y)))]
    found, end = [], n
    for k in range(count, 0, -1):
        start = int(first[k, end])
        found.append(Piece(start, end, float(np.median(y[start:end]))))
        end = start
    return found[::-1]


def _costs(y: np.ndarray, fewest: int) -> np.ndarray:
    """Return the absolute deviation from the median of every stretch [start, end) that is long enough, else inf."""
    n = len(y)
    cost = np.full((n + 1, n + 1), np.inf)
    for start in range(n):
        for end in range(start + min(fewest, n), n + 1):
            part = y[start:end]
            cost[start, end] = np.abs(part - np.median(part)).sum()
    return cost
