"""The ``[stability]`` table of a suite: how steady the infrared horizon is round an orbit and through the year."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model, PlainName, unit
from horizonval.spec.camera import Band, Positive
from horizonval.spec.earth import Atmosphere, Surface

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

    @property
    def band(self) -> Band:
        """The band as a camera has it."""
        return Band(name=self.name, kind="thermal", lo_um=self.lo_um, hi_um=self.hi_um)


class EdgeSensor(Model):
    """Four heads that each report the nadir angle of an edge."""

    name: PlainName
    """Name of the sensor."""
    kind: Literal["edge"]
    """A sensor of edges."""
    locator: Literal["half", "gradient", "threshold"]
    """What is taken for the edge: `half` of the head's own plateau, `gradient` the steepest fall, `threshold` a
    radiance fixed for good, half of the plateau's mean over the year and the orbit.
    """


class FieldSensor(Model):
    """Four heads with a square field across the horizon; their output is the mean radiance in the field."""

    name: PlainName
    """Name of the sensor."""
    kind: Literal["field"]
    """A sensor of the mean radiance in a field."""
    field_deg: Annotated[float, Field(ge=0.1, le=10)]
    """Side of the field."""


Sensor = Annotated[EdgeSensor | FieldSensor, Field(discriminator="kind")]


class StabilitySpec(Model):
    """A circular orbit, the months, the bands and the sensors of a study of the infrared horizon.

    The heads look forward, right, aft and left, turned to the right by `first_head_deg`.
    """

    altitude_km: Annotated[float, Field(ge=200, le=40_000)]
    """Altitude of the circular orbit, above the equator's radius."""
    inclination_deg: Annotated[float, Field(ge=0, le=180)] = 90.0
    """Inclination of the orbit."""
    positions: Annotated[int, Field(ge=4, le=720), unit("1")] = 72
    """Positions, evenly spread over the orbit."""
    months: Annotated[list[Month], Field(min_length=1, max_length=12)] = list(range(1, 13))
    """Months of the year, 1 to 12."""
    first_head_deg: Annotated[float, Field(ge=0, lt=90)] = 0.0
    """Azimuth of the first head from the velocity, to the right."""
    requirement_deg: Annotated[list[Positive], Field(min_length=2, max_length=2)] = [0.03, 0.1]
    """Two accuracies that the report holds the errors against, the smaller first."""
    band: Annotated[list[StabilityBand], Field(min_length=1)]
    """Thermal bands."""
    sensor: Annotated[list[Sensor], Field(min_length=1)]
    """Sensors; their `kind` is `edge` or `field`."""
    atmosphere: Atmosphere = Atmosphere(profile="by_latitude_month")
    """The air, as in a scene; the month comes from `months`."""
    surface: Surface = Surface()
    """The ground, as in a scene; `uniform` only."""

    @model_validator(mode="after")
    def _consistent(self) -> StabilitySpec:
        for what, names in (("bands", [b.name for b in self.band]), ("sensors", [s.name for s in self.sensor])):
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"two {what} are named {twice[0]!r}")
        if len(set(self.months)) != len(self.months):
            raise ValueError("months holds a month twice")
        if self.requirement_deg[0] > self.requirement_deg[1]:
            raise ValueError("requirement_deg must rise")
        return self

    @model_validator(mode="after")
    def _air(self) -> StabilitySpec:
        air = self.atmosphere
        if air.file is not None or air.profile_file is not None:
            key = "file" if air.file is not None else "profile_file"
            raise ValueError(f"atmosphere.{key} does not go with [stability], which needs air for every month")
        if air.profile == "none":
            raise ValueError('atmosphere.profile = "none" has no infrared horizon')
        if air.refraction:
            raise ValueError("atmosphere.refraction does not go with [stability], whose rays are straight")
        if self.surface.kind != "uniform":
            raise ValueError(
                f'surface.kind = "{self.surface.kind}" does not go with [stability], '
                "whose ground is alike at all longitudes"
            )
        for key in ("latitude_deg", "month"):
            if getattr(air, key) is not None:
                raise ValueError(f"atmosphere.{key} does not go with [stability], which goes through them itself")
        return self

    @model_validator(mode="after")
    def _fields_see_the_horizon_only(self) -> StabilitySpec:
        radius_deg = math.degrees(math.asin(6357.0 / (6378.0 + self.altitude_km)))
        for sensor in self.sensor:
            if isinstance(sensor, FieldSensor) and sensor.field_deg >= radius_deg:
                raise ValueError(
                    f"sensor {sensor.name!r}: field_deg must be below the Earth's angular radius, {radius_deg:.1f} deg"
                )
        return self
