"""What a mistyped name may have meant."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher


def nearest(name: str, names: Iterable[str]) -> list[str]:
    """Return all of ``names``, the most similar to ``name`` first (capitals do not count); ties in given order."""
    name_lower = name.lower()
    return sorted(names, key=lambda n: -SequenceMatcher(None, name_lower, n.lower()).ratio())
