"""What a JSON text or a TOML file holds, as Python reads it."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from types import UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

JsonObject = dict[str, Any]
"""An object of a JSON text, or a table of a TOML file: keys are text, values whatever the format allows."""

T = TypeVar("T")


def typed(content: T) -> T:
    """Return a dataclass that was built from stored data; ``TypeError`` unless its fields have their declared types."""
    for name, hint in _hints(type(content)).items():  # type: ignore[arg-type]
        if not _fits(getattr(content, name), hint):
            raise TypeError(f"{name} is not {hint}")
    return content


@cache
def _hints(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _fits(value: object, hint: Any) -> bool:
    arguments = get_args(hint)
    if isinstance(hint, UnionType):
        return any(_fits(value, one) for one in arguments)
    if get_origin(hint) is Literal:
        return value in arguments
    if get_origin(hint) is tuple:
        return isinstance(value, tuple) and all(_fits(one, arguments[0]) for one in value)
    if hint in (int, float):
        return isinstance(value, int | hint) and not isinstance(value, bool)
    return isinstance(value, hint)
