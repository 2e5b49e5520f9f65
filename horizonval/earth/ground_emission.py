"""What the ground and the clouds emit: temperature and emissivity, plain data that survives JSON bit by bit.

The temperature of land follows the Sun through the day: ``T = land_k + diurnal_k cos(H - lag)`` with H the hour angle
of the Sun at the place (0 at noon) and ``lag`` :data:`LAG_RAD`; the sea and snow keep theirs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

LAG_RAD = math.radians(22.5)
"""The ground is warmest an hour and a half after noon."""


@dataclass(frozen=True)
class GroundEmission:
    """Temperature and emissivity of everything a ray can end on.

    Attributes
    ----------
    kind : "uniform" or "earth"
    sin_latitude : tuple of float, length k
        Rising in equal steps from -1 to 1. All temperatures below are linear between.
    land_k, snow_k, water_k : tuple of float, length k
        Daily mean temperature of land, of land under snow, of the sea. Equal for a uniform ground.
    diurnal_k : tuple of float, length k
        Amplitude of the daily swing of land.
    emissivity : float
        Of a uniform ground.
    cloud_emissivity : float
        Of cloud tops, which are as warm as the air there; what they do not emit they let through from below.
    """

    kind: str
    sin_latitude: tuple[float, ...]
    land_k: tuple[float, ...]
    snow_k: tuple[float, ...]
    water_k: tuple[float, ...]
    diurnal_k: tuple[float, ...]
    emissivity: float
    cloud_emissivity: float


def uniform_ground(temperature_k: float, emissivity: float, cloud_emissivity: float = 1.0) -> GroundEmission:
    """Return a ground that is the same everywhere and at all hours."""
    same = (temperature_k, temperature_k)
    return GroundEmission("uniform", (-1.0, 1.0), same, same, same, (0.0, 0.0), emissivity, cloud_emissivity)
