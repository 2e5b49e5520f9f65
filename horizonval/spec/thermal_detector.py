"""``[detector]`` tables of thermal cameras."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from horizonval.spec.base import Model
from horizonval.spec.numbers import NonNegative, Positive


class Microbolometer(Model):
    """Uncooled infrared array.

    ``netd_k`` is the noise-equivalent temperature difference of a 300 K scene at f/1, and grows with f-number squared.
    The converter spans the radiances of black bodies between ``scene_min_k`` and ``scene_max_k``.
    """

    kind: Literal["microbolometer"] = "microbolometer"
    pixel_pitch_um: Positive
    netd_k: Positive
    bits: Annotated[int, Field(ge=1, le=16)]
    scene_min_k: NonNegative = 0.0
    scene_max_k: Positive = 400.0

    @model_validator(mode="after")
    def _range(self) -> Microbolometer:
        if self.scene_max_k <= self.scene_min_k:
            raise ValueError(f"scene_max_k = {self.scene_max_k} must be above scene_min_k = {self.scene_min_k}")
        return self
