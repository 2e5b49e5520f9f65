"""The air of a scene file."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.units import unit


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
    """Temperature and gases from a CSV or JSON file beside this one, in place of `profile`: one profile for everywhere,
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
    the 8 to 14 um limb at 10 km, +80 % of 10.5 to 12.5 um. See `horizonval.earth.gases.halocarbons`.
    """
    refraction: bool | None = None
    """Whether the air bends light. Without the key it does where its index is known: not with a `file` without
    `refractivity`, and not with `profile = "none"`. The hard limb is then seen where that of a planet larger by n - 1
    times its radius would be (1.77 km in visible light, 2.4 arcmin from 500 km). The frame's truth has both horizons;
    its maps are those of straight lines. Light scattered more than once is computed without refraction. With 128 nodes
    the march is within 0.5 % of its limit in bright pixels with the Sun up, 0.9 % with the Sun 5 deg below the horizon,
    and 1.2 % and 4 % down to a thousandth of the brightest.
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
