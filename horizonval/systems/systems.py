"""The published systems by their letter, and the module that does each one's experiment again."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from horizonval.core.errors import UserError
from horizonval.systems.result import Reproduction
from horizonval.systems.workshop import Workshop

SYSTEMS = {
    "A": "altitude_free",
    "B": "video_vertical",
    "C": "ideal_module",
    "D": "linear_heads",
    "E": "localisation",
}


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


def experiment(letter: str) -> Callable[[Workshop], Reproduction]:
    """Return the function that does a system's experiment again."""
    function: Callable[[Workshop], Reproduction] = import_module(f"horizonval.reproduce.{SYSTEMS[letter]}").reproduce
    return function
