"""Tables of a scene file that describe the Earth, its air, its clouds, and the lights."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Angle, Fraction, Model, Positive, unit


class Atmosphere(Model):
    """What the air is made of."""

    later_keys: ClassVar[frozenset[str]] = frozenset({"gases_in_sunlight", "halocarbons"})

    profile: str = "us_standard"
    """Temperature and gases by name (`horizonval list atmospheres`). `none` is no atmosphere at all.
    `by_latitude_month` blends the AFGL climates by latitude and month: rays then cross the air of every latitude
    in sight, over the poles colder below 8 km than any climate in thermal bands.
    `weather` draws the temperature, ozone and water vapour of one day over latitude, longitude and height, around the
    climate of the month; `weather:ec2008-12` and the like are real states, the same everywhere.
    """
    seed: Annotated[int, Field(ge=0, le=2**32 - 1), unit("1")] | None = None
    """Draws the weather; without the key the scene's name (or its `draw`) and seed do. For `profile = "weather"`."""
    warming_k: Annotated[float, Field(ge=0, le=80), unit("K")] | None = None
    """A sudden warming of the polar stratosphere in the winter hemisphere, by so much over the polar cap near 10 hPa; 0
    for none. Without the key it is drawn: one northern winter day in ten has one. For `profile = "weather"`.
    """
    profile_file: str | None = None
    """Temperature and gases from a CSV or JSON file next to this one, in place of `profile`: one profile everywhere,
    or with columns `latitude_deg` and `longitude_deg` those of up to 1000 places, blended between them. Rays then
    cross the air of every place in sight. See `horizonval.earth.atmosphere.profile_file`.
    """
    file: str | None = None
    """Optical properties from a file in the format of the `radiance` command, in place of everything else here; a
    shipped name or a path. Its bands are named after the camera's bands.
    """
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """The climate of this latitude serves everywhere in all bands; for `profile = "by_latitude_month"`."""
    month: Annotated[int, Field(ge=1, le=12), unit("1")] | None = None
    """Month, 1 to 12, in place of the epoch's; for `profile = "by_latitude_month"` and `"weather"`."""
    aerosol: Literal["none", "background", "volcanic_moderate", "volcanic_high", "polar", "dust"] = "background"
    """Particles, by models of LOWTRAN7: `background` is the Earth's mean haze below a quiet stratosphere,
    `volcanic_moderate` and `volcanic_high` have a stratosphere after an eruption, `polar` is clean air,
    `dust` desert dust up to 5 km; `none` is molecules alone, at half the time. Without the key air with gases of its
    own has the background, and `file` and `profile = "none"` have none. See `horizonval.earth.atmosphere.aerosol`.
    """
    aerosol_optical_depth_550nm: Annotated[float, Field(ge=0, le=5), unit("1")] | None = None
    """Optical depth at 550 nm, straight up, of the particles below 10 km, in place of the model's own (`background` and
    the volcanic ones 0.14, the Earth's mean; `polar` 0.13, `dust` 0.45). Open ocean far from land has 0.05 to 0.1, the
    seas' mean is 0.12, that of land 0.18, smoke and industry have 0.3 to 1. What lies higher stays.
    """
    ozone: bool = True
    """Whether ozone absorbs sunlight."""
    gases_in_sunlight: bool = True
    """Whether nitrogen dioxide absorbs sunlight, and oxygen and water vapour in bands that lose 3 % and more to them
    (red and near infrared): -7 % of 700 to 800 nm and -14 % of 750 to 950 nm on the way to the ground. Such bands get
    up to four spectral nodes more. See `horizonval.earth.gases.sunlight_absorption` and `nitrogen_dioxide`.
    """
    co2_ppm: Annotated[float, Field(ge=280, le=560)] = 420.0
    """Carbon dioxide of the lower atmosphere, for thermal bands only; the file of a `profile_file` may have its own."""
    halocarbons: bool = True
    """Whether CFC-11, CFC-12, HCFC-22 and CCl4 absorb in thermal bands, in today's amounts whatever the epoch: +10 % of
    the 8 to 14 um limb at 10 km, +80 % of 10.5 to 12.5 um. See `horizonval.earth.gases.gas_state`.
    """
    refraction: bool | None = None
    """Whether the air bends light. Without the key it does where its index is known: not with a `file` without
    `refractivity`, and not with `profile = "none"`. The hard limb then appears 1.77 km higher in visible light (2.4
    arcmin from 500 km). The frame's truth has both horizons; its maps are those of straight lines. Light scattered more
    than once is computed without refraction.
    """

    @model_validator(mode="after")
    def _consistent(self) -> Atmosphere:
        if self.file is not None and self.profile_file is not None:
            raise ValueError("give at most one of file and profile_file")
        if "aerosol" not in self.model_fields_set and (self._airless or self.file is not None):
            # what has no gases of its own has no haze of its own either; the key stays unset
            self.__dict__["aerosol"] = "none"
        if self._airless and self.aerosol != "none":
            raise ValueError(f'aerosol = "{self.aerosol}" needs air, but profile = "none"; set aerosol = "none"')
        if self.file is not None and self.aerosol != "none":
            raise ValueError(
                f'aerosol = "{self.aerosol}" does not go with file, which holds all that scatters; set aerosol = "none"'
            )
        if self.aerosol_optical_depth_550nm is not None and self.aerosol == "none":
            raise ValueError(
                "aerosol_optical_depth_550nm needs particles; name a model in aerosol, or leave the key out"
            )
        if self.co2_ppm != 420.0 and (self.file is not None or self._airless):
            raise ValueError('co2_ppm applies to an atmosphere with gases of its own, not to file or profile = "none"')
        by_place = self.profile == "by_latitude_month" and self.profile_file is None and self.file is None
        if not self.halocarbons and (self.file is not None or self._airless):
            raise ValueError('halocarbons applies to air with gases of its own, not to file or profile = "none"')
        own = self.profile_file is None and self.file is None
        weather = own and self.profile == "weather"
        if self.latitude_deg is not None and not by_place:
            raise ValueError('latitude_deg applies to profile = "by_latitude_month" only')
        if self.month is not None and not (by_place or weather):
            raise ValueError('month applies to profile = "by_latitude_month" and "weather" only')
        for key in ("seed", "warming_k"):
            if getattr(self, key) is not None and not weather:
                raise ValueError(f'{key} applies to profile = "weather" only')
        return self

    @property
    def _airless(self) -> bool:
        return self.profile_file is None and self.file is None and self.profile == "none"


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
    (`horizonval.earth.surface.surface_temperature`). `chequered` is a test target: squares of two albedos by turns
    between parallels and meridians (`horizonval.earth.surface.ground_map`), in thermal bands as `uniform`.
    """

    kind: Literal["uniform", "earth", "chequered"] = "uniform"
    """`uniform`, `earth` or `chequered`; see above."""
    albedo: Fraction = 0.3
    """Share of the sunlight that the uniform ground reflects, or every other square."""
    albedo_other: Fraction | None = None
    """Share that the squares between reflect; `chequered` needs it."""
    square_km: Annotated[float, Field(ge=1, le=20_000)] | None = None
    """Side of the squares; `chequered` needs it."""
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
            raise ValueError('albedo applies to kind = "uniform" and "chequered" only')
        if self.kind == "earth" and "emissivity" in self.model_fields_set:
            raise ValueError('emissivity applies to kind = "uniform" and "chequered" only')
        for key in ("albedo_other", "square_km"):
            if self.kind == "chequered" and getattr(self, key) is None:
                raise ValueError(f'kind = "chequered" needs {key}')
            if self.kind != "chequered" and getattr(self, key) is not None:
                raise ValueError(f'{key} applies to kind = "chequered" only')
        if self.kind != "earth" and self.wind_speed_m_s is not None:
            raise ValueError('wind_speed_m_s applies to kind = "earth" only')
        if self.kind != "earth" and self.city_lights:
            raise ValueError('city_lights applies to kind = "earth" only')
        return self


FINEST_ICE_UM = 0.02
MAX_ICE_UM, MAX_WATER_UM, MIN_WATER_UM = 60.0, 30.0, 4.0
FINE_ICE_UM, COARSE_ICE_UM = 0.2, 10.0


class CloudLayer(Model):
    """Thin cloud: a shell of particles that light goes through. Opaque clouds are in `[clouds]`.

    Every key but `kind` has a value by the kind (`horizonval.earth.clouds.layers` has them with their sources),
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
