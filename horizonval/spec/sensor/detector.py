"""The ``[detector]`` table of camera files: what becomes of the light."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from horizonval.spec.sensor.cmos import Cmos
from horizonval.spec.sensor.thermal_detector import LinearArray, Microbolometer, ThermalDetector, Thermopile

__all__ = ["Cmos", "Detector", "LinearArray", "Microbolometer", "ThermalDetector", "Thermopile"]

Detector = Annotated[Cmos | Microbolometer | Thermopile | LinearArray, Field(discriminator="kind")]
