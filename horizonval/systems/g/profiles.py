"""Radiance across the limb in each quadrant, and what a tilted body sees of it.

The march is the renderer's own, in the vertical plane of each quadrant; over the quadrant's 20 deg of azimuth the
profile is the same function of the angle above the ellipsoid's horizon. The horizon itself is exact at every azimuth.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.core.json_types import JsonObject
from horizonval.geometry.ellipsoid import WGS84, Ellipsoid, geocentric_nadir
from horizonval.geometry.frames import body_from_lvlh, inverse, north_east, rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.systems.g.layout import AZIMUTH_RAD, ETA_RAD, HALF_AZIMUTH_RAD
from horizonval.systems.weather_viewpoints import WeatherPlace

BAND_UM = (14.0, 16.0)
NODES = 128
DIGITS = 7
HIGHEST_KM = 410.0
OFFSET_DEG = (
    *(-14.0, -11.0, -9.0, -7.5, -6.0, -5.0, -4.0, -3.0, -2.25, -1.5, -1.0, -0.6, -0.3),
    *np.linspace(0.0, 2.6, 27),
    *(2.8, 3.0, 3.4),
)
"""Of the rays above the ellipsoid's horizon; beyond them there is nothing, or (below) the disc goes on as it is."""
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

    Parameters
    ----------
    place : WeatherPlace
    altitude_km : float
    radiance : ndarray, shape (4, rays)
        Of :func:`limb_profiles` at that altitude.
    pitch_rad, roll_rad : float
        Of the body.
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
