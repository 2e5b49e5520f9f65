r"""The design for 350 km: where the fields lie, how wide they are, one gain, one zero, one range; no other altitude.

*Place.* A's middle stands where a level body sees the raised ellipsoid on average; the height is where the mean profile
has half of its plateau.

*Width.* The narrowest field in which the limb stays on the straight part of the curve. To either side it must hold a
tilt of 1 deg in both axes (sqrt 2 in a quadrant at 45 deg), 10 km of altitude with what they move the limb, and half of
the limb itself, from 90 to 10 % of its plateau::

    w / 2 = sqrt(2) tilt + |d eta / d h| dh + (eta_10 - eta_90) / 2

*Gain and zero.* The fields are moved by half a degree either way over level bodies: that is the slope.

*Range.* A quadrant whose limb stands farther from the middle than tilt and altitude need has no calibration there, and
is not used.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import WGS84
from horizonval.systems.g.layout import Processing, QuadrantLayout
from horizonval.systems.g.profiles import OFFSET_DEG, expected_limb
from horizonval.systems.weather_viewpoints import WeatherPlace

DESIGN_KM = 350.0
TILT_RAD, ALTITUDE_RANGE_M = math.radians(1.0), 10e3
SHIFT_RAD = math.radians(0.5)
PLATEAU_DEG = (-3.0, -0.3)


@dataclass(frozen=True)
class MeanLimb:
    """Of all level profiles at the design altitude.

    Attributes
    ----------
    height_m : float
        Of half the plateau.
    plateau : float
        W m-2 sr-1.
    half_rad : float
        Half of the angle between 90 and 10 % of the plateau.
    """

    height_m: float
    plateau: float
    half_rad: float


@dataclass(frozen=True)
class QuadrantDesign:
    """A sensor: layout, and for one way of processing gain [rad], zero and range.

    Attributes
    ----------
    layout : QuadrantLayout
    processing : "normalised" or "plain"
    limb : MeanLimb
    gain_rad, zero : float
        The limb stands at ``layout.limb_rad + gain (D - zero)``.
    range_rad : float
        Quadrants farther from the middle are not used.
    """

    layout: QuadrantLayout
    processing: Processing
    limb: MeanLimb
    gain_rad: float
    zero: float
    range_rad: float

    def limb_angles(self, sectors: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return where the limb stands, shape (...), in sectors (..., n), and whether it is in range."""
        x = self.gain_rad * (self.layout.reading(sectors, self.processing) - self.zero)
        return self.layout.limb_rad + x, np.abs(x) <= self.range_rad

    @property
    def sigma_rad(self) -> float:
        """Standard deviation of one quadrant's limb angle from noise."""
        return abs(self.gain_rad) * self.layout.reading_noise(self.limb.plateau, self.processing)


def mean_limb(profiles: FloatArray) -> MeanLimb:
    """Return the mean limb of profiles (..., rays) at the design altitude."""
    offset = np.radians(OFFSET_DEG)
    mean = profiles.reshape(-1, len(offset)).mean(axis=0)
    disc = (np.array(OFFSET_DEG) >= PLATEAU_DEG[0]) & (np.array(OFFSET_DEG) <= PLATEAU_DEG[1])
    plateau = float(np.mean(mean[disc]))
    # Above the ground the profile falls; np.interp wants rising values.
    limb = offset >= 0.0
    at = {share: float(np.interp(-share * plateau, -mean[limb], offset[limb])) for share in (0.9, 0.5, 0.1)}
    distance = WGS84.a_m + 1e3 * DESIGN_KM
    horizon = math.asin(WGS84.a_m / distance)
    height = distance * math.sin(horizon + at[0.5]) - WGS84.a_m
    return MeanLimb(height, plateau, 0.5 * (at[0.1] - at[0.9]))


def working_range_rad() -> float:
    """Return how far tilt and altitude may move the limb in a quadrant."""
    distance = WGS84.a_m + 1e3 * DESIGN_KM
    per_m = WGS84.a_m / distance / math.sqrt(distance**2 - WGS84.a_m**2)
    return math.sqrt(2.0) * TILT_RAD + per_m * ALTITUDE_RANGE_M


def width_rad(limb: MeanLimb) -> float:
    """Return the narrowest width of field A."""
    return 2.0 * (working_range_rad() + limb.half_rad)


def design(
    places: list[WeatherPlace],
    profiles: FloatArray,
    level: FloatArray,
    processing: Processing,
    width: float | None = None,
) -> QuadrantDesign:
    """Return the design.

    Parameters
    ----------
    places : list of WeatherPlace
    profiles : ndarray, shape (places, 4, rays)
        At the design altitude.
    level : ndarray, shape (places, 4, n)
        Sectors that level bodies see there.
    processing : "normalised" or "plain"
    width : float, optional
        Of field A [rad], in place of the rule's; the range grows and shrinks with it.
    """
    limb = mean_limb(profiles)
    raised = WGS84.raised(limb.height_m)
    true = np.array([expected_limb(place, DESIGN_KM, raised) for place in places])
    wide = width_rad(limb) if width is None else width
    layout = QuadrantLayout(float(np.mean(true)), wide)

    def moved(by: float) -> FloatArray:
        return replace(layout, limb_rad=layout.limb_rad + by).reading(level, processing)

    # Fields moved outwards see less Earth, as if the limb had sunk.
    slope = float(np.mean(moved(-SHIFT_RAD) - moved(SHIFT_RAD))) / (2.0 * SHIFT_RAD)
    zero = float(np.mean(moved(0.0) - slope * (true - layout.limb_rad)))
    return QuadrantDesign(layout, processing, limb, 1.0 / slope, zero, wide / 2.0 - limb.half_rad)
