"""From a ``[[cases]]`` table to named partial scenes: lists, grids, Sobol points.

Names follow from what is varied, so that a case keeps its name when its neighbours change: the table's name, then
every axis' last key with its value (``sweep_yaw_deg_-10_pitch_deg_5``), then the number of a Sobol point or an orbit's
sample.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from horizonval.core.errors import UserError
from horizonval.core.files import LONGEST_GENERATED_NAME, shortened
from horizonval.core.json_types import JsonObject
from horizonval.spec.base import deep_merge
from horizonval.spec.explain import show
from horizonval.spec.suite import CasesSpec

MOST_CASES = 1_000_000
_RANGE_KEYS = {"from", "to", "step", "n", "scale"}
_SCALES = ("linear", "log", "sine")


@dataclass(frozen=True)
class Variant:
    """One partial scene of a table, and the orbit (plain data) that makes several of it.

    ``item`` and ``number`` (from 1) are name and position in the table's list, ``""`` and None without. ``parts`` are
    the axes with their values, then the number of a Sobol point.
    """

    table: str
    item: str
    number: int | None
    parts: tuple[str, ...]
    scene: JsonObject
    orbit: JsonObject | None

    @property
    def label(self) -> str:
        """What tells the scene from the others of its table; empty where it is the only one."""
        item = self.item or ("" if self.number is None else f"{self.number:03d}")
        return "_".join([*filter(None, [item]), *self.parts])

    @property
    def name(self) -> str:
        """The table's name, then the label; of many axes or long values their beginning and a digest."""
        return shortened("_".join(filter(None, [self.table, self.label])), LONGEST_GENERATED_NAME)


def variants(table: CasesSpec, seed: int, where: str, frames: int | None = None) -> Iterator[Variant]:
    """Yield what a table makes, orbits not yet flown; UserError at ``where`` for a wrong axis or too many cases.

    ``seed`` is the suite's; ``frames`` is the number of scenes of which a table with a ``share`` makes its part.
    """
    bases = _listed(table, where)
    axes = [(key, _axis(value, f"{where}.grid.{key}")) for key, value in _leaves(table.grid or {})]
    others = len(bases) * math.prod(len(values) for _, values in axes) * _samples(table)
    points = _sobol(table, seed, where, others, frames)
    total = len(bases) * math.prod(len(values) for _, values in axes) * len(points)
    if total > MOST_CASES:
        raise UserError(f"{total} cases", where=where, expected=f"at most {MOST_CASES}")
    keys = [key for key, _ in axes]
    labels = _labels(keys)
    orbit = None if table.orbit is None else {"orbit": table.orbit}
    for (item, number, base), values, (suffix, point) in itertools.product(
        bases, itertools.product(*(values for _, values in axes)), points
    ):
        scene: JsonObject = base | (orbit or {})
        for key, value in [*zip(keys, values, strict=True), *point]:
            scene = _with(scene, key.split("."), value, f"{where}: {key}")
        parts = (*(f"{label}_{_word(value)}" for label, value in zip(labels, values, strict=True)), *suffix)
        flown = scene.pop("orbit", None) if orbit is not None else None
        yield Variant(table.name, item, number, parts, scene, flown)


def seed_of(*parts: object) -> int:
    """Return a seed that is a hash of its parts."""
    return int.from_bytes(hashlib.sha256(json.dumps(parts).encode()).digest()[:16], "big")


def _listed(table: CasesSpec, where: str) -> list[tuple[str, int | None, JsonObject]]:
    """Return the name, place and partial scene of each of the list's, or of the table's only one."""
    if table.list is None:
        return [("", None, dict(table.base))]
    found: list[tuple[str, int | None, JsonObject]] = []
    for i, scene in enumerate(table.list, start=1):
        head = scene.get("scene", {})
        name = head.get("name") if isinstance(head, Mapping) else None
        if name is not None and not isinstance(name, str):
            raise UserError(f"found {show(name)}", where=f"{where}.list[{i}].scene.name", expected="text in quotes")
        found.append((name or "", i, deep_merge(table.base, scene)))
    return found


def _leaves(tree: Mapping[str, Any], path: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield dotted keys and axes; a table that is no range holds further keys."""
    for key, value in tree.items():
        if isinstance(value, Mapping) and not ("from" in value or "to" in value):
            yield from _leaves(value, (*path, key))
        else:
            yield ".".join((*path, key)), value


def _axis(value: Any, where: str) -> list[Any]:
    expected = "a list of values, or a table {from, to, step} or {from, to, n}"
    if isinstance(value, list):
        if not value:
            raise UserError("found an empty list", where=where, expected=expected)
        return value
    if not isinstance(value, Mapping):
        raise UserError(f"found {show(value)}", where=where, expected=expected)
    first, last, scale = _ends(value, where, expected)
    if ("step" in value) == ("n" in value):
        raise UserError("give one of step and n", where=where, expected=expected)
    if "n" in value:
        n = value["n"]
        if not isinstance(n, int) or isinstance(n, bool) or not 1 <= n <= MOST_CASES:
            raise UserError(f"found {show(n)}", where=f"{where}.n", expected="a whole number from 1 up")
        return _spread(first, last, scale, np.arange(n) / max(n - 1, 1))
    step = value["step"]
    if not _is_number(step) or not _is_number(first) or step == 0 or (last - first) / step < 0 or scale != "linear":
        raise UserError(
            f"found step = {show(step)}", where=where, expected="a number that leads from `from` to `to`, linear"
        )
    count = math.floor((last - first) / step + 1e-9) + 1
    if count > MOST_CASES:
        raise UserError(f"{count} values", where=where, expected=f"at most {MOST_CASES}")
    whole = all(isinstance(v, int) for v in (first, last, step))
    # Twelve digits bring back the round number that the sum of a step like 0.1 misses.
    return [first + i * step if whole else float(f"{first + i * step:.12g}") for i in range(count)]


def _ends(value: Mapping[str, Any], where: str, expected: str) -> tuple[Any, Any, str]:
    if unknown := sorted(set(value) - _RANGE_KEYS):
        raise UserError(f"unknown key {unknown[0]!r}", where=where, expected=expected)
    scale = value.get("scale", "linear")
    if scale not in _SCALES:
        raise UserError(f"found {show(scale)}", where=f"{where}.scale", expected=" or ".join(map(show, _SCALES)))
    first: Any = value.get("from")
    last: Any = value.get("to")
    found = f"found from = {show(first)}, to = {show(last)}"
    times = isinstance(first, datetime) and isinstance(last, datetime) and scale == "linear"
    numbers = _is_number(first) and _is_number(last)
    if not (times or numbers):
        raise UserError(found, where=where, expected="two numbers or two dates")
    if numbers and scale == "log" and min(first, last) <= 0:
        raise UserError(found, where=where, expected="numbers above 0 for log")
    return first, last, scale


def _spread(first: Any, last: Any, scale: str, share: NDArray[np.float64]) -> list[Any]:
    """Return values between two ends, at shares from 0 to 1; numbers to twelve digits."""
    if isinstance(first, datetime):
        return [first + (last - first) * float(s) for s in share]
    match scale:
        case "log":
            values = first * (last / first) ** share
        case "sine":
            lo, hi = (math.sin(math.radians(v)) for v in (first, last))
            values = np.degrees(np.arcsin(np.clip(lo + (hi - lo) * share, -1.0, 1.0)))
        case _:
            values = first + (last - first) * share
    return [float(f"{v:.12g}") for v in values]


def _samples(table: CasesSpec) -> int:
    """Return how many scenes the table's orbit makes of each of the others."""
    n = 1 if table.orbit is None else table.orbit.get("n")
    # A count that is none is found with the rest of the orbit.
    return n if isinstance(n, int) and n > 0 else 1


def _sobol(
    table: CasesSpec, seed: int, where: str, others: int, frames: int | None
) -> Sequence[tuple[list[str], list[tuple[str, Any]]]]:
    """Return points as (parts of the name, keys with values); a single empty one without a sequence.

    A share of ``frames`` counts scenes, of which each point makes ``others``; one point at least.
    """
    if table.sobol is None:
        return [([], [])]
    from scipy.stats import qmc

    n, ranges = table.sobol.n or max(1, round((table.sobol.share or 0.0) * (frames or 0) / others)), []
    for key, value in _leaves(table.sobol.ranges):
        place = f"{where}.sobol.ranges.{key}"
        ends = value
        if isinstance(value, list) and len(value) == 2:
            ends = {"from": value[0], "to": value[1]}
        if not isinstance(ends, Mapping):
            raise UserError(f"found {show(value)}", where=place, expected="[from, to] or {from, to, scale}")
        ranges.append((key, *_ends(ends, place, "[from, to] or {from, to, scale}")))
    random = np.random.default_rng(np.random.SeedSequence(seed_of("sobol", seed, table.name, table.sobol.seed)))
    with warnings.catch_warnings():
        # A number of points that is no power of two costs balance, which the user may want to pay.
        warnings.simplefilter("ignore", UserWarning)
        shares = qmc.Sobol(len(ranges), scramble=True, rng=random).random(n)
    columns = [_spread(first, last, scale, shares[:, i]) for i, (_, first, last, scale) in enumerate(ranges)]
    digits = max(3, len(str(n - 1)))
    keys = [key for key, *_ in ranges]
    return [
        ([f"{i:0{digits}d}"], list(zip(keys, values, strict=True)))
        for i, values in enumerate(zip(*columns, strict=True))
    ]


def _with(tree: JsonObject, path: Sequence[str], value: Any, where: str) -> JsonObject:
    """Return a tree with one value changed; nothing of the old one is touched."""
    head, rest = path[0], path[1:]
    if not rest:
        return tree | {head: value}
    below = tree.get(head, {})
    if not isinstance(below, Mapping):
        raise UserError(f"{head} holds {show(below)} in `base`", where=where, expected="a table")
    return tree | {head: _with(dict(below), rest, value, where)}


def _labels(keys: Sequence[str]) -> list[str]:
    """Return the last part of each key, or all of it where two would be alike."""
    short = [key.rsplit(".", 1)[-1] for key in keys]
    return [s if short.count(s) == 1 else key for s, key in zip(short, keys, strict=True)]


def _word(value: Any) -> str:
    """Return a value as a part of a name."""
    match value:
        case bool():
            text = str(value).lower()
        case int() | float():
            text = f"{value:.12g}".replace("+", "")
        case datetime():
            text = value.strftime("%Y%m%dT%H%M%S")
        case str():
            text = value
        case _:
            text = hashlib.sha256(json.dumps(value, default=str, sort_keys=True).encode()).hexdigest()[:8]
    return re.sub(r"[^A-Za-z0-9.-]+", "-", text)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
