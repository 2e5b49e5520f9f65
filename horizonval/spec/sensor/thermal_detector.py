"""``[detector]`` tables of thermal cameras: microbolometers, thermopiles, linear arrays."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import NonNegative, Positive


class ThermalDetector(Model):
    """What all detectors that warm up have in common.

    The converter spans the radiances of black bodies between ``scene_min_k`` and ``scene_max_k``.

    ``time_constant_s``: how long a pixel takes to follow; with a turning camera it drags the image.
    ``response_fwhm_px``: full width of each pixel's own angular response beyond the lens's blur, in pixels.

    Pixels differ after correction: ``responsivity_rms`` (relative), ``residue_k`` (rms offset that the last shutter
    correction left, at 300 K), and since then ``drift_k_per_min`` times ``minutes_since_correction`` for all pixels
    together and ``drift_pattern_k_per_min`` for each by itself (rms). ``serial`` numbers the units of a kind.

    ``netd_band`` names the band in which all these temperature differences were measured: behind another filter noise
    and offsets are the same power, and a larger temperature difference the less the filter lets through. Left out, they
    are those of every band.
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
    bits: Annotated[int, Field(ge=1, le=16)]
    scene_min_k: NonNegative = 0.0
    scene_max_k: Positive = 400.0
    time_constant_s: NonNegative = 0.0
    response_fwhm_px: Annotated[float, Field(ge=0, le=100)] = 0.0
    responsivity_rms: Annotated[float, Field(ge=0, lt=0.3)] = 0.0
    residue_k: NonNegative = 0.0
    drift_k_per_min: NonNegative = 0.0
    drift_pattern_k_per_min: NonNegative = 0.0
    minutes_since_correction: NonNegative = 0.0
    serial: Annotated[int, Field(ge=0)] = 0
    netd_band: str | None = None

    @model_validator(mode="after")
    def _range(self) -> ThermalDetector:
        if self.scene_max_k <= self.scene_min_k:
            raise ValueError(f"scene_max_k = {self.scene_max_k} must be above scene_min_k = {self.scene_min_k}")
        return self


class Microbolometer(ThermalDetector):
    """Uncooled infrared array.

    ``netd_k`` is the noise-equivalent temperature difference of a 300 K scene through a lens of ``netd_f_number``
    (without losses), and grows with f-number squared.
    """

    later_keys: ClassVar[frozenset[str]] = ThermalDetector.later_keys | {"netd_f_number"}

    kind: Literal["microbolometer"] = "microbolometer"
    netd_k: Positive
    netd_f_number: Positive = 1.0


class Thermopile(ThermalDetector):
    """Array of thermopiles behind its own small lens.

    ``netd_k`` is that of the whole module for a 300 K scene, its lens and its filter included: the ``[optics]`` do not
    change it.
    """

    kind: Literal["thermopile"] = "thermopile"
    netd_k: Positive


class LinearArray(ThermalDetector):
    """A row of bolometers, or of pyroelectric elements behind a chopper, which see the scene and the chopper in turn.

    Noise as ``netd_k`` of a 300 K scene through a lens of ``netd_f_number``, or as detectivity
    ``d_star_cm_rthz_per_w`` with the read-out's ``bandwidth_hz``.
    """

    later_keys: ClassVar[frozenset[str]] = ThermalDetector.later_keys

    kind: Literal["linear"] = "linear"
    sensing: Literal["bolometer", "pyroelectric"] = "bolometer"
    netd_k: Positive | None = None
    netd_f_number: Positive = 1.0
    d_star_cm_rthz_per_w: Positive | None = None
    bandwidth_hz: Positive | None = None

    @model_validator(mode="after")
    def _one_noise(self) -> LinearArray:
        if (self.netd_k is None) == (self.d_star_cm_rthz_per_w is None):
            raise ValueError("give exactly one of netd_k and d_star_cm_rthz_per_w")
        if (self.d_star_cm_rthz_per_w is None) != (self.bandwidth_hz is None):
            raise ValueError("d_star_cm_rthz_per_w and bandwidth_hz go together: give both or neither")
        return self
