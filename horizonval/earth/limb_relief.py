"""How the height of the visible limb varies along it: measured on rendered limbs, for estimators and their judges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Relief:
    """Height of the limb as a random function of azimuth: standard deviation [m], correlation length [rad]."""

    sigma_m: float
    correlation_rad: float


SOLAR_RELIEF = (Relief(250.0, 0.3), Relief(300.0, 0.05))
"""Of the steepest place of the sunlit limb, Sun at 0 to 85 deg from the zenith: a slow change with the Sun's angle
along the arc, and clouds."""

THERMAL_RELIEF = (Relief(800.0, 0.4), Relief(300.0, 0.05))
"""Of the infrared limb, which follows the temperature of the stratosphere from latitude to latitude."""

CLOUD_RELIEF_SOLAR = Relief(600.0, 0.05)
"""What clouds at the limb add to it in sunlight."""

CLOUD_RELIEF_THERMAL = Relief(2500.0, 0.05)
"""What clouds at the limb add to it in window bands, which see their tops; carbon dioxide bands do not."""

SOLAR_HEIGHT_M = (-2e3, 40e3)
THERMAL_HEIGHT_M = (-2e3, 70e3)


def reliefs(band_kind: Literal["solar", "thermal"] | None) -> tuple[Relief, ...]:
    """Return how the limb's height varies along it; the larger one where the band is not known."""
    return SOLAR_RELIEF if band_kind == "solar" else THERMAL_RELIEF


def limb_height_m(band_kind: Literal["solar", "thermal"] | None) -> tuple[float, float]:
    """Return the lowest and the highest that the visible limb stands above a sphere of the mean radius, air alone."""
    return SOLAR_HEIGHT_M if band_kind == "solar" else THERMAL_HEIGHT_M
