"""How the height of the visible limb varies along it: measured on rendered limbs, for estimators and their judges."""

from __future__ import annotations

from dataclasses import dataclass


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
