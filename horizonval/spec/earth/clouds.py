"""The clouds of a scene file."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Fraction
from horizonval.spec.units import unit

EARTH_TOP_KM, UNIFORM_TOP_KM, UNIFORM_SCALE_KM = 17.0, 12.0, 300.0
CLIMATE_COVER = 0.67


class Clouds(Model):
    """Clouds: a random relief of tops. No clouds without this table.

    `pattern = "earth"` has them as the Earth does: by latitude and month, over land and sea, as fronts and cyclones,
    tropical clusters, decks and cumulus, each with its heights and brightness. `"uniform"` is the same noise
    everywhere, of opaque white tops.

    In thermal bands the tops are as warm as the air there. What they do not emit they let through from below; they
    reflect nothing.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"pattern"})

    cover: Fraction | Literal["climate"] = "climate"
    """Covered share of the whole globe; `"climate"` is that of the month, about 0.67, thin clouds included."""
    pattern: Literal["earth", "uniform"] | None = None
    """Without the key `"earth"` where the cover is that of the climate, `"uniform"` where it is a number."""
    top_km: Annotated[float, Field(ge=1, le=17)] | None = None
    """Height of the highest tops; they end at the tropopause where that is lower (17 km in the tropics, 9 km at the
    poles). Without the key 17 for the pattern of the Earth and 12 for the uniform one.
    """
    mean_top_km: Annotated[float, Field(gt=0.5, le=17)] | None = None
    """Of the uniform pattern: mean height of the tops where the tropopause is not lower; without the key four tenths of
    `top_km`, and 0.3 km.
    """
    scale_km: Annotated[float, Field(ge=3, le=5000)] = UNIFORM_SCALE_KM
    """Of the uniform pattern: size of the largest structures; there are smaller ones down to 3 km."""
    seed: Annotated[int, Field(ge=0, le=2**32 - 1), unit("1")] | None = None
    """Draws the relief; without the key the scene's name (or its `draw`) and seed do."""
    albedo: Fraction = 0.8
    """Of the brightest clouds. Uniform ones are greyer where they are lower, those of the Earth where they are thinner.
    """
    emissivity: Fraction = 1.0
    """Share of a black body's emission in thermal bands: 1 for all but thin clouds (a water cloud of 70 g m-2 or an ice
    cloud of 190 emits 0.99).
    """

    @model_validator(mode="before")
    @classmethod
    def _highest_tops_of_the_pattern(cls, data: Any) -> Any:
        if not isinstance(data, dict) or data.get("top_km") is not None:
            return data
        pattern = data.get("pattern")
        earth = data.get("cover", "climate") == "climate" if pattern is None else pattern == "earth"
        return {**data, "top_km": EARTH_TOP_KM if earth else UNIFORM_TOP_KM}

    @model_validator(mode="after")
    def _keys_of_the_pattern(self) -> Clouds:
        if self.mean_top_km is not None and self.mean_top_km >= self.highest_top_km:
            raise ValueError("mean_top_km must be below top_km")
        if not self.like_the_earth:
            if self.cover == "climate":
                raise ValueError('pattern = "uniform" needs a cover from 0 to 1')
        elif self.mean_top_km is not None or self.scale_km != UNIFORM_SCALE_KM:
            raise ValueError('mean_top_km and scale_km belong to pattern = "uniform"; leave them out')
        return self

    @property
    def like_the_earth(self) -> bool:
        """Whether the pattern is that of the Earth."""
        return self.cover == "climate" if self.pattern is None else self.pattern == "earth"

    @property
    def highest_top_km(self) -> float:
        """Height of the highest tops."""
        if self.top_km is not None:
            return self.top_km
        return EARTH_TOP_KM if self.like_the_earth else UNIFORM_TOP_KM

    @property
    def expected_cover(self) -> float:
        """Covered share of the globe, of the climate to 0.01."""
        return CLIMATE_COVER if isinstance(self.cover, str) else self.cover
