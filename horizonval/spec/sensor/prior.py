"""What is known before the image is looked at: the table ``[prior]`` of scenes, suites and studies, or a file of it."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, field_validator, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Finite, Listed, Positive
from horizonval.spec.units import unit

BY_LATITUDE_MONTH = "by_latitude_month"


def _time_from_text(value: Any) -> Any:
    try:
        return datetime.fromisoformat(value) if isinstance(value, str) else value
    except ValueError:
        return value


SigmaAngle = Annotated[float, Field(gt=0, le=180)]
UNIT_TOLERANCE = 1e-3
"""Of a quaternion's length: that of four digits."""


class PriorSpec(Model):
    """What is known before the image is looked at, each value with the standard deviation of its error.

    With a picture (`horizonval estimate --prior`) values and sigmas go together. In scenes, suites and studies a sigma
    alone is enough: the value is then the truth with an error drawn from it, under the scene's `draw` or name and seed.
    A value beside it stands as it is. Nothing is known of what has neither, but for the planet's shape.
    """

    shape: Literal["wgs84", "sphere"] | None = None
    """Shape of the planet. Without the key a scene's own; with a picture a sphere whose flattening counts as an error.
    """
    radius_km: Positive | None = None
    """Radius, for the sphere only; 6371.0088 without the key."""
    altitude_km: Positive | None = None
    """Height above the shape, of the ellipsoid the geodetic one."""
    altitude_sigma_km: Positive | None = None
    """Standard deviation of its error. A drawn altitude is above 0: one below is drawn again."""
    position_itrs_km: Annotated[tuple[Finite, Finite, Finite], Listed] | None = None
    """Position in Earth-fixed axes."""
    position_sigma_km: Positive | None = None
    """Standard deviation of the error of each component."""
    q_cam_from_itrs: Annotated[tuple[Finite, Finite, Finite, Finite], Listed, unit("1")] | None = None
    """Attitude of the camera against Earth-fixed axes, a unit quaternion, scalar last."""
    attitude_sigma_deg: Annotated[tuple[SigmaAngle, SigmaAngle, SigmaAngle], Listed] | None = None
    """Standard deviation of its error as a turn about the body's x (roll), y (pitch) and z (yaw)."""
    epoch_utc: Annotated[datetime, BeforeValidator(_time_from_text)] | None = None
    """Date and time of the image, UTC. Where position or attitude are drawn, the scene's own without the key."""
    limb_height_km: Finite | None = None
    """By how much the limb in the image stands above the horizon of the shape, the mean all round."""
    limb_height_sigma_km: Positive | None = None
    """Standard deviation of its error. A height is drawn for thermal bands only, about the mean height of half the
    plateau of the truth's infrared horizon.
    """
    climate: str | None = None
    """What is known of the air: a name (`horizonval list atmospheres`), a profile file (.csv, .json) or a table of
    `horizonval templates` (.npz) beside this one, or `by_latitude_month`, which needs position and time.
    """
    sun_sigma_deg: SigmaAngle | None = None
    """Standard deviation of the Sun sensor's reading in each of two directions across it. Without the key the sensor
    gives whole degrees.
    """

    @field_validator("epoch_utc")
    @classmethod
    def _utc(cls, value: datetime | None) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)

    @field_validator("q_cam_from_itrs")
    @classmethod
    def _unit_length(cls, value: tuple[float, float, float, float] | None) -> tuple[float, float, float, float] | None:
        if value is not None and abs(sum(x * x for x in value) ** 0.5 - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"its length is {sum(x * x for x in value) ** 0.5:.6g}, that of a rotation is 1")
        return value

    @model_validator(mode="after")
    def _values_have_sigmas(self) -> PriorSpec:
        for value, sigma in PAIRS.items():
            if getattr(self, value) is not None and getattr(self, sigma) is None:
                raise ValueError(f"{value} without {sigma}; say how well it is known")
        if self.radius_km is not None and self.shape != "sphere":
            raise ValueError('radius_km applies to shape = "sphere" only')
        if self.climate == "":
            raise ValueError("climate is empty; name one, or leave the key out")
        if self.climate == BY_LATITUDE_MONTH and self.position_sigma_km is None:
            raise ValueError(f'climate = "{BY_LATITUDE_MONTH}" needs a position: give position_sigma_km')
        return self


def is_climate_file(climate: str) -> bool:
    """Whether a climate is a file, and no name: a profile of the air, or a table of profiles of the limb."""
    return climate.lower().endswith((".csv", ".json")) or is_limb_table(climate)


def is_limb_table(climate: str) -> bool:
    """Whether a climate is a table of profiles of the limb."""
    return climate.lower().endswith(".npz")


PAIRS = {
    "altitude_km": "altitude_sigma_km",
    "position_itrs_km": "position_sigma_km",
    "q_cam_from_itrs": "attitude_sigma_deg",
    "limb_height_km": "limb_height_sigma_km",
}
"""A value, and the standard deviation that it cannot be without."""


class PriorFile(Model):
    """What is known of one picture: one table `[prior]`."""

    prior: PriorSpec
    """What is known before the image is looked at."""
