"""Where the camera is and how it is turned, from the fields of a scene.

A scene places its camera by geodetic latitude, longitude and altitude and the heading of its velocity, and turns the
body against lvlh. What a program gives along Earth-fixed axes is taken there (:func:`scene_keys`)::

    v_stars           = v_itrs + (0, 0, w) x r_itrs          w: the Earth's rate
    heading           = azimuth of v_stars about r_itrs
    q_body_from_lvlh  = q_body_from_itrs q_itrs_from_lvlh

The round trip costs the rounding of float64: some 1e-9 m and 1e-16 rad.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError, one_of
from horizonval.geometry import orbit
from horizonval.geometry.ellipsoid import (
    WGS84,
    Ellipsoid,
    geodetic_from_itrs,
    geodetic_height,
    itrs_from_geodetic,
    sphere,
    surface_normal,
)
from horizonval.geometry.frames import (
    body_from_lvlh,
    cam_from_body,
    compose,
    inverse,
    lvlh_from_itrs,
    to_yaw_pitch_roll,
)
from horizonval.geometry.orbit import EARTH_RATE_RAD_S
from horizonval.spec.camera import CameraSpec, Head
from horizonval.spec.earth import Earth
from horizonval.spec.load import validate
from horizonval.spec.pose import ANGLES, GEODETIC, TABLE_OF, TURNS, CameraUse, Platform, PoseKeys
from horizonval.spec.scene import SceneSpec

FARTHEST_M = 2.1e9
"""From the Earth's centre; scenes end at a height of 2 000 000 km."""
SLOWEST_KM_S = 1e-6
"""Of a velocity across the vertical that still says where it goes."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and attitude of one camera.

    ``altitude_m`` is the geodetic height, computed back from ``r_itrs`` [m]; quaternions are scalar last. Yaw, pitch
    and roll of the body against lvlh have ``|pitch| <= pi / 2`` and are in ``(-pi, pi]``: what an estimator can report.
    """

    ellipsoid: Ellipsoid
    r_itrs: FloatArray
    altitude_m: float
    q_cam_from_itrs: FloatArray
    q_cam_from_body: FloatArray
    q_body_from_lvlh: FloatArray
    q_lvlh_from_itrs: FloatArray
    yaw_rad: float
    pitch_rad: float
    roll_rad: float


def ellipsoid_from_spec(earth: Earth) -> Ellipsoid:
    """Return the planet's shape."""
    return WGS84 if earth.shape == "wgs84" else sphere(earth.radius_km * 1e3)


def _wrap_deg(angle: float) -> float:
    """Return the angle in ``(-180, 180]``; exact, as only multiples of 360 are taken away."""
    wrapped = math.remainder(angle, 360.0)
    return 180.0 if wrapped == -180.0 else wrapped


def canonical_attitude_deg(yaw: float, pitch: float, roll: float) -> tuple[float, float, float]:
    """Return the same attitude [deg] with ``|pitch| <= 90`` and yaw and roll in ``(-180, 180]``.

    Done on the numbers as given and not through a matrix, so that a scene's round figures stay round.
    """
    pitch = _wrap_deg(pitch)
    if abs(pitch) > 90.0:
        yaw, pitch, roll = yaw + 180.0, math.copysign(180.0, pitch) - pitch, roll + 180.0
    return _wrap_deg(yaw), pitch, _wrap_deg(roll)


def _position(place: Platform, ellipsoid: Ellipsoid) -> FloatArray:
    latitude, longitude = math.radians(place.latitude_deg), math.radians(place.longitude_deg)
    return itrs_from_geodetic(latitude, longitude, place.altitude_km * 1e3, ellipsoid)


def place_from_spec(scene: SceneSpec) -> tuple[Ellipsoid, FloatArray]:
    """Return the planet's shape and the camera's position [m], from geodetic latitude, longitude and altitude.

    UserError: the position is not a finite point above the surface.
    """
    ellipsoid = ellipsoid_from_spec(scene.earth)
    place = scene.platform
    r_itrs = _position(place, ellipsoid)
    p = r_itrs / ellipsoid.axes_m
    # The floor on the scaled height, 1e-9 (6 mm), keeps the tangent cone meaningful in float64.
    if not (np.all(np.isfinite(p)) and float(p @ p) - 1.0 > 2e-9):
        raise UserError(
            f"altitude {place.altitude_km} km puts the camera on or below the surface",
            where="platform.altitude_km",
            expected="a geodetic altitude above the ground",
        )
    return ellipsoid, r_itrs


def pose_from_spec(scene: SceneSpec, camera: CameraSpec | None = None) -> Pose:
    """Return the pose of a scene's camera, which is needed where the scene chooses one of its heads.

    The heading is the azimuth of the velocity in the geocentric level plane. From the body outwards the scene's
    mounting comes first and the head's second: ``q_cam_from_body = q_cam_from_housing q_housing_from_body``. UserError:
    the position is not above the surface, or the camera has no such head.
    """
    if camera is None and scene.camera.head is not None:
        raise ValueError("a scene that chooses a head has no pose without its camera")
    ellipsoid, r_itrs = place_from_spec(scene)
    yaw, pitch, roll = canonical_attitude_deg(scene.attitude.yaw_deg, scene.attitude.pitch_deg, scene.attitude.roll_deg)
    yaw, pitch, roll = math.radians(yaw), math.radians(pitch), math.radians(roll)
    q_body_from_lvlh = body_from_lvlh(yaw, pitch, roll)
    q_cam_from_body = _mounting(scene.camera)
    head = None if camera is None else camera.chosen_head(scene.camera.head)
    if head is not None:
        q_cam_from_body = compose(_mounting(head), q_cam_from_body)
    q_lvlh_from_itrs = lvlh_from_itrs(r_itrs, math.radians(scene.platform.heading_deg))
    return Pose(
        ellipsoid=ellipsoid,
        r_itrs=r_itrs,
        altitude_m=float(geodetic_height(r_itrs, ellipsoid)),
        q_cam_from_itrs=compose(q_cam_from_body, q_body_from_lvlh, q_lvlh_from_itrs),
        q_cam_from_body=q_cam_from_body,
        q_body_from_lvlh=q_body_from_lvlh,
        q_lvlh_from_itrs=q_lvlh_from_itrs,
        yaw_rad=yaw,
        pitch_rad=pitch,
        roll_rad=roll,
    )


def scene_keys(pose: PoseKeys, scene: SceneSpec, where: str) -> dict[str, Any]:
    """Return what a pose gives as keys of a scene file; the scene has what the pose leaves out.

    UserError, at ``where``: a position below the ground, or a velocity straight up or down.
    """
    found = pose.given
    position, velocity = found.pop("position_itrs_km", None), found.pop("velocity_itrs_km_s", None)
    body_from_lvlh, body_from_itrs = found.pop("q_body_from_lvlh", None), found.pop("q_body_from_itrs", None)
    ellipsoid = ellipsoid_from_spec(scene.earth)
    if position is not None:
        found |= _geodetic_keys(position, ellipsoid, f"{where}: position_itrs_km")
    place = scene.platform.model_copy(update={key: x for key, x in found.items() if TABLE_OF[key] == "platform"})
    if velocity is not None:
        heading_deg = _heading_deg(velocity, _position(place, ellipsoid), f"{where}: velocity_itrs_km_s")
        found["heading_deg"] = heading_deg
        place = place.model_copy(update={"heading_deg": heading_deg})
    if body_from_itrs is not None:
        r_itrs = place_from_spec(scene.model_copy(update={"platform": place}))[1]
        q_lvlh_from_itrs = lvlh_from_itrs(r_itrs, math.radians(place.heading_deg))
        body_from_lvlh = compose(body_from_itrs, inverse(q_lvlh_from_itrs))
    if body_from_lvlh is not None:
        angles = [_degrees(angle) for angle in to_yaw_pitch_roll(body_from_lvlh)]
        found |= dict(zip(ANGLES, angles, strict=True))
    return found


def turned(scene: SceneSpec, keys: Mapping[str, Any], where: str) -> SceneSpec:
    """Return a scene with its camera turned by some of :data:`horizonval.spec.pose.TURNS`; other keys stay.

    UserError, at ``where``: another key, or an impossible value.
    """
    for key in keys:
        if key not in TURNS:
            raise UserError("unknown key", where=f"{where}: {key}", expected=one_of(key, TURNS))
    changed: dict[str, dict[str, Any]] = {"attitude": {}, "camera": {}}
    for key, value in scene_keys(validate(PoseKeys, keys, where), scene, where).items():
        changed[TABLE_OF[key]][key] = value
    tables = {table: getattr(scene, table).model_copy(update=values) for table, values in changed.items() if values}
    return scene.model_copy(update=tables)


def _geodetic_keys(position_itrs_km: tuple[float, ...], ellipsoid: Ellipsoid, where: str) -> dict[str, float]:
    r_itrs = 1e3 * np.array(position_itrs_km)
    if not 0.0 < math.hypot(*r_itrs) < FARTHEST_M:
        expected = "a place above the ground, at most 2 000 000 km high"
        raise UserError(f"found {list(position_itrs_km)}", where=where, expected=expected)
    latitude, longitude, height = (float(x) for x in geodetic_from_itrs(r_itrs, ellipsoid))
    if height <= 0.0:
        raise UserError(
            f"{height / 1e3:.6g} km above the ground",
            where=where,
            expected="a place above the ground, in kilometres along Earth-fixed axes",
        )
    return dict(zip(GEODETIC, (_degrees(latitude), _degrees(longitude), height / 1e3), strict=True))


def _heading_deg(velocity_itrs_km_s: tuple[float, ...], r_itrs: FloatArray, where: str) -> float:
    velocity = 1e3 * np.array(velocity_itrs_km_s) + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], r_itrs)
    across = np.linalg.norm(np.cross(r_itrs / np.linalg.norm(r_itrs), velocity))
    if across < 1e3 * SLOWEST_KM_S:
        raise UserError(
            "points straight up or down among the stars",
            where=where,
            expected="a velocity that says where x of lvlh points",
            fix="give heading_deg in its place",
        )
    return _degrees(float(orbit.heading(r_itrs, velocity)))


def _degrees(angle_rad: float) -> float:
    """Return an angle in degrees, and 0 for -0: the noise is drawn from a digest that tells them apart."""
    return math.degrees(angle_rad) + 0.0


def _mounting(mount: CameraUse | Head) -> FloatArray:
    return cam_from_body(
        math.radians(mount.mount_yaw_deg), math.radians(mount.mount_pitch_deg), math.radians(mount.mount_roll_deg)
    )


def direction_from_horizontal(
    zenith_rad: float, azimuth_rad: float, r_itrs: FloatArray, ellipsoid: Ellipsoid
) -> FloatArray:
    """Return the unit vector, shape (3,), seen from the geodetic sub-satellite point at a zenith angle and azimuth.

    Azimuth from north towards east, about the *geodetic* vertical of ``r_itrs``. At a pole north is the continuation
    of the position's own meridian.
    """
    up = surface_normal(r_itrs, ellipsoid)
    longitude = math.atan2(r_itrs[1], r_itrs[0])
    east = np.array([-math.sin(longitude), math.cos(longitude), 0.0])
    north = np.cross(up, east)
    north /= np.linalg.norm(north)
    level = math.cos(azimuth_rad) * north + math.sin(azimuth_rad) * east
    direction = math.cos(zenith_rad) * up + math.sin(zenith_rad) * level
    return direction / np.linalg.norm(direction)
