"""Key figures of the published systems: the function ``quick`` of each experiment, compared with the committed figures.

A whole reproduction takes long, most of it for rendering; this takes about a minute. Nothing in it is random but for
fixed seeds. A figure is the committed one of ``quick.json``, or something has changed: the only allowance is for the
last digits of floating point, which depend on the machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.store.folder import read_json, write_json
from horizonval.systems.entries import Row, system
from horizonval.systems.result import ComparisonRow
from horizonval.systems.task_cache import TaskCache

SYSTEMS = ("A", "B", "C", "D", "E", "F", "G")
"""Letters of the published systems; each has a package of its name here."""


def chosen(names: list[str]) -> list[str]:
    """Return the requested letters in order, all for none or ``all``; ``UserError`` for anything else."""
    wanted = {name.upper() for name in names or ["all"]}
    if unknown := sorted(wanted - {*SYSTEMS, "ALL"}):
        raise UserError(f"no published system {unknown[0]!r}", expected=f"some of {', '.join(SYSTEMS)}, or all")
    return [letter for letter in SYSTEMS if letter in wanted or "ALL" in wanted]


def experiment(letter: str) -> ModuleType:
    """Return the module of a system's experiment, with its functions ``reproduce`` and ``quick``."""
    return import_module(f"{__package__}.{letter.lower()}.experiment")


FILE = "quick.json"
SAME_SHARE = 1e-6
"""Relative difference below which figures are the same: float32 images and processors' sines differ by less."""
ROUND_OFF = 1e-10
"""The same in the figure's own unit: errors of exact formulas are round-off."""
PLACES = 4
"""Places of F and G."""
G_ALTITUDES_KM = (350.0, 402.5)


def quick_figures(cache: TaskCache, pages: Path, systems: Sequence[str] = SYSTEMS) -> list[JsonObject]:
    """Return the systems' key figures with the committed ones and a verdict, as plain data.

    ``cache``: with the seed of the committed figures; ``pages``: folder of ``quick.json``. Result: ``system``,
    ``name``, ``unit``, ``measured``, ``accepted`` (None without a committed figure), ``verdict`` (PASS or FAIL). Raises
    ``UserError``: there are no committed figures.
    """
    content = read_json(pages / FILE, bound=False)
    if content is None:
        raise UserError("no such file", where=str(pages / FILE), fix="take it from version control again")
    accepted = {(row["system"], row["name"]): row["measured"] for row in content["rows"]}
    found = []
    for row in measured_rows(cache, systems):
        known = accepted.get((row["system"], row["name"]))
        found.append(row | {"accepted": known, "verdict": "PASS" if is_same(row["measured"], known) else "FAIL"})
    return found


def measured_rows(cache: TaskCache, systems: Sequence[str] = SYSTEMS) -> list[JsonObject]:
    """Return the key figures as plain data, without the committed ones."""
    return [
        {"system": letter, "name": row.name, "unit": row.unit, "measured": float(row.measured)}
        for letter in systems
        for row in quick_rows(letter, cache)
        if row.measured is not None
    ]


def quick_rows(letter: str, cache: TaskCache) -> Iterable[Row | ComparisonRow]:
    """Return the rows of a system's key figures."""
    if letter in ROWS:
        return ROWS[letter](cache)
    return system(letter).rows(experiment(letter).quick(cache))


def write_quick(letter: str, cache: TaskCache, pages: Path) -> None:
    """Write the key figures of one system among the others, to be committed."""
    rows = [row for row in (read_json(pages / FILE, bound=False) or {"rows": []})["rows"] if row["system"] != letter]
    rows = sorted([*rows, *measured_rows(cache, [letter])], key=lambda row: str(row["system"]))
    write_json(pages / FILE, {"schema": 1, "seed": cache.seed, "rows": rows}, bound=False)


def is_same(measured: float, accepted: float | None) -> bool:
    """Whether nothing has changed but for the last digits."""
    return accepted is not None and abs(measured - accepted) <= max(ROUND_OFF, SAME_SHARE * abs(accepted))


def _set_ups(cache: TaskCache) -> Sequence[ComparisonRow]:
    from horizonval.systems.a.bank import measure, set_ups
    from horizonval.systems.a.rows import set_up_rows

    return set_up_rows(cache.each("A: set-ups", measure, set_ups(cache.seed)))


def _perfect_bench(cache: TaskCache) -> Sequence[ComparisonRow]:
    from horizonval.systems.b.rig.experiment import perfect_row
    from horizonval.systems.b.rig.frames import make_picture

    return [perfect_row(cache, cache.each("panel's picture", make_picture, {"picture": {}})["picture"]["png"])]


def _poses(cache: TaskCache) -> Sequence[ComparisonRow]:
    from horizonval.systems.c.experiment import measured_pose_rows

    return measured_pose_rows(cache)


def _rounding(cache: TaskCache) -> Sequence[ComparisonRow]:
    from horizonval.systems.e.experiment import rounding_rows

    return rounding_rows(cache)


def _scans(cache: TaskCache) -> Sequence[ComparisonRow]:
    from horizonval.systems.f import experiment as f

    places = f.weather_places(PLACES, f.INCLINATION_DEG, cache.seed)
    return f.rows_of_scans(cache.each("F: scans", f.scan, f.scan_items(places)), places)


def _limbs(cache: TaskCache) -> Sequence[ComparisonRow]:
    from horizonval.systems.g import experiment as g

    places = g.weather_places(PLACES, g.INCLINATION_DEG, cache.seed)
    made = cache.each("G: limbs", g.limb_profiles, g.limb_items(places, G_ALTITUDES_KM))
    return g.rows_of_limbs(np.array([one["radiance"] for one in made.values()]), G_ALTITUDES_KM, places)


ROWS: dict[str, Callable[[TaskCache], Sequence[ComparisonRow]]] = dict(
    zip("ABCEFG", (_set_ups, _perfect_bench, _poses, _rounding, _scans, _limbs), strict=True)
)
"""Functions that compute key figures of systems whose experiment has no function ``quick``, by letter."""
