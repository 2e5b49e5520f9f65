"""The published systems by their letter, and the module that does each one's experiment again."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from horizonval.core.errors import UserError
from horizonval.systems.result import Reproduction
from horizonval.systems.task_cache import TaskCache

SYSTEMS = ("A", "B", "C", "D", "E", "F", "G")
"""Letters of the published systems; each has a package of its name here."""


def chosen(names: list[str]) -> list[str]:
    """Return the letters that the user asked for, in order; none, or ``all``, are all of them.

    Raises
    ------
    UserError
        For anything that is no letter of a system.
    """
    wanted = {name.upper() for name in names or ["all"]}
    if unknown := sorted(wanted - {*SYSTEMS, "ALL"}):
        raise UserError(f"no published system {unknown[0]!r}", expected=f"some of {', '.join(SYSTEMS)}, or all")
    return [letter for letter in SYSTEMS if letter in wanted or "ALL" in wanted]


def experiment(letter: str) -> Callable[[TaskCache], Reproduction]:
    """Return the function that does a system's experiment again."""
    function: Callable[[TaskCache], Reproduction] = import_module(
        f"{__package__}.{letter.lower()}.experiment"
    ).reproduce
    return function
