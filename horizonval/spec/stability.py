"""The ``[stability]`` table of a suite: how steady the infrared horizon is round an orbit and through the year."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from horizonval.spec.base import Model, PlainName, unit
from horizonval.spec.camera import Positive

Month = Annotated[int, Field(ge=1, le=12), unit("1")]


class StabilityBand(Model):
    """A thermal band with a rectangular response."""

    name: PlainName
    """Name of the band."""
    lo_um: Positive
    """Lower end."""
    hi_um: Positive
    """Upper end."""

    @model_validator(mode="after")
    def _limits(self) -> StabilityBand:
        if self.hi_um <= self.lo_um:
            raise ValueError("lo_um must be below hi_um")
        return self


class StabilitySpec(Model):
    """A circular orbit, months and bands; four horizon heads look forward, right, aft and left.

    The air is the blend of mean climates by latitude and month. Edge sensors locate half of their own plateau, the
    steepest fall and a fixed radiance; a field sensor measures the mean radiance in a square field.
    """

    altitude_km: Annotated[float, Field(ge=200, le=40_000)]
    """Altitude of the circular orbit, above the equator's radius."""
    inclination_deg: Annotated[float, Field(ge=0, le=180)] = 90.0
    """Inclination of the orbit."""
    positions: Annotated[int, Field(ge=4, le=720), unit("1")] = 72
    """Positions, evenly spread over the orbit."""
    months: Annotated[list[Month], Field(min_length=1, max_length=12)] = list(range(1, 13))
    """Months of the year, 1 to 12."""
    field_deg: Annotated[float, Field(ge=0.1, le=5)] = 2.0
    """Side of the field sensor's field."""
    band: Annotated[list[StabilityBand], Field(min_length=1)]
    """Thermal bands."""

    @model_validator(mode="after")
    def _nothing_twice(self) -> StabilitySpec:
        names = [band.name for band in self.band]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"two bands are named {twice[0]!r}")
        if len(set(self.months)) != len(self.months):
            raise ValueError("months holds a month twice")
        return self
