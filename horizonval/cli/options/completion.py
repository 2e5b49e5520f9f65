"""What a shell offers after <Tab>: the names that a command takes, with what they stand for, and files.

Nothing heavy is loaded for it: a key press must not take a second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from horizonval.spec.files import Kind

Offer = Callable[[str], list[tuple[str, str]]]
"""What is offered for the beginning of a word: words, each with a description."""


def shipped(*kinds: Kind) -> Offer:
    """Return what offers the shipped files of some kinds, and TOML files and folders."""

    def offer(incomplete: str) -> list[tuple[str, str]]:
        from horizonval.commands.listing import first_sentence
        from horizonval.spec.files import head_comment, shipped_names, shipped_path

        names = [
            (name, first_sentence(head_comment(shipped_path(kind, name))))
            for kind in kinds
            for name in shipped_names(kind)
            if name.startswith(incomplete)
        ]
        return names + [(path, "") for path in _paths(incomplete, ".toml")]

    return offer


def files(suffix: str) -> Offer:
    """Return what offers files of an ending and folders."""
    return lambda incomplete: [(path, "") for path in _paths(incomplete, suffix)]


def estimators(incomplete: str) -> list[tuple[str, str]]:
    """Offer the installed estimators."""
    from importlib.metadata import entry_points

    names = {point.name for point in entry_points(group="horizonval.estimators")}
    return [(name, "") for name in sorted(names) if name.startswith(incomplete)]


def lists(incomplete: str) -> list[tuple[str, str]]:
    """Offer what there are lists of."""
    from horizonval.commands.listing import LISTS

    return [(name, "") for name in LISTS if name.startswith(incomplete)]


def systems(incomplete: str) -> list[tuple[str, str]]:
    """Offer the letters of the published systems."""
    return [
        (name, "") for name in ("A", "B", "C", "D", "E", "F", "G", "all") if name.lower().startswith(incomplete.lower())
    ]


def kinds_of_files(incomplete: str) -> list[tuple[str, str]]:
    """Offer the kinds of files that have a schema."""
    return [(name, "") for name in ("scene", "camera", "suite", "study", "prior") if name.startswith(incomplete)]


def _paths(incomplete: str, suffix: str) -> Iterator[str]:
    """Yield files of an ending and folders that a path begins; hidden ones only if they are asked for."""
    folder, _, begin = incomplete.rpartition("/")
    try:
        entries = sorted(Path(f"{folder}/" if folder or incomplete.startswith("/") else ".").iterdir())
    except OSError:
        return
    for entry in entries:
        if entry.name.startswith(begin) and entry.name.startswith(".") <= begin.startswith("."):
            name = incomplete[: len(incomplete) - len(begin)] + entry.name
            if entry.is_dir():
                yield f"{name}/"
            elif entry.suffix == suffix:
                yield name
