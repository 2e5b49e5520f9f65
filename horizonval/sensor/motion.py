"""A turning camera: blur of the exposure, slant of a rolling shutter.

The scene is fixed in the local vertical frame, in which the camera turns at the angular velocity omega (camera axes).
At the time t after the frame's instant a pixel sees what the still frame has in the direction turned back::

    image(t)(u) = image(0)(project(exp(t [omega]x) unproject(u)))

The pixel's path over the exposure is a parabola through its exact positions at both ends; the image is averaged along
it, bilinear between pixels. Row r of a rolling shutter is exposed ``(r - (H - 1) / 2) row_time`` after the middle row,
whose instant is the frame's.

Neglected: that vignetting and stray light do not move with the scene; the motion along the orbit, which moves the
ground (0.9 deg/s below a satellite at 500 km) but hardly the limb; radiance beyond the image's border, taken as that of
the border; the Sun's motion against the local vertical frame, 0.06 deg/s. :func:`check_turn` refuses longer motions
than the parabola describes, and rates that a detector without a time constant would ignore.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, camera_from_spec, pixel_grid, project, unproject
from horizonval.geometry.frames import body_from_lvlh, rotate
from horizonval.geometry.part import coverage
from horizonval.geometry.pose import place_from_spec
from horizonval.spec.camera import CameraSpec
from horizonval.spec.detector import Cmos
from horizonval.spec.scene import SceneSpec

GM_M3_PER_S2 = 3.986004418e14
STILL_PX = 0.01
"""Motion below leaves the image unchanged [px]."""
_NO_TURN_RAD = 1e-9
"""Turn that no image shows [rad]; dividing by a still shorter one leaves no digits."""
FARTHEST_RAD = 0.05
"""Largest turn at which the parabola is fitted [rad]."""
LONG_PX = 4.0
"""Longer paths use evenly spaced instants, a pixel apart at most: bilinear tents at that step add up to an even line.
Shorter ones use Gauss's points, two to a pixel."""
MOST_POINTS = 128
"""Longest blur [px]: the time for an image grows with its length, and no horizon is left in a longer one."""
IGNORED_PX_S = 1.0
"""Fastest motion [px/s] that a thermal detector without a time constant may ignore: 0.01 px for one of 10 ms."""
_GLANCE_PX = 16
"""Distance of the pixels that are checked first for motion; speeds vary slowly over an image."""


def rate_cam_rad_s(truth: FrameTruth) -> FloatArray:
    """Return the camera's angular velocity against the local vertical frame, in camera axes, shape (3,) [rad/s].

    The scene's ``attitude.rate_deg_s``; with ``attitude.hold = "inertial"`` also the orbital rate that the local
    vertical frame turns by, ``sqrt(GM / r^3)`` about its -y axis.
    """
    attitude, q = truth.scene.get("attitude", {}), np.array(truth.q_body_from_lvlh)
    rate = _body_rate_rad_s(attitude, np.array(truth.r_itrs), q)
    return rotate(truth.q_cam_from_body, rate)


def _body_rate_rad_s(attitude: Mapping[str, Any], r_m: FloatArray, q_body_from_lvlh: FloatArray) -> FloatArray:
    rate = np.array([math.radians(x) for x in attitude.get("rate_deg_s", (0.0, 0.0, 0.0))])
    if attitude.get("hold") == "inertial":
        orbital = math.sqrt(GM_M3_PER_S2 / float(np.linalg.norm(r_m)) ** 3)
        rate = rate + rotate(q_body_from_lvlh, [0.0, orbital, 0.0])
    return rate


def check_scene_turn(scene: SceneSpec, camera: CameraSpec) -> None:
    """Refuse, as :func:`check_turn`, a scene whose camera turns too fast; an automatic exposure is the shortest one."""
    if any(scene.attitude.rate_deg_s) or scene.attitude.hold == "inertial":
        attitude, r_m = scene.attitude.model_dump(), place_from_spec(scene)[1]
        q = body_from_lvlh(*(math.radians(attitude[key]) for key in ("yaw_deg", "pitch_deg", "roll_deg")))
        check_turn(_body_rate_rad_s(attitude, r_m, q), camera)


def check_turn(rate_rad_s: FloatArray, camera: CameraSpec, exposure_s: float | None = None) -> None:
    """Raise ``UserError`` for a rate that blurs an image beyond what is modelled, or that the detector would ignore.

    Parameters
    ----------
    rate_rad_s : ndarray, shape (3,)
        Angular velocity against the local vertical frame, in any axes [rad/s].
    camera : CameraSpec
        Without a detector every rate passes.
    exposure_s : float, optional
        Chosen by an automatic exposure; by default its shortest, or the camera's ``exposure_s``.
    """
    detector, rate = camera.detector, math.hypot(*rate_rad_s)
    if detector is None or rate == 0.0:
        return
    geometry = camera_from_spec(camera.camera)
    px_per_rad = max(geometry.fx, geometry.fy)
    where, found = "attitude.rate_deg_s", f"the camera turns at {math.degrees(rate):.5g} deg/s"
    if isinstance(detector, Cmos):
        auto = detector.auto_exposure
        key = "detector.exposure_s" if auto is None else "the automatic exposure"
        seconds = exposure_s or (detector.exposure_s if auto is None else auto.min_s)
        rows_s = (geometry.height - 1) * (detector.row_time_s or 0.0) if detector.shutter == "rolling" else 0.0
        longest_s = 0.5 * (seconds + rows_s)
        said = f"{key} = {seconds:.3g}" + (f", row_time_s = {detector.row_time_s:.3g}" if rows_s else "")
    else:
        longest_s = seconds = detector.time_constant_s
        said = f"detector.time_constant_s = {seconds:.3g}"
        if seconds == 0.0 and rate * px_per_rad > IGNORED_PX_S:
            raise UserError(
                f"{found}, which a detector without a time constant does not show",
                where=where,
                expected=f"at most {math.degrees(IGNORED_PX_S / px_per_rad):.3g} deg/s, one pixel in a second",
                fix="give detector.time_constant_s",
            )
    if longest_s == 0.0:
        return
    largest = min(FARTHEST_RAD / longest_s, MOST_POINTS / px_per_rad / seconds)
    if rate > largest:
        turn_deg = math.degrees(rate * 2.0 * longest_s)
        raise UserError(
            f"{found}, {turn_deg:.3g} deg while an image is taken ({said})",
            where=where,
            expected=f"at most {math.degrees(largest):.3g} deg/s: the blur is modelled for turns of "
            f"{2.0 * math.degrees(FARTHEST_RAD):.1f} deg and paths of {MOST_POINTS} px",
        )


def blur_by_motion(
    image: FloatArray, camera: CameraModel, rate_cam_rad_s: FloatArray, exposure_s: float, row_time_s: float = 0.0
) -> FloatArray:
    """Return the mean image over an exposure, shape (H, W), from that of a camera at rest.

    The camera turns with an angular velocity in its own axes; ``row_time_s`` is 0 for a global shutter.
    """
    path = _Path.of(camera, rate_cam_rad_s, 0.5 * exposure_s + 0.5 * (camera.height - 1) * row_time_s)
    if path is None:
        return image
    length_px = path.speed_px_per_s * exposure_s
    if length_px < LONG_PX:
        x, weight = np.polynomial.legendre.leggauss(max(2, math.ceil(2 * length_px)))
    else:
        count = math.ceil(length_px)
        x, weight = (2 * np.arange(count) + 1) / count - 1, np.full(count, 2 / count)
    return path.mean(image, 0.5 * exposure_s * x, 0.5 * weight, row_time_s)


def mean_over_instants(
    image: FloatArray, camera: CameraModel, rate_cam_rad_s: FloatArray, time_s: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return the weighted mean of what is seen at instants, shape (H, W).

    ``time_s``, ``weight``: shape (k,), against the instant of the frame.
    """
    path = _Path.of(camera, rate_cam_rad_s, float(np.abs(time_s).max()))
    return image if path is None else path.mean(image, time_s, weight)


def behind_still_parts(
    still: FloatArray, behind: FloatArray, moved_behind: FloatArray, truth: FrameTruth, camera: CameraModel
) -> FloatArray:
    """Return what a turning camera sees that has parts of the spacecraft in view, shape (H, W): they turn with it.

    ``still`` has the parts; ``behind`` and ``moved_behind`` have none, at rest and turning. Only what lies behind the
    parts moves, and it shows where they do not cover. The lens has spread all images already, which matters within its
    spread of their edges only.
    """
    if truth.part_outline is None:
        return still
    return np.asarray(still + (1.0 - coverage(truth.part_outline, camera)) * (moved_behind - behind))


@dataclass(frozen=True)
class _Path:
    """Every pixel's way over the still image, ``place + t (slope + t bend)``; rows and columns first, (2, H, W)."""

    place: FloatArray
    slope: FloatArray
    bend: FloatArray

    @classmethod
    def of(cls, camera: CameraModel, rate_cam_rad_s: FloatArray, longest_s: float) -> _Path | None:
        """Return the way of a turning camera up to a time before and after the frame; None if it is too short."""
        speed = float(np.linalg.norm(rate_cam_rad_s))
        if longest_s * speed < _NO_TURN_RAD:
            return None
        end = min(longest_s, FARTHEST_RAD / speed)
        place = pixel_grid(camera)
        rows, columns = (np.unique(np.append(np.arange(0, n, _GLANCE_PX), n - 1)) for n in place.shape[:2])
        glance = cls._through(camera, place[np.ix_(rows, columns)], rate_cam_rad_s, end)
        if glance.speed_px_per_s * longest_s < 0.5 * STILL_PX:
            return None
        path = cls._through(camera, place, rate_cam_rad_s, end)
        return path if path.speed_px_per_s * longest_s >= STILL_PX else None

    @classmethod
    def _through(cls, camera: CameraModel, place: FloatArray, rate_cam_rad_s: FloatArray, end_s: float) -> _Path:
        """Return the ways of the pixels at ``place``, shape (H, W, 2), exact at ``end_s`` before and after."""
        ahead, behind = (_seen_at(camera, place, rate_cam_rad_s * t) for t in (end_s, -end_s))
        slope, bend = (ahead - behind) / (2 * end_s), (ahead + behind - 2 * place) / (2 * end_s**2)
        return cls(*(np.ascontiguousarray(part[..., ::-1].transpose(2, 0, 1)) for part in (place, slope, bend)))

    @cached_property
    def speed_px_per_s(self) -> float:
        """How fast the fastest pixel moves at the frame's instant."""
        return float(np.hypot(*self.slope).max())

    def mean(self, image: FloatArray, time_s: FloatArray, weight: FloatArray, row_time_s: float = 0.0) -> FloatArray:
        """Return the weighted mean of the image at instants of the middle row, shape (H, W)."""
        rows = (np.arange(image.shape[0]) - 0.5 * (image.shape[0] - 1)) * row_time_s
        total, seen, at = np.zeros_like(image), np.empty_like(image), np.empty_like(self.place)
        for instant, share in zip(time_s, weight, strict=True):
            t = (rows + instant)[:, None]
            np.multiply(self.bend, t, out=at)
            at += self.slope
            at *= t
            at += self.place
            map_coordinates(image, at, output=seen, order=1, mode="nearest")
            seen *= share
            total += seen
        return total


def _seen_at(camera: CameraModel, place: FloatArray, turn_rad: FloatArray) -> FloatArray:
    """Return where in the still frame the pixels look after a turn, shape (H, W, 2); where they cannot, their place."""
    direction = (
        Rotation.from_rotvec(turn_rad).apply(unproject(camera, place).reshape(-1, 3)).reshape(*place.shape[:2], 3)
    )
    uv, in_front = project(camera, direction)
    usable = in_front & np.isfinite(uv).all(axis=-1)
    return np.where(usable[..., None], uv, place)
