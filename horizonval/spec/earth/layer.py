"""The layers of thin cloud of a scene file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Fraction
from horizonval.spec.units import unit

FINEST_ICE_UM = 0.02
MAX_ICE_UM, MAX_WATER_UM, MIN_WATER_UM = 60.0, 30.0, 4.0
FINE_ICE_UM, COARSE_ICE_UM = 0.2, 10.0


class CloudLayer(Model):
    """Thin cloud: a shell of particles that light goes through. Opaque clouds are in `[clouds]`.

    Every key but `kind` has a value by the kind (`horizonval.earth.clouds.layer_kinds` has them with their sources),
    the heights of cirrus by the latitude of the satellite too.
    """

    kind: Literal["cirrus", "subvisible_cirrus", "polar_stratospheric", "noctilucent", "thin_water"]
    """`cirrus` below the tropopause, `subvisible_cirrus` just below that of the tropics, `polar_stratospheric` and
    `noctilucent` clouds, or a `thin_water` cloud near the ground."""
    optical_depth: Annotated[float, Field(ge=0, le=5), unit("1")] | None = None
    """Straight down through cloud, at 550 nm."""
    base_km: Annotated[float, Field(ge=0.2, le=95)] | None = None
    """Height of the base."""
    top_km: Annotated[float, Field(ge=0.4, le=98)] | None = None
    """Height of the top, 0.2 km above the base at least."""
    phase: Literal["ice", "water"] | None = None
    """What the particles are made of."""
    effective_radius_um: Annotated[float, Field(ge=FINEST_ICE_UM, le=MAX_ICE_UM)] | None = None
    """Of the particles: 10 to 60 um or 0.02 to 0.2 um for ice, 4 to 30 um for water."""
    cover: Fraction = 1.0
    """Covered share. Without `scale_km` the particles are spread evenly over the whole shell: a layer of optical depth
    0.2 and cover 0.5 is one of 0.1."""
    scale_km: Annotated[float, Field(ge=20, le=2000)] | None = None
    """Size of the largest cloudy places: the layer then has gaps between them, and `optical_depth` is the cloud's.
    Without it the cloud is spread out evenly."""
    seed: Annotated[int, Field(ge=0, le=2**32 - 1), unit("1")] | None = None
    """Draws the places of cloud and gaps. Default: drawn from the scene's name and seed."""
    occurrence: Literal["given", "climate"] = "given"
    """`given`: `cover` says it. `climate`: the cover is how often the kind is seen at the satellite's latitude in the
    month of the epoch."""

    @model_validator(mode="after")
    def _consistent(self) -> CloudLayer:
        if self.base_km is not None and self.top_km is not None and self.top_km < self.base_km + 0.2 - 1e-9:
            raise ValueError("top_km must be at least 0.2 km above base_km")
        if self.seed is not None and self.scale_km is None:
            raise ValueError("seed draws the gaps of a layer, which has none without scale_km; give both or neither")
        if self.occurrence == "climate":
            if "cover" in self.model_fields_set:
                raise ValueError('cover does not go with occurrence = "climate", which says it; leave one of them out')
            if self.kind == "thin_water":
                raise ValueError('occurrence = "climate" does not know thin_water; give its cover')
        radius = self.effective_radius_um
        if radius is not None:
            phase = self.phase or ("water" if self.kind == "thin_water" else "ice")
            if phase == "water" and not MIN_WATER_UM <= radius <= MAX_WATER_UM:
                raise ValueError(f"effective_radius_um of water must be {MIN_WATER_UM:g} to {MAX_WATER_UM:g}")
            if phase == "ice" and FINE_ICE_UM < radius < COARSE_ICE_UM:
                raise ValueError(
                    f"effective_radius_um of ice must be {COARSE_ICE_UM:g} or more, or {FINE_ICE_UM:g} or less"
                )
        return self
