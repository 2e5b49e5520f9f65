"""Position and attitude of a request as the keywords of a scene.

A scene places its camera by geodetic latitude, longitude and altitude and the heading of its velocity, and turns the
body against lvlh. What a simulator has along Earth-fixed axes is taken there::

    v_stars           = v_itrs + (0, 0, w) x r_itrs          w: the Earth's rate
    heading           = azimuth of v_stars about r_itrs
    q_body_from_lvlh  = q_body_from_itrs q_itrs_from_lvlh

The round trip costs the rounding of float64: some 1e-9 m and 1e-16 rad. The truth of a reply holds what was rendered.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from horizonval.core.errors import UserError
from horizonval.geometry import orbit
from horizonval.geometry.ellipsoid import geodetic_from_itrs, itrs_from_geodetic
from horizonval.geometry.frames import compose, inverse, lvlh_from_itrs, to_yaw_pitch_roll
from horizonval.geometry.pose import ellipsoid_from_spec, place_from_spec
from horizonval.geometry.tle import EARTH_RATE_RAD_S
from horizonval.serve.protocol import ANGLES, GEODETIC, ImageRequest
from horizonval.spec.scene import SceneSpec

FARTHEST_M = 2.1e9
"""From the Earth's centre; scenes end at a height of 2 000 000 km."""
SLOWEST_KM_S = 1e-6
"""Of a velocity across the vertical that still says where it goes."""


def place_keywords(request: ImageRequest, scene: SceneSpec) -> dict[str, Any]:
    """Return where and when a request's image is taken, as keywords of :class:`horizonval.Scene`; all of them.

    Parameters
    ----------
    request : ImageRequest
    scene : SceneSpec
        For what the request leaves out.

    Raises
    ------
    UserError
        A position at the Earth's centre or below the ground, or a velocity that goes straight up or down.
    """
    ellipsoid = ellipsoid_from_spec(scene.earth)
    place = scene.platform
    found: dict[str, Any] = {key: _either(getattr(request, key), getattr(place, key)) for key in GEODETIC}
    found["heading_deg"] = _either(request.heading_deg, place.heading_deg)
    found["epoch"] = _either(request.epoch, place.epoch_utc)
    if request.position_itrs_km is not None:
        r_itrs = 1e3 * np.array(request.position_itrs_km)
        if not 0.0 < math.hypot(*r_itrs) < FARTHEST_M:
            raise UserError(
                f"found {list(request.position_itrs_km)}",
                where="request: position_itrs_km",
                expected="a place above the ground, at most 2 000 000 km high",
            )
        latitude, longitude, height = (float(x) for x in geodetic_from_itrs(r_itrs, ellipsoid))
        if height <= 0.0:
            raise UserError(
                f"{height / 1e3:.6g} km above the ground",
                where="request: position_itrs_km",
                expected="a place above the ground, in kilometres along Earth-fixed axes",
            )
        found |= dict(zip(GEODETIC, (_degrees(latitude), _degrees(longitude), height / 1e3), strict=True))
    if request.velocity_itrs_km_s is not None:
        radians = (math.radians(found["latitude_deg"]), math.radians(found["longitude_deg"]))
        r_itrs = itrs_from_geodetic(*radians, found["altitude_km"] * 1e3, ellipsoid)
        velocity = 1e3 * np.array(request.velocity_itrs_km_s) + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r_itrs)
        across = np.linalg.norm(np.cross(r_itrs / np.linalg.norm(r_itrs), velocity))
        if across < 1e3 * SLOWEST_KM_S:
            raise UserError(
                "points straight up or down among the stars",
                where="request: velocity_itrs_km_s",
                expected="a velocity that says where x of lvlh points",
                fix="give heading_deg in its place",
            )
        found["heading_deg"] = _degrees(float(orbit.heading(r_itrs, velocity)))
    return found


def attitude_keywords(request: ImageRequest, scene: SceneSpec) -> dict[str, Any]:
    """Return the attitude of a request as keys of a scene's attitude; those that neither says are left out.

    Parameters
    ----------
    request : ImageRequest
    scene : SceneSpec
        At the request's place already.
    """
    found = {key: getattr(request, key) for key in (*ANGLES, "rate_deg_s", "hold")}
    q_body_from_lvlh = request.q_body_from_lvlh
    if request.q_body_from_itrs is not None:
        q_lvlh_from_itrs = lvlh_from_itrs(place_from_spec(scene)[1], math.radians(scene.platform.heading_deg))
        q_body_from_lvlh = tuple(compose(request.q_body_from_itrs, inverse(q_lvlh_from_itrs)))
    if q_body_from_lvlh is not None:
        angles = [_degrees(angle) for angle in to_yaw_pitch_roll(q_body_from_lvlh)]
        found |= dict(zip(ANGLES, angles, strict=True))
    return {key: value for key, value in found.items() if value is not None}


def _either(value: Any, otherwise: Any) -> Any:
    return otherwise if value is None else value


def _degrees(angle_rad: float) -> float:
    """Return an angle in degrees, and none as 0: that of -0 would be another scene, with other noise."""
    return math.degrees(angle_rad) + 0.0
