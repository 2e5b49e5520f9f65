"""The ``[detector]`` table of camera files: what becomes of the light."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import NonNegative, Positive


class Cmos(Model):
    """Visible CMOS or CCD. Peak of the quantum efficiency curve is ``quantum_efficiency``."""

    kind: Literal["cmos"] = "cmos"
    pixel_pitch_um: Positive
    exposure_s: Positive
    quantum_efficiency: Annotated[float, Field(gt=0, le=1)]
    full_well_e: Positive
    read_noise_e: NonNegative
    dark_current_e_per_s: NonNegative = 0.0
    bits: Annotated[int, Field(ge=1, le=16)]
    black_level_dn: NonNegative = 0.0
    gain_e_per_dn: Positive | None = None


class Microbolometer(Model):
    """Uncooled infrared array.

    ``netd_k`` is the noise-equivalent temperature difference of a 300 K scene at f/1, and grows with f-number squared.
    ``netd_band`` names the band it was measured in: behind another filter the detector's noise is the same power, and
    a larger temperature difference the less the filter lets through. Left out, ``netd_k`` is that of every band. The
    converter spans the radiances of black bodies between ``scene_min_k`` and ``scene_max_k``.
    """

    kind: Literal["microbolometer"] = "microbolometer"
    pixel_pitch_um: Positive
    netd_k: Positive
    netd_band: str | None = None
    bits: Annotated[int, Field(ge=1, le=16)]
    scene_min_k: NonNegative = 0.0
    scene_max_k: Positive = 400.0

    @model_validator(mode="after")
    def _range(self) -> Microbolometer:
        if self.scene_max_k <= self.scene_min_k:
            raise ValueError(f"scene_max_k = {self.scene_max_k} must be above scene_min_k = {self.scene_min_k}")
        return self


Detector = Annotated[Cmos | Microbolometer, Field(discriminator="kind")]
