"""The clouds of a scene file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Fraction
from horizonval.spec.units import unit


class Clouds(Model):
    """Opaque clouds: a random relief of white tops. No clouds without this table.

    In thermal bands the tops are as warm as the air there. What they do not emit they let through from below; they
    reflect nothing.
    """

    cover: Fraction
    """Covered share of the whole globe."""
    top_km: Annotated[float, Field(ge=1, le=17)] = 12.0
    """Height of the highest tops; they end at the tropopause where that is lower (17 km in the tropics, 9 km at the
    poles).
    """
    mean_top_km: Annotated[float, Field(gt=0.5, le=17)] | None = None
    """Mean height of the tops where the tropopause is not lower; without the key four tenths of `top_km`, and 0.3 km.
    """
    scale_km: Annotated[float, Field(ge=3, le=5000)] = 300.0
    """Size of the largest structures; there are smaller ones down to 3 km."""
    seed: Annotated[int, Field(ge=0, le=2**32 - 1), unit("1")] | None = None
    """Draws the relief; without the key the scene's name (or its `draw`) and seed do."""
    albedo: Fraction = 0.8
    """Of the highest tops; lower ones are greyer."""
    emissivity: Fraction = 1.0
    """Share of a black body's emission in thermal bands: 1 for all but thin clouds (a water cloud of 70 g m-2 or an ice
    cloud of 190 emits 0.99).
    """

    @model_validator(mode="after")
    def _the_mean_is_below_the_highest(self) -> Clouds:
        if self.mean_top_km is not None and self.mean_top_km >= self.top_km:
            raise ValueError("mean_top_km must be below top_km")
        return self
