"""Kinds of numbers and names that keys of the files hold."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from horizonval.core.machine.file_names import LONGEST_FRAME_NAME, LONGEST_NAME, usable_name
from horizonval.spec.units import unit

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
