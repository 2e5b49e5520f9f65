"""What all models of the files share: strict keys, frozen values, kinds of numbers and names, units."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from typing import Annotated, Any, ClassVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)

from horizonval.core.files import LONGEST_FRAME_NAME, LONGEST_NAME, usable_name
from horizonval.core.json_types import JsonObject


class Model(BaseModel):
    """Base of every specification: unknown keys are refused, values cannot be changed.

    The docstring below a key is its description in the schema and in the reference. ``later_keys`` came after files
    were first archived: where they hold their default ``model_dump`` leaves them out, so that a file that does not use
    them keeps its identity, hence its noise and its bytes.
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


SUFFIXES = {
    "deg": "deg",
    "deg_s": "deg/s",
    "rad": "rad",
    "km": "km",
    "m": "m",
    "mm": "mm",
    "um": "um",
    "m_s": "m/s",
    "km_s": "km/s",
    "s": "s",
    "h": "h",
    "hz": "Hz",
    "k": "K",
    "c": "deg C",
    "k_per_min": "K/min",
    "percent": "%",
    "ppm": "ppm",
    "px": "px",
    "e": "electrons",
    "e_per_s": "electrons/s",
    "e_per_um": "electrons/um",
    "e_per_dn": "electrons/DN",
    "dn": "DN",
    "per_cm2_s": "1/(cm2 s)",
    "cm_rthz_per_w": "cm Hz^(1/2)/W",
    "mb": "MiB",
}
"""Unit by the end of a key's name, after an underscore."""


def unit(name: str) -> Any:
    """Return what states a number's unit in ``Annotated``, where the key's name does not say it; ``"1"`` for none."""
    return Field(json_schema_extra={"unit": name})


def unit_of_name(key: str) -> str | None:
    """Return the unit that a key's name ends with, the longest where several fit; None if it says none."""
    found = [suffix for suffix in SUFFIXES if key.endswith("_" + suffix)]
    return SUFFIXES[max(found, key=len)] if found else None


Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1), unit("1")]
Whole = Annotated[int, Field(ge=0), unit("1")]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$", max_length=LONGEST_NAME), AfterValidator(usable_name)]
FrameName = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9._-]+$", max_length=LONGEST_FRAME_NAME), AfterValidator(usable_name)
]
PlainName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=LONGEST_NAME), AfterValidator(usable_name)]
"""Without dots: these part it from other names."""
Angle = Annotated[float, Field(ge=-360, le=360)]


def _from_list(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Listed = BeforeValidator(_from_list)
"""TOML has lists only: beside a tuple's type it lets one in, which strict validation would not."""
Vector = Annotated[tuple[Finite, Finite, Finite], Listed]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], Listed, unit("1")]


def _time_from_text(value: Any) -> Any:
    try:
        return datetime.fromisoformat(value) if isinstance(value, str) else value
    except ValueError:
        return value


def in_utc(value: datetime) -> datetime:
    """Return an instant in UTC; one without an offset is taken as UTC."""
    try:
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)
    except OverflowError:
        raise ValueError(f"{value.isoformat()} in UTC is before the year 1 or after the year 9999") from None


Epoch = Annotated[datetime, BeforeValidator(_time_from_text), AfterValidator(in_utc)]
"""Date and time in UTC, of a TOML file or as text in the form of ISO 8601."""


def deep_merge(below: Mapping[str, Any], above: Mapping[str, Any]) -> JsonObject:
    """Return ``below`` with ``above`` laid over it: tables merge key by key, anything else is replaced."""
    merged = dict(below)
    for key, value in above.items():
        old = merged.get(key)
        merged[key] = deep_merge(old, value) if isinstance(old, Mapping) and isinstance(value, Mapping) else value
    return merged
