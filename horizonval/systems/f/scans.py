"""Radiance along the lines of a conical scan, clear and under clouds, and the signal that is made of it.

The beam is three lines side by side, each a third of its width, and a running mean along the scan. Rays stand close
where the horizon is and farther apart on the disc; between them radiance is linear. The march is the renderer's own.
"""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.frames import inverse, rotate
from horizonval.systems.f.clouds import distance_to_clouds
from horizonval.systems.f.scan_cone import ScanCone, ellipsoid_crossings
from horizonval.systems.f.settings import BEAM_RAD, CONE, DIGITS, LIMB_M, NODES
from horizonval.systems.weather_viewpoints import WeatherPlace

FINE_RAD, FINE_REACH_RAD = math.radians(0.2), math.radians(6.0)
COARSE_RAD = math.radians(0.5)
"""Of phase. The air's limb is crossed at about a third of a right angle: 0.2 deg of phase are 6 km of height."""
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
