"""Scene files: one camera, one pose, one planet, one instant."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator

from horizonval.spec.base import Model
from horizonval.spec.camera import Fraction, Positive

Angle = Annotated[float, Field(ge=-360, le=360)]


class SceneName(Model):
    """Identity of the scene; the seed of everything random is a hash of it."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")] = "scene"
    seed: Annotated[int, Field(ge=0)] = 0


class CameraUse(Model):
    """Which camera (a shipped name, or a path beside the scene file), and how it is mounted in the body.

    The mounting turns body axes into camera axes: yaw about z, then pitch about y, then roll about x.
    """

    file: str
    mount_yaw_deg: Angle = 0.0
    mount_pitch_deg: Angle = 0.0
    mount_roll_deg: Angle = 0.0


class Platform(Model):
    """Where the satellite is. ``altitude_km`` is geodetic; ``heading_deg`` is the velocity's azimuth from north."""

    epoch_utc: datetime = datetime(2026, 3, 20, 12, 0, 0, tzinfo=UTC)
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    longitude_deg: Angle = 0.0
    altitude_km: Annotated[float, Field(gt=0, le=2_000_000)]
    heading_deg: Angle = 0.0

    @field_validator("epoch_utc")
    @classmethod
    def _utc(cls, value: datetime) -> datetime:
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Attitude(Model):
    """Body against lvlh (x to the velocity, z to the geocentric nadir): yaw about z, pitch about y, roll about x."""

    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0


class Earth(Model):
    """Shape of the planet. ``radius_km`` is for the sphere only."""

    shape: Literal["wgs84", "sphere"] = "wgs84"
    radius_km: Positive = 6371.0088

    @model_validator(mode="after")
    def _radius_is_for_spheres(self) -> Earth:
        if self.shape == "wgs84" and "radius_km" in self.model_fields_set:
            raise ValueError('radius_km applies to shape = "sphere" only')
        return self


class Atmosphere(Model):
    """Profile by name (``horizonval list atmospheres``), ``none``, or a file in the ``radiance`` command's format.

    A file's bands must be named after the camera's bands; it replaces gases and temperature altogether.

    ``refraction``: the air bends light. The hard limb is then seen where the limb of a planet larger by n - 1 times its
    radius would be (1.77 km in visible light, 2.4 arcmin from 500 km); the frame's truth and its maps stay those of
    straight lines. A file must have ``refractivity``. Light scattered more than once is computed without
    refraction. With 128 nodes the march is then within 0.5 % of its limit in bright pixels with the Sun up, 0.9 % with
    the Sun 5 deg below the horizon, and 1.2 % and 4 % down to a thousandth of the brightest.
    """

    profile: str = "us_standard"
    file: str | None = None
    ozone: bool = True
    refraction: bool = False


class Surface(Model):
    """Lambert ground. ``temperature_k`` defaults to the profile's lowest level."""

    albedo: Fraction = 0.3
    emissivity: Fraction = 1.0
    temperature_k: Positive | None = None


class SunOverride(Model):
    """Place the Sun by hand, seen from the point below the satellite; without this table the epoch decides."""

    zenith_deg: Annotated[float, Field(ge=0, le=180)]
    azimuth_deg: Angle = 0.0


class RenderSettings(Model):
    """Accuracy of the march: ``subsamples`` per pixel and axis, ``nodes`` along each ray; ``orders`` of scattering.

    With 128 nodes the march is within 0.3 % of its limit wherever a pixel has a twentieth of the brightest one's
    radiance, and within 1 % down to a thousandth, with the Sun at any height to 8 deg below the horizon.
    """

    subsamples: Annotated[int, Field(ge=1, le=16)] = 2
    nodes: Annotated[int, Field(ge=8, le=4096)] = 128
    orders: Literal["single", "all"] = "all"


class SceneSpec(Model):
    """One scene file."""

    scene: SceneName = SceneName()
    camera: CameraUse
    platform: Platform
    attitude: Attitude = Attitude()
    earth: Earth = Earth()
    atmosphere: Atmosphere = Atmosphere()
    surface: Surface = Surface()
    sun: SunOverride | None = None
    render: RenderSettings = RenderSettings()
