"""The ``[detector]`` table of camera files: CMOS and CCD arrays, and detectors of thermal cameras."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model, NonNegative, Positive, Whole, unit

ABSOLUTE_ZERO_C = -273.15
LONGEST_EXPOSURE_S = 3600.0


class AutoExposure(Model):
    """Exposure chosen by the camera: `percentile` of the pixels stay below `target` of the full well.

    It is found from the expected image and takes the place of `exposure_s`.
    """

    target: Annotated[float, Field(gt=0, le=1), unit("1")] = 0.7
    """Share of the full well."""
    percentile: Annotated[float, Field(gt=0, le=100), unit("%")] = 99.0
    """Percentage of the pixels that stay below the target."""
    min_s: Positive
    """Shortest exposure."""
    max_s: Annotated[float, Field(gt=0, le=LONGEST_EXPOSURE_S)]
    """Longest exposure."""

    @model_validator(mode="after")
    def _range(self) -> AutoExposure:
        if self.max_s < self.min_s:
            raise ValueError(f"max_s = {self.max_s:g} must not be below min_s = {self.min_s:g}")
        return self


class Radiation(Model):
    """Protons that cross the array while it integrates or is read, leaving streaks."""

    flux_per_cm2_s: Annotated[float, Field(ge=0, le=1e7)]
    """Omnidirectional flux behind the shielding in the middle of the South Atlantic anomaly; elsewhere it falls off as
    `horizonval.sensor.detector.protons` says.
    """
    depth_um: Annotated[float, Field(gt=0, le=1000)] = 5.0
    """Thickness of the layer that collects charge."""
    charge_e_per_um: Annotated[float, Field(gt=0, le=1e6)] = 400.0
    """Mean charge that a proton frees on its way."""


class Cmos(Model):
    """Visible CMOS or CCD array.

    Dark current holds at `dark_reference_c` and doubles every `dark_doubling_k`; without the two temperatures it holds
    as it is.
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
    """A visible CMOS or CCD array."""
    pixel_pitch_um: Annotated[float, Field(ge=0.1, le=1000)]
    """Distance of two pixels."""
    exposure_s: Annotated[float, Field(gt=0, le=LONGEST_EXPOSURE_S)]
    """Integration time."""
    quantum_efficiency: Annotated[float, Field(gt=0, le=1), unit("1")]
    """Peak of the quantum efficiency curve, whose shape the band has: electrons per photon."""
    full_well_e: Annotated[float, Field(gt=0, le=1e12)]
    """Charge that a pixel holds."""
    read_noise_e: NonNegative
    """Standard deviation of the read-out."""
    dark_current_e_per_s: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    """Dark current of a pixel."""
    bits: Annotated[int, Field(ge=1, le=16), unit("1")]
    """Bits of the converter."""
    black_level_dn: NonNegative = 0.0
    """Digital number of no light."""
    gain_e_per_dn: Positive | None = None
    """Electrons per digital number; without the key a full well is the largest digital number."""
    temperature_c: Annotated[float, Field(ge=ABSOLUTE_ZERO_C, le=200)] | None = None
    """Temperature of the array; goes with `dark_reference_c`."""
    dark_reference_c: Annotated[float, Field(ge=ABSOLUTE_ZERO_C, le=200)] | None = None
    """Temperature at which the dark current holds."""
    dark_doubling_k: Annotated[float, Field(ge=1, le=100)] = 8.0
    """Warming that doubles the dark current."""
    prnu: Annotated[float, Field(ge=0, lt=0.3), unit("1")] = 0.0
    """Standard deviation of the pixels' response, relative."""
    dsnu_e: NonNegative = 0.0
    """Standard deviation of what pixels show in the dark, at the exposure in use."""
    hot_pixel_fraction: Annotated[float, Field(ge=0, le=0.1), unit("1")] = 0.0
    """Share of pixels with a higher dark current."""
    hot_pixel_e_per_s: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    """Mean of what hot pixels have more; exponentially distributed."""
    serial: Whole = 0
    """Number of the unit: each unit of a kind has its own pattern."""
    blooming: Literal["none", "column"] = "none"
    """What becomes of charge beyond the full well: lost (`none`, an array with drains), or it runs along the columns
    (`column`).
    """
    shutter: Literal["global", "rolling", "frame_transfer"] = "global"
    """`global`; `rolling`: rows exposed one `row_time_s` after the other, the frame's pose being that of the middle of
    the image; `frame_transfer`: a CCD whose charge takes `row_time_s` per row to its storage and is smeared on the way.
    """
    row_time_s: Annotated[float, Field(gt=0, le=1)] | None = None
    """Time of one row; for shutters other than `global`."""
    bayer: Annotated[str, Field(pattern="^(RGGB|BGGR|GRBG|GBRG)$")] | None = None
    """Colours of the upper left 2 x 2 pixels, such as `RGGB`. The camera then has three bands whose names begin with r,
    g and b, and an image of a band is interpolated from that band's pixels.
    """
    auto_exposure: AutoExposure | None = None
    """Exposure chosen by the camera."""
    radiation: Radiation | None = None
    """Protons; none without this table."""

    @model_validator(mode="after")
    def _temperatures(self) -> Cmos:
        if (self.temperature_c is None) != (self.dark_reference_c is None):
            raise ValueError("temperature_c and dark_reference_c go together: give both or neither")
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


class ThermalDetector(Model):
    """What all detectors that warm up have in common.

    The drift since the last shutter correction is `minutes_since_correction` times `drift_k_per_min` for all pixels
    together, and times `drift_pattern_k_per_min` for each by itself (rms).
    """

    later_keys: ClassVar[frozenset[str]] = frozenset(
        {
            "time_constant_s",
            "response_fwhm_px",
            "responsivity_rms",
            "residue_k",
            "drift_k_per_min",
            "drift_pattern_k_per_min",
            "minutes_since_correction",
            "serial",
            "netd_band",
        }
    )

    pixel_pitch_um: Annotated[float, Field(ge=0.1, le=1e5)]
    """Distance of two pixels."""
    bits: Annotated[int, Field(ge=1, le=16), unit("1")]
    """Bits of the converter."""
    scene_min_k: NonNegative = 0.0
    """Black body whose radiance is the lower end of the converter."""
    scene_max_k: Positive = 400.0
    """Black body whose radiance is the upper end of the converter."""
    time_constant_s: Annotated[float, Field(ge=0, le=LONGEST_EXPOSURE_S)] = 0.0
    """How long a pixel takes to follow; with a turning camera it drags the image."""
    response_fwhm_px: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Full width of each pixel's own angular response beyond the lens's blur."""
    responsivity_rms: Annotated[float, Field(ge=0, lt=0.3), unit("1")] = 0.0
    """Spread of the pixels' responsivity after correction, relative."""
    residue_k: NonNegative = 0.0
    """Spread of the offsets that the last shutter correction left, at 300 K."""
    drift_k_per_min: NonNegative = 0.0
    """Drift of all pixels together since the last correction."""
    drift_pattern_k_per_min: NonNegative = 0.0
    """Drift of each pixel by itself since the last correction (rms)."""
    minutes_since_correction: Annotated[NonNegative, unit("min")] = 0.0
    """Time since the last shutter correction."""
    serial: Whole = 0
    """Number of the unit: each unit of a kind has its own pattern."""
    netd_band: str | None = None
    """Band in which all these temperature differences were measured: behind another filter noise and offsets are the
    same power, and a larger temperature difference the less the filter lets through. Without the key they are those of
    every band.
    """

    @model_validator(mode="after")
    def _range(self) -> ThermalDetector:
        if self.scene_max_k <= self.scene_min_k:
            raise ValueError(f"scene_max_k = {self.scene_max_k} must be above scene_min_k = {self.scene_min_k}")
        return self


class Microbolometer(ThermalDetector):
    """Uncooled infrared array."""

    later_keys: ClassVar[frozenset[str]] = ThermalDetector.later_keys | {"netd_f_number"}

    kind: Literal["microbolometer"] = "microbolometer"
    """An uncooled infrared array."""
    netd_k: Positive
    """Noise-equivalent temperature difference of a 300 K scene through a lens of `netd_f_number` without losses; it
    grows with the f-number squared.
    """
    netd_f_number: Annotated[Positive, unit("1")] = 1.0
    """F-number of that lens."""


class Thermopile(ThermalDetector):
    """Array of thermopiles behind its own small lens."""

    kind: Literal["thermopile"] = "thermopile"
    """An array of thermopiles behind its own small lens."""
    netd_k: Positive
    """Noise-equivalent temperature difference of the whole module for a 300 K scene, its lens and its filter included:
    `[optics]` does not change it.
    """


class LinearArray(ThermalDetector):
    """A row of bolometers, or of pyroelectric elements behind a chopper, which see the scene and the chopper in turn.

    Noise is given as `netd_k`, or as `d_star_cm_rthz_per_w` with `bandwidth_hz`.
    """

    later_keys: ClassVar[frozenset[str]] = ThermalDetector.later_keys

    kind: Literal["linear"] = "linear"
    """A row of bolometers or of pyroelectric elements."""
    sensing: Literal["bolometer", "pyroelectric"] = "bolometer"
    """Bolometers, or pyroelectric elements behind a chopper."""
    netd_k: Positive | None = None
    """Noise-equivalent temperature difference of a 300 K scene through a lens of `netd_f_number`."""
    netd_f_number: Annotated[Positive, unit("1")] = 1.0
    """F-number of that lens."""
    d_star_cm_rthz_per_w: Positive | None = None
    """Detectivity, in place of `netd_k`."""
    bandwidth_hz: Positive | None = None
    """Bandwidth of the read-out; goes with the detectivity."""

    @model_validator(mode="after")
    def _one_noise(self) -> LinearArray:
        if (self.netd_k is None) == (self.d_star_cm_rthz_per_w is None):
            raise ValueError("give exactly one of netd_k and d_star_cm_rthz_per_w")
        if (self.d_star_cm_rthz_per_w is None) != (self.bandwidth_hz is None):
            raise ValueError("d_star_cm_rthz_per_w and bandwidth_hz go together: give both or neither")
        return self


__all__ = ["Cmos", "Detector", "LinearArray", "Microbolometer", "ThermalDetector", "Thermopile"]

Detector = Annotated[Cmos | Microbolometer | Thermopile | LinearArray, Field(discriminator="kind")]
