"""What all TOML models share: strict keys, frozen values, and a plain form that outlives new keys."""

from __future__ import annotations

from functools import cache
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, model_serializer


class Model(BaseModel):
    """Base of every specification: unknown keys are refused, values cannot be changed.

    The text below a key is its description in the schema and in the reference.

    Attributes
    ----------
    later_keys : frozenset of str
        Keys that came after files were first archived. Where they hold their default they are left out of
        ``model_dump``, so that a file that does not use them keeps its identity, hence its noise and its bytes.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)
    later_keys: ClassVar[frozenset[str]] = frozenset()

    @model_serializer(mode="wrap")
    def _without_unused_later_keys(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        data: dict[str, Any] = handler(self)
        for key, default in _later_defaults(type(self)):
            if key in data and getattr(self, key) == default:
                del data[key]
        return data


@cache
def _later_defaults(model: type[Model]) -> tuple[tuple[str, Any], ...]:
    """Return the later keys of a model with their defaults, which are compared with and never handed out."""
    return tuple((key, model.model_fields[key].get_default(call_default_factory=True)) for key in model.later_keys)
