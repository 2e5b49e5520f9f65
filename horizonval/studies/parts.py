"""What suites may ask for beside their frames."""

from __future__ import annotations

from horizonval.studies.stability.part import StabilityPart
from horizonval.suites.part import Part

PARTS: tuple[Part, ...] = (StabilityPart(),)
