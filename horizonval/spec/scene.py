"""Scene files: one camera, one pose, one planet, one instant."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import Angle, Finite, Fraction, FrameName, Listed, PlainName, Positive, Whole
from horizonval.spec.units import unit


class SceneName(Model):
    """Identity of the scene; the seed of everything random is a hash of it."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"draw"})

    name: FrameName = "scene"
    """Name of the scene. Clouds are drawn from it, unless there is a `draw`; with all the rest of scene and camera it
    also seeds the noise.
    """
    seed: Whole = 0
    """Another number draws other clouds and other noise. In a suite the default is the suite's seed."""
    draw: FrameName | None = None
    """A name that stands in place of the scene's own identity wherever something is drawn. Scenes of the same draw and
    seed have the same clouds and, with the same camera name, the same noise: common random numbers, for comparing
    cameras and methods frame by frame.
    """


class CameraUse(Model):
    """Which camera, and how it is mounted in the body.

    The mounting turns body axes into camera axes: yaw about z, then pitch about y, then roll about x. Where the camera
    has heads it turns body axes into those of the housing, and the head's own angles turn these into camera axes.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"head"})

    file: str
    """Name of a shipped camera (`horizonval list cameras`), or the path of a camera file; a relative path starts from
    the folder of this file.
    """
    head: PlainName | None = None
    """Name of one of the camera file's `[[head]]` tables, or `"all"` for one frame per head, named `<scene>.<head>`.
    Without the key a suite's frame does the same, and a scene file asks for a choice.
    """
    mount_yaw_deg: Angle = 0.0
    """Yaw of the mounting, about z."""
    mount_pitch_deg: Angle = 0.0
    """Pitch of the mounting, about y."""
    mount_roll_deg: Angle = 0.0
    """Roll of the mounting, about x."""


class Platform(Model):
    """Where the satellite is, and when."""

    epoch_utc: datetime = datetime(2026, 3, 20, 12, 0, 0, tzinfo=UTC)
    """Date and time, UTC; years 1960 to 2099. It decides where Sun and Moon are, the season and the local time."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    """Geodetic latitude of the satellite."""
    longitude_deg: Angle = 0.0
    """Longitude of the satellite, positive to the east."""
    altitude_km: Annotated[float, Field(gt=0, le=2_000_000)]
    """Geodetic altitude: height above the ellipsoid, or above the sphere."""
    heading_deg: Angle = 0.0
    """Geocentric azimuth of the velocity, from north towards east, in the plane across the line to the Earth's centre
    (the azimuth in the geodetic level plane differs by up to half an arcsecond). It says where x of lvlh points."""

    @field_validator("epoch_utc")
    @classmethod
    def _utc(cls, value: datetime) -> datetime:
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class Attitude(Model):
    """Body against lvlh (x to the velocity, z to the geocentric nadir): yaw about z, then pitch about y, then roll
    about x.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"rate_deg_s", "hold"})

    yaw_deg: Angle = 0.0
    """Yaw, about z."""
    pitch_deg: Angle = 0.0
    """Pitch, about y."""
    roll_deg: Angle = 0.0
    """Roll, about x."""
    rate_deg_s: Annotated[tuple[Finite, Finite, Finite], Listed] = (0.0, 0.0, 0.0)
    """Angular velocity of the body against lvlh, in body axes; it blurs exposures and slants rolling shutters."""
    hold: Literal["lvlh", "inertial"] = "lvlh"
    """What `rate_deg_s` is counted from: `lvlh`, or `inertial`, which adds the orbital rate (a body that is fixed among
    the stars).
    """


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


class Atmosphere(Model):
    """What the air is made of."""

    profile: str = "us_standard"
    """Temperature and gases by name (`horizonval list atmospheres`). `none` is no atmosphere at all.
    `by_latitude_month` blends the AFGL climates by latitude and month: thermal bands then have the air of every
    latitude in sight, solar bands one column for the whole frame, that of the point below the satellite.
    """
    profile_file: str | None = None
    """Temperature and gases from a CSV or JSON file beside this one, in place of `profile`; see
    `horizonval.earth.atmosphere.profile_file`.
    """
    file: str | None = None
    """Optical properties from a file in the format of the `radiance` command, in place of everything else here; a
    shipped name or a path. Its bands are named after the camera's bands.
    """
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """The climate of this latitude serves everywhere in all bands; for `profile = "by_latitude_month"`."""
    month: Annotated[int, Field(ge=1, le=12), unit("1")] | None = None
    """Month, 1 to 12, in place of the epoch's; for `profile = "by_latitude_month"`."""
    aerosol: Literal["none", "background", "volcanic_moderate", "volcanic_high"] = "none"
    """LOWTRAN7's particles. `none` is clean air and a third of the time, `background` haze of 23 km visibility at the
    ground below a quiet stratosphere, the others a stratosphere after an eruption. See
    `horizonval.earth.atmosphere.aerosol`.
    """
    ozone: bool = True
    """Whether ozone absorbs sunlight."""
    co2_ppm: Annotated[float, Field(ge=280, le=560)] = 420.0
    """Carbon dioxide of the lower atmosphere, for thermal bands only. The absorption tables stand at 330 and 420 ppm;
    see `horizonval.earth.spectral.thermal_absorption`.
    """
    refraction: bool = False
    """Whether the air bends light. The hard limb is then seen where that of a planet larger by n - 1 times its radius
    would be (1.77 km in visible light, 2.4 arcmin from 500 km); the frame's truth and its maps stay those of straight
    lines. A `file` must then have `refractivity`; there can be no clouds, and light scattered more than once is
    computed without refraction. With 128 nodes the march is within 0.5 % of its limit in bright pixels with the Sun up,
    0.9 % with the Sun 5 deg below the horizon, and 1.2 % and 4 % down to a thousandth of the brightest.
    """

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

    `uniform` is a Lambert ground of one albedo and one emissivity. `earth` has land, seasonal snow and an ocean that
    glints in the Sun, each with its own spectrum of albedo and emissivity, as warm as their latitude and month say,
    land with its day and night (`horizonval.earth.surface.surface_temperature`).
    """

    kind: Literal["uniform", "earth"] = "uniform"
    """`uniform` or `earth`; see above."""
    albedo: Fraction = 0.3
    """Share of the sunlight that the uniform ground reflects."""
    wind_speed_m_s: Annotated[float, Field(ge=0, le=40)] | None = None
    """Wind that roughens the ocean of `earth` for sunlight; 7 without the key."""
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
        return self


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


class SunOverride(Model):
    """Place the Sun by hand, seen from the point below the satellite; without this table the epoch decides."""

    zenith_deg: Annotated[float, Field(ge=0, le=180)]
    """Angle of the Sun from the zenith of the point below the satellite; above 90 it is below the horizon there."""
    azimuth_deg: Angle = 0.0
    """Azimuth of the Sun at that point, from north towards east."""


class Moon(Model):
    """The Moon. Its place comes from the epoch, or from `zenith_deg` and `azimuth_deg`, as the Sun's in `[sun]`.

    Where the Sun is placed by hand there is no Moon unless it is placed by hand too: that of the epoch would not fit.
    """

    enabled: bool = True
    """Whether there is a Moon."""
    zenith_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    """Angle of the Moon from the zenith of the point below the satellite; places it by hand."""
    azimuth_deg: Angle = 0.0
    """Azimuth of the Moon at that point, from north towards east; goes with `zenith_deg`."""


class Night(Model):
    """What shines where the Sun does not.

    Left out of frames in which the Sun is nowhere lower than 9 deg below the horizon, and moonlight also where the Moon
    is a thin crescent (within some 20 deg of the Sun). Thermal bands have none of it, and no Moon.
    """

    airglow: bool = True
    """Light that the upper air emits; needs air."""
    sky_background: bool = True
    """The sky behind everything."""
    moonlight: bool = True
    """Moonlight on ground and air."""


class RenderSettings(Model):
    """Accuracy of the march along each ray.

    With 128 nodes the march is within 0.3 % of its limit wherever a pixel has a twentieth of the brightest one's
    radiance, and within 1 % (in twilight 0.3 %, with particles 1.5 %) down to a thousandth, with the Sun at any height
    to 8 deg below the horizon.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"method"})

    method: Literal["table", "march"] = "table"
    """How sunlight is found in solar bands. `table` tabulates it over direction, once for all frames from one place
    under one Sun, and interpolates. `march` goes along the ray of every cell: the reference for the tables, at many
    times their cost. Thermal bands come from tables either way.
    """
    subsamples: Annotated[int, Field(ge=1, le=16), unit("1")] = 2
    """Rays per pixel along each axis; a pixel has the square of it."""
    nodes: Annotated[int, Field(ge=8, le=4096), unit("1")] = 128
    """Points along each ray at which air is looked up."""
    orders: Literal["single", "all"] = "all"
    """Orders of scattering of sunlight: `single`, or `all`."""
    band_error: Annotated[float, Field(ge=1e-4, le=0.1), unit("1")] = 0.012
    """Largest relative error of a solar band's radiance, from limb and ground under a high or a low Sun, that too few
    wavelengths may leave. It decides how many wavelengths a band gets that does not say so itself (`nodes` of the
    camera's band). With 1.2 % a band of 450 to 750 nm gets 4, and is within 0.4 % but where the Sun stands low; 0.3 %
    takes 6, and twice the time.
    """


class SceneSpec(Model):
    """One scene file: one camera, one pose, one planet, one instant."""

    scene: SceneName = SceneName()
    """Name and seed."""
    camera: CameraUse
    """Which camera, and its mounting. Every table of the camera file can be changed in place:
    `camera.detector.exposure_s`, and a band by its name, `camera.band.<name>.lo_um`.
    """
    platform: Platform
    """Where the satellite is."""
    attitude: Attitude = Attitude()
    """How the body is turned."""
    earth: Earth = Earth()
    """Shape of the planet."""
    atmosphere: Atmosphere = Atmosphere()
    """The air."""
    surface: Surface = Surface()
    """The ground."""
    clouds: Clouds | None = None
    """Clouds; none without this table."""
    sun: SunOverride | None = None
    """The Sun placed by hand."""
    moon: Moon = Moon()
    """The Moon."""
    night: Night = Night()
    """Light of the night."""
    render: RenderSettings = RenderSettings()
    """Accuracy of the rendering."""

    @model_validator(mode="after")
    def _clouds_lie_at_unbent_heights(self) -> SceneSpec:
        if self.atmosphere.refraction and self.clouds is not None:
            raise ValueError("clouds do not go with atmosphere.refraction; leave one of them out")
        return self
