"""A conical scanner: its sizes, where its beam meets the horizon and clouds, and the radiance along its scan.

The beam turns about the axis s at the half-angle g. With unit vectors e, f across s and the phase p (0 nearest to the
body's z axis, growing as s turns f behind e)::

    d(p) = s cos g + (e cos p + f sin p) sin g

*Horizon.* The ellipsoid's horizon is ``d^T Q d = 0`` (:func:`horizonval.geometry.horizon.tangent_cone`). With ``t =
tan(p / 2)`` the vector ``(1 + t^2) d`` is a polynomial of second degree in t, and the condition one of fourth degree.

*Radiance.* The beam is three lines side by side, each a third of its width, and a running mean along the scan. Rays
stand close where the horizon is and farther apart on the disc; between them radiance is linear. The march is the
renderer's own.

*Sizes* are ours where nothing is printed: round numbers that are usual for scanners of the kind.

*Noise.* A thermistor bolometer of detectivity 2e8 cm Hz^0.5 / W behind 5 cm2 of aperture at f/1 and half of the light:
a field of 1 deg has 3e-4 sr, so that 5 W m-2 sr-1 bring 3.8e-7 W; the flake is 0.44 mm wide (0.0019 cm2), and in the
band ``1 / (4 tau)`` of the electronics, 250 Hz, the noise is ``sqrt(0.0019 * 250) / 2e8 = 3.4e-9 W``: 1 / 110 of the
plateau in one sample. Edges are averaged over 16 turns, 8 s.

*Clouds* are the relief of the renderer's own clouds, searched along each ray in numpy. A ray is sampled in even steps
from where it comes below the highest tops to where it meets the ground or leaves them again; the crossing between the
last step above the relief and the first below is taken as linear. A step is 5 km on rays that graze the ground, and far
less on all others: the largest structures of clouds there are. Steps that fall between two narrow tops are missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.earth.clouds.earth_pattern import BASE_M
from horizonval.earth.clouds.relief import CloudField, top_m
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geodetic_height, line_intersections, surface_normal
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.horizon import limb_side, tangent_cone
from horizonval.systems.f.electronics import ScannerElectronics
from horizonval.systems.weather_viewpoints import WeatherPlace

ON_HORIZON = 1e-6
"""Largest value of the limb function on true roots: 1e-16 ahead of the observer, of order 1 behind."""


@dataclass(frozen=True)
class ScanCone:
    """A beam that turns about an axis.

    ``half_angle_rad``: between beam and axis; ``axis``, ``start``, ``quarter``: shape (3,), orthonormal body vectors:
    spin axis, and the directions across it at phase 0 and at a quarter turn.
    """

    half_angle_rad: float
    axis: FloatArray
    start: FloatArray
    quarter: FloatArray

    @classmethod
    def to_the_right(cls, half_angle_rad: float, tilt_rad: float = 0.0) -> ScanCone:
        """Return a scanner whose axis points along the body's y axis, lowered towards z by ``tilt_rad``."""
        c, s = math.cos(tilt_rad), math.sin(tilt_rad)
        axis, start = np.array([0.0, c, s]), np.array([0.0, -s, c])
        return cls(half_angle_rad, axis, start, np.cross(axis, start))

    def directions(self, phase_rad: ArrayLike, off_rad: float = 0.0) -> FloatArray:
        """Return the beam at phases (...), shape (..., 3), or a line beside it by ``off_rad`` of the half-angle."""
        phase = np.asarray(phase_rad, dtype=np.float64)[..., None]
        g = self.half_angle_rad + off_rad
        across = np.cos(phase) * self.start + np.sin(phase) * self.quarter
        return math.cos(g) * self.axis + math.sin(g) * across

    def slopes(self, phase_rad: ArrayLike) -> FloatArray:
        """Return the derivative of :meth:`directions` by the phase, shape (..., 3)."""
        phase = np.asarray(phase_rad, dtype=np.float64)[..., None]
        return math.sin(self.half_angle_rad) * (np.cos(phase) * self.quarter - np.sin(phase) * self.start)


def ellipsoid_crossings(
    cone: ScanCone, itrs_from_body: FloatArray, r_itrs: ArrayLike, ellipsoid: Ellipsoid
) -> tuple[float, float] | None:
    """Return the phases at which the beam enters and leaves an ellipsoid, or None; ``r_itrs``: observer [m]."""
    q = tangent_cone(r_itrs, ellipsoid)
    c, s = math.cos(cone.half_angle_rad), math.sin(cone.half_angle_rad)
    fixed, start, quarter = (itrs_from_body @ v for v in (c * cone.axis, s * cone.start, s * cone.quarter))
    zero, one, two = fixed + start, 2.0 * quarter, fixed - start
    quartic = [
        two @ q @ two,
        2 * two @ q @ one,
        2 * two @ q @ zero + one @ q @ one,
        2 * one @ q @ zero,
        zero @ q @ zero,
    ]
    roots = np.roots(quartic)
    phase = 2.0 * np.arctan(roots[np.abs(roots.imag) < 1e-9].real)
    direction = cone.directions(phase) @ itrs_from_body.T
    ahead = np.abs(limb_side(direction, r_itrs, ellipsoid)) < ON_HORIZON
    phase, direction = phase[ahead], direction[ahead]
    if len(phase) != 2:
        return None
    inwards = np.einsum("ij,jk,ik->i", direction, q, cone.slopes(phase) @ itrs_from_body.T) > 0.0
    entered, left = float(phase[inwards][0]), float(phase[~inwards][0])
    return entered, left if left > entered else left + math.tau


ALTITUDE_KM, INCLINATION_DEG = 800.0, 108.0
BANDS = {"carbon dioxide, 14 to 16 um": (14.0, 16.0), "window, 10.5 to 12.5 um": (10.5, 12.5)}
CO2, WINDOW = BANDS
PLACES = 24
HALF_ANGLE_RAD = math.radians(45.0)
BEAM_RAD = math.radians(1.0)
RATE_RAD_S = 2.0 * math.pi * 2.0
DETECTOR_S, AMPLIFIER_S = 2e-3, 1e-3
FRACTION = 0.4
NOISE_SHARE, TURNS = 1.0 / 110.0, 16
LIMB_M = 40e3
PHASE_STEP_RAD = math.radians(0.05)
NODES = 128
DIGITS = 7

CONE = ScanCone.to_the_right(HALF_ANGLE_RAD)
ELECTRONICS = ScannerElectronics(BEAM_RAD, HALF_ANGLE_RAD, RATE_RAD_S, (DETECTOR_S, AMPLIFIER_S))


STEPS = 96


def distance_to_clouds(
    field: CloudField, observer_m: FloatArray, direction: FloatArray, ellipsoid: Ellipsoid = WGS84
) -> FloatArray:
    """Return how far [m] the first cloud is along rays (n, 3) from one observer (3,); nan where there is none."""
    first, last = line_intersections(observer_m, direction, ellipsoid.raised(field.top_m))
    ground, _ = line_intersections(observer_m, direction, ellipsoid)
    last = np.where(np.isfinite(ground), ground, last)
    out = np.full(len(direction), np.nan)
    low = np.flatnonzero(first > 0.0)
    share = np.linspace(0.0, 1.0, STEPS)
    t = first[low, None] + (last - first)[low, None] * share
    place = observer_m + t[..., None] * direction[low, None, :]
    normal = surface_normal(place, ellipsoid)
    top = top_m(field, normal.reshape(-1, 3)).reshape(t.shape)
    above = geodetic_height(place, ellipsoid) - np.where(top > BASE_M, top, -1e9)
    inside = above < 0.0
    met = np.flatnonzero(inside.any(axis=1))
    k = np.maximum(np.argmax(inside[met], axis=1), 1)
    before, after = above[met, k - 1], above[met, k]
    # Between clear sky and a cloud there is no slope: the cloud's wall is at the step inside it.
    part = np.where(before < 1e8, before / np.where(before > after, before - after, 1.0), 1.0)
    out[low[met]] = t[met, k - 1] + np.clip(part, 0.0, 1.0) * (t[met, k] - t[met, k - 1])
    return out


FINE_RAD, FINE_REACH_RAD = math.radians(0.2), math.radians(6.0)
COARSE_RAD = math.radians(0.5)
"""Step of phase. The limb is crossed at about a third of a right angle: 0.2 deg of phase are 6 km of height."""
LINES = (-BEAM_RAD / 3.0, 0.0, BEAM_RAD / 3.0)


def scan(item: JsonObject) -> JsonObject:
    """Return phases, and the mean radiance of the beam's lines there by sky (``clear``, ``clouds``)."""
    from horizonval.renderer.rays import cloud_top_radiance, thermal_radiance

    place, altitude, band = WeatherPlace.of(item), float(item["altitude_km"]), tuple(item["band_um"])
    r, lvlh = place.position(altitude), place.lvlh()
    phase = ray_phases(CONE, lvlh, r)
    direction = rotate(inverse(lvlh), np.concatenate([CONE.directions(phase, off) for off in LINES]))
    observer = np.broadcast_to(r, direction.shape)
    model = place.model(altitude, (band[0], band[1]))
    a, b = WGS84.a_m, WGS84.b_m
    clear = thermal_radiance(model, a, observer, direction, polar_radius_m=b, nodes=NODES)["band"]
    away = distance_to_clouds(place.clouds_of(altitude), r, direction)
    cloudy, met = clear.copy(), np.isfinite(away)
    tops = cloud_top_radiance(model, a, observer[met], direction[met], away[met], polar_radius_m=b, nodes=NODES)
    cloudy[met] = tops["band"]
    skies = {"clear": clear, "clouds": cloudy}
    means = {sky: _rounded(value.reshape(len(LINES), -1).mean(axis=0)) for sky, value in skies.items()}
    return {"phase_rad": _rounded(phase), **means, "covered": float(np.mean(met[direction @ r < 0.0]))}


def ray_phases(cone: ScanCone, lvlh: FloatArray, r: FloatArray) -> FloatArray:
    """Return the phases of a level scanner's rays, rising, space on both ends."""
    matrix = rotate(inverse(lvlh), np.eye(3)).T
    edges = ellipsoid_crossings(cone, matrix, r, WGS84.raised(LIMB_M))
    if edges is None:
        raise ValueError("the level scanner misses the Earth")
    fine = np.arange(-FINE_REACH_RAD, FINE_REACH_RAD + 0.5 * FINE_RAD, FINE_RAD)
    inner = np.arange(edges[0] + FINE_REACH_RAD + COARSE_RAD, edges[1] - FINE_REACH_RAD, COARSE_RAD)
    return np.concatenate([edges[0] + fine, inner, edges[1] + fine])


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values]
