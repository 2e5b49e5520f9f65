"""Scene files: one camera, one pose, one planet, one instant."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Angle, Finite, Fraction, Listed, Positive


class SceneName(Model):
    """Identity of the scene; the seed of everything random is a hash of it.

    ``draw``: a name that stands in place of the scene's own identity wherever something is drawn. Scenes of the same
    draw and seed have the same clouds and, with the same camera name, the same noise: common random numbers, for
    comparing cameras and methods frame by frame.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"draw"})

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")] = "scene"
    seed: Annotated[int, Field(ge=0)] = 0
    draw: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]+$")] | None = None


class CameraUse(Model):
    """Which camera (a shipped name, or a path beside the scene file), and how it is mounted in the body.

    The mounting turns body axes into camera axes: yaw about z, then pitch about y, then roll about x.

    ``head``: which one of a camera file with several ``[[head]]`` tables. The mounting then turns body axes into those
    of the housing that holds the heads, and the head's own angles turn these into camera axes. ``"all"`` stands for
    one frame per head, named ``<scene>.<head>``; a suite's frame without the key does the same.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"head"})

    file: str
    head: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")] | None = None
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
    """Body against lvlh (x to the velocity, z to the geocentric nadir): yaw about z, pitch about y, roll about x.

    ``rate_deg_s``: the body's angular velocity against lvlh, in body axes, which blurs exposures and slants rolling
    shutters. ``hold = "inertial"`` adds the orbital rate: a body that is fixed among the stars.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"rate_deg_s", "hold"})

    yaw_deg: Angle = 0.0
    pitch_deg: Angle = 0.0
    roll_deg: Angle = 0.0
    rate_deg_s: Annotated[tuple[Finite, Finite, Finite], Listed] = (0.0, 0.0, 0.0)
    hold: Literal["lvlh", "inertial"] = "lvlh"


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
    """What the air is made of.

    ``profile``: temperature and gases by name (``horizonval list atmospheres``). ``none`` is no atmosphere at all;
    ``by_latitude_month`` blends the AFGL climates for the month of the epoch, or for ``month`` (1 to 12) where it is
    given. Thermal bands then have the air of every latitude in sight, solar bands one column for the whole frame, that
    of the point below the satellite. With ``latitude_deg`` the climate of that latitude serves everywhere in all bands.

    ``co2_ppm``: carbon dioxide of the lower atmosphere, for thermal bands only; the absorption tables stand at 330 and
    420 ppm, see :mod:`horizonval.earth.spectral.thermal_absorption`.

    ``profile_file``: temperature and gases from a CSV or JSON file beside the scene, in place of ``profile``; see
    :mod:`horizonval.earth.atmosphere.profile_file`.

    ``file``: optical properties from a file in the ``radiance`` command's format, in place of everything else here. Its
    bands must be named after the camera's bands.

    ``aerosol``: LOWTRAN7's particles, see :mod:`horizonval.earth.atmosphere.aerosol`: ``none`` (the default: clean
    air, and a third of the time), ``background`` (haze of 23 km visibility at the ground, a quiet stratosphere),
    ``volcanic_moderate`` or ``volcanic_high``.

    ``ozone``: whether ozone absorbs sunlight.

    ``refraction``: the air bends light. The hard limb is then seen where the limb of a planet larger by n - 1 times its
    radius would be (1.77 km in visible light, 2.4 arcmin from 500 km); the frame's truth and its maps stay those of
    straight lines. A file must have ``refractivity``. Light scattered more than once is computed without refraction,
    and there can be no clouds. With 128 nodes the march is then within 0.5 % of its limit in bright pixels with the Sun
    up, 0.9 % with the Sun 5 deg below the horizon, and 1.2 % and 4 % down to a thousandth of the brightest.
    """

    profile: str = "us_standard"
    profile_file: str | None = None
    file: str | None = None
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    month: Annotated[int, Field(ge=1, le=12)] | None = None
    aerosol: Literal["none", "background", "volcanic_moderate", "volcanic_high"] = "none"
    ozone: bool = True
    co2_ppm: Annotated[float, Field(ge=280, le=560)] = 420.0
    refraction: bool = False

    @model_validator(mode="after")
    def _consistent(self) -> Atmosphere:
        if self.file is not None and self.profile_file is not None:
            raise ValueError("give at most one of file and profile_file")
        if self._airless and self.aerosol != "none":
            raise ValueError(f'aerosol = "{self.aerosol}" needs air, but profile = "none"; set aerosol = "none"')
        if self.file is not None and self.aerosol != "none":
            raise ValueError(
                f'aerosol = "{self.aerosol}" does not go with file, which holds all that scatters; set aerosol = "none"'
            )
        if self.co2_ppm != 420.0 and (self.file is not None or self._airless):
            raise ValueError('co2_ppm applies to an atmosphere with gases of its own, not to file or profile = "none"')
        by_place = self.profile == "by_latitude_month" and self.profile_file is None and self.file is None
        for key in ("latitude_deg", "month"):
            if getattr(self, key) is not None and not by_place:
                raise ValueError(f'{key} applies to profile = "by_latitude_month" only')
        return self

    @property
    def _airless(self) -> bool:
        return self.profile_file is None and self.file is None and self.profile == "none"


class Surface(Model):
    """The ground.

    ``uniform`` is a Lambert ground of one ``albedo`` and one ``emissivity``; without ``temperature_k`` it is as warm as
    the lowest air. ``earth`` has land, seasonal snow and an ocean that glints in the Sun, each with its own spectrum of
    albedo and emissivity; ``wind_speed_m_s`` roughens the ocean for sunlight (default 7). Land, snow and ocean are as
    warm as their latitude and month say, land with its day and night
    (:mod:`horizonval.earth.surface.surface_temperature`); ``temperature_k`` puts one temperature in place of all that.
    """

    kind: Literal["uniform", "earth"] = "uniform"
    albedo: Fraction = 0.3
    wind_speed_m_s: Annotated[float, Field(ge=0, le=40)] | None = None
    emissivity: Fraction = 1.0
    temperature_k: Positive | None = None

    @model_validator(mode="after")
    def _keys_belong_to_the_kind(self) -> Surface:
        if self.kind == "earth" and "albedo" in self.model_fields_set:
            raise ValueError('albedo applies to kind = "uniform" only')
        if self.kind == "earth" and "emissivity" in self.model_fields_set:
            raise ValueError('emissivity applies to kind = "uniform" only')
        if self.kind == "uniform" and self.wind_speed_m_s is not None:
            raise ValueError('wind_speed_m_s applies to kind = "earth" only')
        return self


class Clouds(Model):
    """Opaque clouds: a random relief of white tops. No clouds without this table.

    ``cover`` is the covered share of the whole globe. The highest tops reach ``top_km``, or the tropopause where it is
    lower (17 km in the tropics, 9 km at the poles); ``mean_top_km`` is the mean over the clouds where it is not
    (default: four tenths of ``top_km``, and 0.3). ``albedo`` is that of the highest tops; lower ones are greyer.
    ``scale_km`` is the size of the largest structures; there are smaller ones down to 3 km. Without a ``seed`` the
    scene's name and seed decide.

    In thermal bands the tops are as warm as the air there and emit ``emissivity`` of a black body: 1, the default, for
    all but thin clouds (a water cloud of 70 g m-2 or an ice cloud of 190 emits 0.99). What they do not emit they let
    through from below; they reflect nothing.
    """

    cover: Fraction
    top_km: Annotated[float, Field(ge=1, le=17)] = 12.0
    mean_top_km: Annotated[float, Field(gt=0.5, le=17)] | None = None
    scale_km: Annotated[float, Field(ge=3, le=5000)] = 300.0
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] | None = None
    albedo: Fraction = 0.8
    emissivity: Fraction = 1.0

    @model_validator(mode="after")
    def _the_mean_is_below_the_highest(self) -> Clouds:
        if self.mean_top_km is not None and self.mean_top_km >= self.top_km:
            raise ValueError("mean_top_km must be below top_km")
        return self


class SunOverride(Model):
    """Place the Sun by hand, seen from the point below the satellite; without this table the epoch decides."""

    zenith_deg: Annotated[float, Field(ge=0, le=180)]
    azimuth_deg: Angle = 0.0


class Moon(Model):
    """The Moon. Its place comes from the epoch, or from ``zenith_deg`` and ``azimuth_deg``, as the Sun's in ``[sun]``.

    Where the Sun is placed by hand there is no Moon unless it is placed by hand too: that of the epoch would not fit.
    """

    enabled: bool = True
    zenith_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    azimuth_deg: Angle = 0.0


class Night(Model):
    """What shines where the Sun does not: airglow (needs air), the sky behind, and moonlight on ground and air.

    They are left out of frames in which the Sun is nowhere lower than 9 deg below the horizon, and moonlight also where
    the Moon is a thin crescent (within some 20 deg of the Sun). Thermal bands have none of them, and no Moon.
    """

    airglow: bool = True
    sky_background: bool = True
    moonlight: bool = True


class RenderSettings(Model):
    """Accuracy of the march: ``subsamples`` per pixel and axis, ``nodes`` along each ray; ``orders`` of scattering.

    With 128 nodes the march is within 0.3 % of its limit wherever a pixel has a twentieth of the brightest one's
    radiance, and within 1 % (in twilight 0.3 %, with particles 1.5 %) down to a thousandth, with the Sun at any height
    to 8 deg below the horizon.

    ``band_error``: largest relative error of a solar band's radiance, from limb and ground under a high or a low Sun,
    that too few wavelengths may leave; decides how many a band gets that does not say so itself (``nodes`` of the
    camera's band). With 1.2 % a band of 450 to 750 nm gets 4, and is within 0.4 % but where the Sun stands low; 0.3 %
    takes 6, and twice the time.
    """

    subsamples: Annotated[int, Field(ge=1, le=16)] = 2
    nodes: Annotated[int, Field(ge=8, le=4096)] = 128
    orders: Literal["single", "all"] = "all"
    band_error: Annotated[float, Field(ge=1e-4, le=0.1)] = 0.012


class SceneSpec(Model):
    """One scene file."""

    scene: SceneName = SceneName()
    camera: CameraUse
    platform: Platform
    attitude: Attitude = Attitude()
    earth: Earth = Earth()
    atmosphere: Atmosphere = Atmosphere()
    surface: Surface = Surface()
    clouds: Clouds | None = None
    sun: SunOverride | None = None
    moon: Moon = Moon()
    night: Night = Night()
    render: RenderSettings = RenderSettings()

    @model_validator(mode="after")
    def _clouds_lie_at_unbent_heights(self) -> SceneSpec:
        if self.atmosphere.refraction and self.clouds is not None:
            raise ValueError("clouds do not go with atmosphere.refraction; leave one of them out")
        return self
