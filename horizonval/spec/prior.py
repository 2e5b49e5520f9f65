"""What estimators are given in addition to the image: the tables ``[prior]`` and ``[calibration]``.

A prior is what is known before the image is processed, in a scene, suite or study or in a file of its own. A
calibration is the error of the camera and the time that estimators are given.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from horizonval.spec.base import (
    Epoch,
    Finite,
    FrameName,
    Listed,
    Model,
    NonNegative,
    Positive,
    Quaternion,
    Vector,
    unit,
)

BY_LATITUDE_MONTH = "by_latitude_month"


SigmaAngle = Annotated[float, Field(gt=0, le=180)]
UNIT_TOLERANCE = 1e-3
"""Of a quaternion's length: that of four digits."""


class PriorSpec(Model):
    """What is known before the image is processed, each value with the standard deviation of its error.

    With a picture (`horizonval estimate --prior`) values and sigmas go together. In scenes, suites and studies a sigma
    alone is enough: the value is then the truth with an error drawn from it, under the scene's `draw` or name and seed.
    A value next to it is used as it is. What has neither is unknown, but for the planet's shape.
    """

    later_keys = frozenset(
        {
            "accept_deg",
            "nadir_cam",
            "limb_scale_height_km",
            "limb_scale_height_sigma_km",
            "limb_relief_km",
            "air_height_sigma_km",
            "lens_blur_px",
            "gain_sigma_percent",
        }
    )

    shape: Literal["wgs84", "sphere"] | None = None
    """Shape of the planet. Without the key a scene's own; with a picture a sphere whose flattening counts as an error.
    """
    radius_km: Positive | None = None
    """Radius, for the sphere only; 6371.0088 without the key."""
    altitude_km: Positive | None = None
    """Height above the shape, of the ellipsoid the geodetic one."""
    altitude_sigma_km: Positive | None = None
    """Standard deviation of its error. A drawn altitude is above 0: one below is drawn again."""
    position_itrs_km: Vector | None = None
    """Position in Earth-fixed axes."""
    position_sigma_km: Positive | None = None
    """Standard deviation of the error of each component."""
    q_cam_from_itrs: Quaternion | None = None
    """Attitude of the camera against Earth-fixed axes, a unit quaternion, scalar last."""
    attitude_sigma_deg: Annotated[tuple[SigmaAngle, SigmaAngle, SigmaAngle], Listed] | None = None
    """Standard deviation of its error as a turn about the body's x (roll), y (pitch) and z (yaw)."""
    epoch_utc: Epoch | None = None
    """Date and time of the image, UTC. Where position or attitude are drawn, the scene's own without the key."""
    limb_height_km: Finite | None = None
    """Height of the limb in the image above the horizon of the shape, the mean all round."""
    limb_height_sigma_km: Positive | None = None
    """Standard deviation of its error. A height is drawn for thermal bands only, about the mean height of half the
    plateau of the truth's infrared horizon.
    """
    climate: str | None = None
    """What is known of the air: a name (`horizonval list atmospheres`), a profile file (.csv, .json) or a table of
    `horizonval templates` (.npz) next to this file, or `by_latitude_month`, which needs position and time.
    """
    sun_sigma_deg: SigmaAngle | None = None
    """Standard deviation of the Sun sensor's reading in each of two directions across it. Without the key the sensor
    gives whole degrees.
    """

    nadir_cam: Annotated[Vector, unit("1")] | None = None
    """Rough direction of the nadir in camera axes (x right, y down, z along the boresight), of any length, in place of
    `q_cam_from_itrs` and right to `attitude_sigma_deg` across it. The turn about it is unknown.
    """
    limb_scale_height_km: NonNegative | None = None
    """Scale height with which the limb's radiance falls outwards; 7 km without the key. 0 with a sigma of 0 is a hard
    limb.
    """
    limb_scale_height_sigma_km: NonNegative | None = None
    """Standard deviation of its error; 4 km without the key."""
    limb_relief_km: NonNegative | None = None
    """Standard deviation of the limb's height along itself; 0 for a sphere without relief. Without the key that of the
    band in any weather.
    """
    air_height_sigma_km: Positive | None = None
    """Standard deviation of the common height of the air whose profiles a method knows; 0.3 km without the key."""
    lens_blur_px: Positive | None = None
    """Standard deviation of the lens's blur that fits start from; 0.7 px without the key."""
    gain_sigma_percent: Positive | None = None
    """Relative standard deviation of the calibration from digital numbers to radiance; without the key 2 in thermal and
    5 in solar bands.
    """
    accept_deg: SigmaAngle | None = None
    """Accuracy of the nadir that is of use; 0.2 deg without the key. A frame whose information allows it must be
    answered, and guarded methods refuse what is less certain.
    """

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
        if (self.limb_scale_height_km is None) != (self.limb_scale_height_sigma_km is None):
            raise ValueError("give limb_scale_height_km and limb_scale_height_sigma_km, or neither")
        if self.nadir_cam is not None:
            if self.q_cam_from_itrs is not None:
                raise ValueError("nadir_cam and q_cam_from_itrs; give one of the two")
            if self.attitude_sigma_deg is None:
                raise ValueError("nadir_cam without attitude_sigma_deg; say how well it is known")
            if not any(self.nadir_cam):
                raise ValueError("nadir_cam is no direction: all of it is 0")
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
    """What is known before the image is processed."""


Percent = Annotated[float, Field(ge=-50, le=50)]
SigmaPercent = Annotated[float, Field(ge=0, le=20)]
Turn = Annotated[float, Field(ge=-180, le=180)]
SigmaTurn = Annotated[float, Field(ge=0, le=60)]
PerAxis = Annotated[tuple[SigmaTurn, SigmaTurn, SigmaTurn], Listed]
Seconds = Annotated[float, Field(ge=-600, le=600)]
SigmaSeconds = Annotated[float, Field(ge=0, le=100)]


class CalibrationSpec(Model):
    """Errors of the camera and the time that estimators are given.

    An `error` is the given value minus the true one. A `sigma` adds an error drawn from it, and estimators are given
    the sigma. Frame, noise and truth do not change.
    """

    draw: FrameName | None = None
    """Name of the flight that errors are drawn for: frames of one name and seed share them, as those of one camera do.
    Without the key every frame has its own (those of one `scene.draw` share them).
    """
    focal_length_error_percent: Percent = 0.0
    """Of both focal lengths, of a fisheye of its scale."""
    focal_length_sigma_percent: SigmaPercent = 0.0
    """Standard deviation of a drawn error of it."""
    principal_point_error_px: Annotated[tuple[Finite, Finite], Listed] = (0.0, 0.0)
    """Of the principal point: column, row."""
    principal_point_sigma_px: NonNegative = 0.0
    """Standard deviation of a drawn error of each of the two."""
    distortion_error_px: Finite = 0.0
    """Of the radial distortion, as it moves the image's farthest corner outwards: a change of `k1`."""
    distortion_sigma_px: NonNegative = 0.0
    """Standard deviation of a drawn error of it."""
    mounting_error_deg: Annotated[tuple[Turn, Turn, Turn], Listed] = (0.0, 0.0, 0.0)
    """Of the mounting about the body's x, y and z: by as much roll and pitch of an answer are larger, of a level body.
    """
    mounting_sigma_deg: PerAxis = (0.0, 0.0, 0.0)
    """Standard deviation of a drawn error of each of the three."""
    exposure_offset_s: Seconds = 0.0
    """By how much later than its stamp the image was taken: a drawn position and attitude are those of the stamp."""
    exposure_offset_sigma_s: SigmaSeconds = 0.0
    """Standard deviation of a drawn offset."""
    clock_error_s: Seconds = 0.0
    """By how much the clock is ahead: the drawn position is the orbit's at the wrong time, 7.5 km for each second."""
    clock_sigma_s: SigmaSeconds = 0.0
    """Standard deviation of a drawn error of it."""
