"""Kinds of numbers that keys of the files hold."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from horizonval.spec.units import unit

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1), unit("1")]
Whole = Annotated[int, Field(ge=0), unit("1")]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-360, le=360)]


def _from_list(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


Listed = BeforeValidator(_from_list)
"""TOML has lists only: beside a tuple's type it lets one in, which strict validation would not."""
