"""Shape and ground of the planet in a scene file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Fraction, Positive


class Earth(Model):
    """Shape of the planet."""

    shape: Literal["wgs84", "sphere"] = "wgs84"
    """The WGS84 ellipsoid, or a sphere."""
    radius_km: Positive = 6371.0088
    """Radius; for the sphere only."""

    @model_validator(mode="after")
    def _radius_is_for_spheres(self) -> Earth:
        if self.shape == "wgs84" and "radius_km" in self.model_fields_set:
            raise ValueError('radius_km applies to shape = "sphere" only')
        return self


class Surface(Model):
    """The ground.

    `uniform` is a Lambert ground of one albedo and one emissivity. `earth` has fifteen kinds of land from a map of 0.05
    degrees, snow and sea ice by month, ice sheets, and an ocean that glints in the Sun, each with its own spectrum of
    albedo and emissivity, as warm as their latitude, height and month say, land with its day and night
    (`horizonval.earth.surface.surface_temperature`).
    """

    kind: Literal["uniform", "earth"] = "uniform"
    """`uniform` or `earth`; see above."""
    albedo: Fraction = 0.3
    """Share of the sunlight that the uniform ground reflects."""
    wind_speed_m_s: Annotated[float, Field(ge=0, le=40)] | None = None
    """Wind that roughens the ocean of `earth` for sunlight; 7 without the key."""
    city_lights: bool = False
    """Whether cities of `earth` shine by night: the thousand largest, right to a factor of two or three
    (`horizonval.earth.surface.city_lights`).
    """
    emissivity: Fraction = 1.0
    """Of the uniform ground, in thermal bands."""
    temperature_k: Positive | None = None
    """One temperature for all ground. Without the key a uniform ground is as warm as the lowest air, and `earth` as its
    latitude and month say.
    """

    @model_validator(mode="after")
    def _keys_belong_to_the_kind(self) -> Surface:
        if self.kind == "earth" and "albedo" in self.model_fields_set:
            raise ValueError('albedo applies to kind = "uniform" only')
        if self.kind == "earth" and "emissivity" in self.model_fields_set:
            raise ValueError('emissivity applies to kind = "uniform" only')
        if self.kind == "uniform" and self.wind_speed_m_s is not None:
            raise ValueError('wind_speed_m_s applies to kind = "earth" only')
        if self.kind == "uniform" and self.city_lights:
            raise ValueError('city_lights applies to kind = "earth" only')
        return self
