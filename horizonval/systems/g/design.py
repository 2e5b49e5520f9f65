"""The design for 350 km: where the fields lie, how wide they are, one gain, one zero, one range; no other altitude.

*Place.* A's middle stands where a level body sees the raised ellipsoid on average; the height is where the mean profile
has half of its plateau.

*Width.* The narrowest field in which the limb stays on the straight part of the curve. To either side it must hold a
tilt of 1 deg in both axes (sqrt 2 in a quadrant at 45 deg), 10 km of altitude with what they move the limb, and half of
the limb itself, from 90 to 10 % of its plateau::

    w / 2 = sqrt(2) tilt + |d eta / d h| dh + (eta_10 - eta_90) / 2

*Gain and zero.* The fields are moved by half a degree either way over level bodies: that is the slope.

*Range.* A quadrant whose limb stands farther from the middle than tilt and altitude need has no calibration there, and
is not used.

*Layout* and sizes are ours: nobody's drawings were at hand. Four quadrants stand at azimuths 45, 135, 225 and 315 deg,
from forward to the right. Each has three fields, sectors of rings about the body's z axis, one above the other:

- A, across the limb: from ``limb - w / 2`` to ``limb + w / 2`` (nadir angles), the Earth in its lower half;
- B, on the Earth: 3 deg wide, half a degree below A;
- S, in space: 3 deg wide, half a degree above A; what the housing sends to a detector is in all three, and S takes it
  off.

A field's output is its mean radiance. There are two ways of processing::

    plain: D = A - S,        normalised: D = (A - S) / (B - S)

D falls when the limb sinks in the field. The limb is at ``limb + K (D - D_0)``, with one gain K and one zero D_0
for all quadrants and for good.

*Noise.* A thermopile of detectivity 1e8 cm Hz^0.5 / W, an aperture of 1 cm2 with a focal length of 2 cm, half of the
light, 1 Hz: radiance equal to noise is ``f / (D* A tau sqrt(Omega))`` per square root of hertz, Omega the field's solid
angle.

*Radiance.* The march is the renderer's own, in the vertical plane of each quadrant; over the quadrant's 20 deg of
azimuth the profile is the same function of the angle above the ellipsoid's horizon. The horizon itself is exact at
every azimuth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geocentric_nadir
from horizonval.geometry.frames import body_from_lvlh, inverse, north_east, rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.systems.weather_viewpoints import WeatherPlace

Processing = Literal["normalised", "plain"]
AZIMUTH_RAD = np.radians([45.0, 135.0, 225.0, 315.0])
HALF_AZIMUTH_RAD = math.radians(10.0)
OTHER_RAD, GAP_RAD = math.radians(3.0), math.radians(0.5)
DETECTIVITY_CM, APERTURE_CM2, FOCAL_CM, TRANSMISSION, BANDWIDTH_HZ = 1e8, 1.0, 2.0, 0.5, 1.0
ETA_RAD = np.radians(np.arange(60.0, 84.001, 0.05))
"""Nadir angles in the body at which sectors are looked at."""


@dataclass(frozen=True)
class QuadrantLayout:
    """The fields of one design: ``limb_rad`` is the nadir angle of A's middle, ``width_rad`` A's width."""

    limb_rad: float
    width_rad: float

    def fields(self) -> dict[str, tuple[float, float]]:
        """Return the nadir angles between which the fields lie."""
        low, high = self.limb_rad - self.width_rad / 2.0, self.limb_rad + self.width_rad / 2.0
        return {
            "A": (low, high),
            "B": (low - GAP_RAD - OTHER_RAD, low - GAP_RAD),
            "S": (high + GAP_RAD, high + GAP_RAD + OTHER_RAD),
        }

    def outputs(self, radiance: FloatArray) -> dict[str, FloatArray]:
        """Return the fields' mean radiances, shape (...), of sectors (..., n) at :data:`ETA_RAD`."""
        return {name: field_mean(radiance, *ends) for name, ends in self.fields().items()}

    def reading(self, radiance: FloatArray, processing: Processing) -> FloatArray:
        """Return D of the module text, shape (...), of sectors (..., n)."""
        out = self.outputs(radiance)
        seen = out["A"] - out["S"]
        return seen / (out["B"] - out["S"]) if processing == "normalised" else seen

    def reading_noise(self, plateau: float, processing: Processing) -> float:
        """Return the standard deviation of D at a plateau [W m-2 sr-1], with A half filled."""
        noise = {name: noise_radiance(*ends) for name, ends in self.fields().items()}
        plain = math.hypot(noise["A"], noise["S"])
        if processing == "plain":
            return plain
        return math.hypot(plain, 0.5 * math.hypot(noise["B"], noise["S"])) / plateau


def field_mean(radiance: FloatArray, low_rad: float, high_rad: float) -> FloatArray:
    """Return the mean over solid angle between two nadir angles, with ``radiance sin(eta)`` linear between ETA_RAD."""
    step = ETA_RAD[1] - ETA_RAD[0]
    weighted = radiance * np.sin(ETA_RAD)
    pieces = 0.5 * step * (weighted[..., 1:] + weighted[..., :-1])
    area = np.concatenate([np.zeros((*weighted.shape[:-1], 1)), np.cumsum(pieces, axis=-1)], axis=-1)

    def up_to(angle: float) -> FloatArray:
        i = min(max(math.floor((angle - ETA_RAD[0]) / step), 0), len(ETA_RAD) - 2)
        x = angle - ETA_RAD[i]
        slope = (weighted[..., i + 1] - weighted[..., i]) / step
        return area[..., i] + x * (weighted[..., i] + 0.5 * x * slope)

    return np.asarray((up_to(high_rad) - up_to(low_rad)) / (math.cos(low_rad) - math.cos(high_rad)))


def noise_radiance(low_rad: float, high_rad: float) -> float:
    """Return the radiance that equals the noise [W m-2 sr-1] of a field between two nadir angles."""
    solid_angle = 2.0 * HALF_AZIMUTH_RAD * (math.cos(low_rad) - math.cos(high_rad))
    per_cm2 = FOCAL_CM * math.sqrt(BANDWIDTH_HZ / solid_angle) / (DETECTIVITY_CM * APERTURE_CM2 * TRANSMISSION)
    return 1e4 * per_cm2


BAND_UM = (14.0, 16.0)
NODES = 128
DIGITS = 7
HIGHEST_KM = 410.0
OFFSET_DEG = (
    *(-14.0, -11.0, -9.0, -7.5, -6.0, -5.0, -4.0, -3.0, -2.25, -1.5, -1.0, -0.6, -0.3),
    *np.linspace(0.0, 2.6, 27),
    *(2.8, 3.0, 3.4),
)
"""Offsets of rays from the ellipsoid's horizon; above them is space, below them the disc continues unchanged."""
ACROSS = np.array([-0.8, -0.4, 0.0, 0.4, 0.8]) * HALF_AZIMUTH_RAD
"""Middles of five equal parts of a quadrant."""


def limb_profiles(item: JsonObject) -> JsonObject:
    """Return radiances (altitudes, quadrants, rays) of one day, by rays of :data:`OFFSET_DEG`."""
    from horizonval.renderer.rays import thermal_radiance

    place, altitudes = WeatherPlace.of(item), [float(a) for a in item["altitudes_km"]]
    model = place.model(HIGHEST_KM, BAND_UM)
    observers, directions = [], []
    for altitude in altitudes:
        r = place.position(altitude)
        level, horizon = _level(place), expected_limb(place, altitude, WGS84)
        eta = horizon[:, None] + np.radians(OFFSET_DEG)
        d = np.cos(eta)[..., None] * geocentric_nadir(r) + np.sin(eta)[..., None] * level[:, None, :]
        directions.append(d)
        observers.append(np.broadcast_to(r, d.shape))
    shape = np.array(directions).shape[:-1]
    found = thermal_radiance(
        model,
        WGS84.a_m,
        np.array(observers).reshape(-1, 3),
        np.array(directions).reshape(-1, 3),
        polar_radius_m=WGS84.b_m,
        nodes=NODES,
    )["band"].reshape(shape)
    return {"radiance": [[[float(f"{v:.{DIGITS}g}") for v in row] for row in one] for one in found]}


def expected_limb(place: WeatherPlace, altitude_km: float, ellipsoid: Ellipsoid) -> FloatArray:
    """Return the nadir angles, shape (4,), at which a level body sees an ellipsoid's horizon in its quadrants."""
    r = place.position(altitude_km)
    north, east = north_east(r)
    level = _level(place)
    return horizon_by_azimuth(r, ellipsoid, np.arctan2(level @ east, level @ north))


def sectors(
    place: WeatherPlace, altitude_km: float, radiance: FloatArray, pitch_rad: float, roll_rad: float
) -> FloatArray:
    """Return the mean radiance over azimuth, shape (4, n), at the body's nadir angles :data:`ETA_RAD`.

    ``radiance``: shape (4, rays), of :func:`limb_profiles`; ``pitch_rad``, ``roll_rad``: of the body.
    """
    r, lvlh = place.position(altitude_km), place.lvlh()
    north, east = north_east(r)
    down = geocentric_nadir(r)
    to_lvlh = inverse(body_from_lvlh(0.0, pitch_rad, roll_rad))
    out = np.empty((len(AZIMUTH_RAD), len(ETA_RAD)))
    for k, azimuth in enumerate(AZIMUTH_RAD):
        eta, alpha = np.meshgrid(ETA_RAD, azimuth + ACROSS, indexing="ij")
        d_body = np.stack([np.sin(eta) * np.cos(alpha), np.sin(eta) * np.sin(alpha), np.cos(eta)], axis=-1)
        d = rotate(inverse(lvlh), rotate(to_lvlh, d_body.reshape(-1, 3)))
        x, y, z = d @ north, d @ east, d @ down
        offset = np.arctan2(np.hypot(x, y), z) - horizon_by_azimuth(r, WGS84, np.arctan2(y, x))
        out[k] = profile_at(radiance[k], offset).reshape(eta.shape).mean(axis=1)
    return out


def profile_at(radiance: FloatArray, offset_rad: FloatArray) -> FloatArray:
    """Return a profile at angles above the ellipsoid's horizon: a monotone cubic, nothing above its last ray."""
    places = np.radians(OFFSET_DEG)
    value = PchipInterpolator(places, radiance)(np.clip(offset_rad, places[0], places[-1]))
    return np.where(offset_rad > places[-1], 0.0, value)


def _level(place: WeatherPlace) -> FloatArray:
    """Return the level unit vectors, shape (4, 3), of the quadrants of a level body, Earth-fixed."""
    lvlh = np.stack([np.cos(AZIMUTH_RAD), np.sin(AZIMUTH_RAD), np.zeros_like(AZIMUTH_RAD)], axis=-1)
    return rotate(inverse(place.lvlh()), lvlh)


DESIGN_KM = 350.0
TILT_RAD, ALTITUDE_RANGE_M = math.radians(1.0), 10e3
SHIFT_RAD = math.radians(0.5)
PLATEAU_DEG = (-3.0, -0.3)


@dataclass(frozen=True)
class MeanLimb:
    """Mean of level profiles at the design altitude.

    ``height_m``: at half of ``plateau`` [W m-2 sr-1]; ``half_rad``: half of the angle between 90 and 10 %.
    """

    height_m: float
    plateau: float
    half_rad: float


@dataclass(frozen=True)
class QuadrantDesign:
    """A sensor's layout, and gain [rad], zero and range of one processing.

    The limb is at ``layout.limb_rad + gain (D - zero)``; quadrants beyond ``range_rad`` from the middle are unused.
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

    ``profiles``: shape (places, 4, rays), at the design altitude; ``level``: shape (places, 4, n), sectors of level
    bodies; ``width``: of field A [rad], replacing the rule's; the range scales with it.
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
