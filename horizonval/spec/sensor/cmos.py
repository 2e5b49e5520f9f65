"""``[detector]`` tables of visible CMOS and CCD arrays."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import NonNegative, Positive

ABSOLUTE_ZERO_C = -273.15
LONGEST_EXPOSURE_S = 3600.0


class AutoExposure(Model):
    """Exposure chosen by the camera: ``percentile`` of the pixels stay below ``target`` of the full well.

    It is found from the expected image, between ``min_s`` and ``max_s``, and takes the place of ``exposure_s``.
    """

    target: Annotated[float, Field(gt=0, le=1)] = 0.7
    percentile: Annotated[float, Field(gt=0, le=100)] = 99.0
    min_s: Positive
    max_s: Annotated[float, Field(gt=0, le=LONGEST_EXPOSURE_S)]

    @model_validator(mode="after")
    def _range(self) -> AutoExposure:
        if self.max_s < self.min_s:
            raise ValueError(f"max_s = {self.max_s:g} must not be below min_s = {self.min_s:g}")
        return self


class Radiation(Model):
    """Protons that cross the array while it integrates or is read, leaving streaks.

    ``flux_per_cm2_s`` is the omnidirectional flux behind the shielding in the middle of the South Atlantic anomaly;
    elsewhere it falls off as :mod:`horizonval.sensor.detector.protons` says. ``depth_um`` is the layer that collects
    charge, ``charge_e_per_um`` the mean charge that a proton frees on its way.
    """

    flux_per_cm2_s: Annotated[float, Field(ge=0, le=1e7)]
    depth_um: Annotated[float, Field(gt=0, le=1000)] = 5.0
    charge_e_per_um: Annotated[float, Field(gt=0, le=1e6)] = 400.0


class Cmos(Model):
    """Visible CMOS or CCD. Peak of the quantum efficiency curve is ``quantum_efficiency``.

    What a pixel collects: ``full_well_e``; what is beyond is lost (``blooming = "none"``, an array with drains) or
    runs along the columns (``"column"``).

    ``dark_current_e_per_s`` holds at ``dark_reference_c`` and doubles every ``dark_doubling_k``; the array is at
    ``temperature_c``. Without the two temperatures it holds as it is.

    Pixels differ: by ``prnu`` in response (rms, relative), by ``dsnu_e`` in what they show in the dark (rms, at the
    exposure in use), and ``hot_pixel_fraction`` of them have a dark current that is higher by an exponentially
    distributed amount of mean ``hot_pixel_e_per_s``. ``serial`` numbers the units of a kind: each has its own pattern.

    ``shutter``: ``global``; ``rolling``, rows exposed one ``row_time_s`` after the other, the frame's pose being that
    of the middle of the image; ``frame_transfer``, a CCD whose charge takes ``row_time_s`` per row to its storage and
    is smeared on the way.

    ``bayer``: colours of the upper left 2 x 2 pixels, such as ``RGGB``. The camera then has three bands whose names
    begin with r, g and b, and an image of a band is interpolated from that band's pixels.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset(
        {
            "temperature_c",
            "dark_reference_c",
            "dark_doubling_k",
            "prnu",
            "dsnu_e",
            "hot_pixel_fraction",
            "hot_pixel_e_per_s",
            "serial",
            "blooming",
            "shutter",
            "row_time_s",
            "bayer",
            "auto_exposure",
            "radiation",
        }
    )

    kind: Literal["cmos"] = "cmos"
    pixel_pitch_um: Annotated[float, Field(ge=0.1, le=1000)]
    exposure_s: Annotated[float, Field(gt=0, le=LONGEST_EXPOSURE_S)]
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    full_well_e: Annotated[float, Field(gt=0, le=1e12)]
    read_noise_e: NonNegative
    dark_current_e_per_s: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    bits: Annotated[int, Field(ge=1, le=16)]
    black_level_dn: NonNegative = 0.0
    gain_e_per_dn: Positive | None = None
    temperature_c: Annotated[float, Field(ge=ABSOLUTE_ZERO_C, le=200)] | None = None
    dark_reference_c: Annotated[float, Field(ge=ABSOLUTE_ZERO_C, le=200)] | None = None
    dark_doubling_k: Annotated[float, Field(ge=1, le=100)] = 8.0
    prnu: Annotated[float, Field(ge=0, lt=0.3)] = 0.0
    dsnu_e: NonNegative = 0.0
    hot_pixel_fraction: Annotated[float, Field(ge=0, le=0.1)] = 0.0
    hot_pixel_e_per_s: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    serial: Annotated[int, Field(ge=0)] = 0
    blooming: Literal["none", "column"] = "none"
    shutter: Literal["global", "rolling", "frame_transfer"] = "global"
    row_time_s: Annotated[float, Field(gt=0, le=1)] | None = None
    bayer: Annotated[str, Field(pattern="^(RGGB|BGGR|GRBG|GBRG)$")] | None = None
    auto_exposure: AutoExposure | None = None
    radiation: Radiation | None = None

    @model_validator(mode="after")
    def _temperatures(self) -> Cmos:
        if (self.temperature_c is None) != (self.dark_reference_c is None):
            raise ValueError(
                f"temperature_c = {self.temperature_c} and dark_reference_c = {self.dark_reference_c} go together: "
                "give both or neither"
            )
        return self

    @model_validator(mode="after")
    def _row_time(self) -> Cmos:
        if (self.shutter == "global") != (self.row_time_s is None):
            given = "is missing" if self.row_time_s is None else f"= {self.row_time_s:g} has no use"
            raise ValueError(f'row_time_s {given} with shutter = "{self.shutter}"')
        return self

    @model_validator(mode="after")
    def _black_below_white(self) -> Cmos:
        white = 2**self.bits - 1
        if self.black_level_dn >= white:
            raise ValueError(
                f"black_level_dn = {self.black_level_dn:g} must be below {white}, the largest number of "
                f"bits = {self.bits}"
            )
        return self

    @model_validator(mode="after")
    def _bits_within_the_full_well(self) -> Cmos:
        numbers = 2**self.bits - 1
        if self.gain_e_per_dn is None and self.full_well_e < numbers - self.black_level_dn:
            raise ValueError(
                f"bits = {self.bits} gives {numbers} steps, more than the electrons of full_well_e = "
                f"{self.full_well_e:g}; mend one of them, or give gain_e_per_dn if the converter is that fine"
            )
        return self

    @model_validator(mode="after")
    def _converter_reaches_the_full_well(self) -> Cmos:
        if self.gain_e_per_dn is None:
            return self
        span_e = self.gain_e_per_dn * (2**self.bits - 1 - self.black_level_dn)
        if span_e > 20.0 * self.full_well_e:
            raise ValueError(
                f"gain_e_per_dn = {self.gain_e_per_dn:g} spans {span_e:g} electrons, 20 times full_well_e = "
                f"{self.full_well_e:g} and more; is it a gain in dn per electron?"
            )
        return self
