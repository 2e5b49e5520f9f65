"""``[detector]`` tables of thermal cameras: microbolometers, thermopiles, linear arrays."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import NonNegative, Positive, Whole
from horizonval.spec.units import unit


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
    time_constant_s: NonNegative = 0.0
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
