"""One table laid over another."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from horizonval.core.json_types import JsonObject


def deep_merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> JsonObject:
    """Return ``below`` with ``above`` laid over it: tables merge key by key, anything else is replaced."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = deep_merge(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged
