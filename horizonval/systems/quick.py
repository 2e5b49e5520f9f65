"""Key figures of the published systems: the function ``quick`` of each experiment, compared with the committed figures.

A whole reproduction takes long, most of it for rendering; this takes about a minute. Nothing in it is random but for
fixed seeds. A figure is the committed one of ``quick.json``, or something has changed: the only allowance is for the
last digits of floating point, which depend on the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType

from horizonval.core.errors import UserError
from horizonval.core.json_types import JsonObject
from horizonval.store.folder import read_json, write_json
from horizonval.systems.entries import system
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
        for row in system(letter).rows(experiment(letter).quick(cache))
        if row.measured is not None
    ]


def write_quick(letter: str, cache: TaskCache, pages: Path) -> None:
    """Write the key figures of one system among the others, to be committed."""
    rows = [row for row in (read_json(pages / FILE, bound=False) or {"rows": []})["rows"] if row["system"] != letter]
    rows = sorted([*rows, *measured_rows(cache, [letter])], key=lambda row: str(row["system"]))
    write_json(pages / FILE, {"schema": 1, "seed": cache.seed, "rows": rows}, bound=False)


def is_same(measured: float, accepted: float | None) -> bool:
    """Whether nothing has changed but for the last digits."""
    return accepted is not None and abs(measured - accepted) <= max(ROUND_OFF, SAME_SHARE * abs(accepted))
