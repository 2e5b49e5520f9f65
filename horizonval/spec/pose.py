"""Where a camera is, when, and how it is turned: the same keys for scene files, Python and the image service.

A scene file holds them in the tables ``[platform]``, ``[attitude]`` and ``[camera]``; programs give them by their names
alone, and may give vectors and quaternions in place of angles (:class:`PoseKeys`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, TypedDict

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from horizonval.spec.base import Angle, Epoch, Model, PlainName, Quaternion, Vector

UNIT_LENGTH = 1e-6
"""How far a quaternion's length may be from one."""


class Platform(Model):
    """Where the satellite is, and when."""

    epoch_utc: Epoch = datetime(2026, 3, 20, 12, 0, 0, tzinfo=UTC)
    """Date and time, UTC; years 1960 to 2099. It decides where Sun and Moon are, the season and the local time."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] = 0.0
    """Geodetic latitude of the satellite."""
    longitude_deg: Angle = 0.0
    """Longitude of the satellite, positive to the east."""
    altitude_km: Annotated[float, Field(gt=0, le=2_000_000)]
    """Geodetic altitude: height above the ellipsoid, or above the sphere."""
    heading_deg: Angle = 0.0
    """Geocentric azimuth of the velocity, from north towards east, in the plane across the line to the Earth's centre
    (the azimuth in the geodetic level plane differs by up to half an arcsecond). It says where x of lvlh points."""


class Attitude(Model):
    """Body against lvlh (x to the velocity, z to the geocentric nadir): yaw about z, then pitch about y, then roll
    about x.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"rate_deg_s", "hold"})

    yaw_deg: Angle = 0.0
    """Yaw, about z."""
    pitch_deg: Angle = 0.0
    """Pitch, about y."""
    roll_deg: Angle = 0.0
    """Roll, about x."""
    rate_deg_s: Vector = (0.0, 0.0, 0.0)
    """Angular velocity of the body against lvlh, in body axes; it blurs exposures and slants rolling shutters."""
    hold: Literal["lvlh", "inertial"] = "lvlh"
    """What `rate_deg_s` is counted from: `lvlh`, or `inertial`, which adds the orbital rate (a body that is fixed among
    the stars).
    """


class _CameraFile(Model):
    file: str
    """Name of a shipped camera (`horizonval list cameras`), or the path of a camera file; a relative path starts from
    the folder of this file.
    """


class Mounting(Model):
    """Which of a camera's heads, and how the camera is mounted in the body."""

    head: PlainName | None = None
    """Name of one of the camera file's `[[head]]` tables, or `"all"` for one frame per head, named `<scene>.<head>`.
    Without the key a suite's frame does the same, and a scene file asks for a choice.
    """
    mount_yaw_deg: Angle = 0.0
    """Yaw of the mounting, about z."""
    mount_pitch_deg: Angle = 0.0
    """Pitch of the mounting, about y."""
    mount_roll_deg: Angle = 0.0
    """Roll of the mounting, about x."""


class CameraUse(Mounting, _CameraFile):
    """Which camera, and how it is mounted in the body.

    The mounting turns body axes into camera axes: yaw about z, then pitch about y, then roll about x. Where the camera
    has heads it turns body axes into those of the housing, and the head's own angles turn these into camera axes.
    """

    later_keys: ClassVar[frozenset[str]] = frozenset({"head"})


TABLE_OF = {
    key: table
    for table, model in (("platform", Platform), ("attitude", Attitude), ("camera", Mounting))
    for key in model.model_fields
}
"""Table of a scene file that holds a key of the pose."""
GEODETIC = ("latitude_deg", "longitude_deg", "altitude_km")
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
QUATERNIONS = ("q_body_from_lvlh", "q_body_from_itrs")
TURNS = (*(key for key, table in TABLE_OF.items() if table != "platform" and key != "head"), *QUATERNIONS)
"""Keys of a pose that turn the camera where it is."""


class PoseKeys(Mounting, Attitude, Platform):
    """Keys of a pose as programs give them. Only those that are given count; for the others a scene has its own.

    :func:`horizonval.geometry.pose.scene_keys` turns vectors and quaternions into the keys of a scene file.
    """

    altitude_km: Annotated[float, Field(gt=0, le=2_000_000)] = 1.0
    """Geodetic altitude: height above the ellipsoid, or above the sphere."""
    position_itrs_km: Vector = (0.0, 0.0, 0.0)
    """Position along Earth-fixed axes, in place of latitude, longitude and altitude."""
    velocity_itrs_km_s: Vector = (0.0, 0.0, 0.0)
    """Rate of change of the Earth-fixed position, in place of the heading. The rotation of the Earth is added."""
    q_body_from_lvlh: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Attitude against lvlh, scalar last, in place of the angles."""
    q_body_from_itrs: Quaternion = (0.0, 0.0, 0.0, 1.0)
    """Attitude against the Earth-fixed axes, scalar last, in place of the angles."""

    @property
    def given(self) -> dict[str, Any]:
        """Keys of the pose that were given, with their values."""
        return {key: getattr(self, key) for key in PoseKeys.model_fields if key in self.model_fields_set}

    @model_validator(mode="after")
    def _says_nothing_twice(self) -> PoseKeys:
        given = self.model_fields_set
        if "position_itrs_km" in given and given & set(GEODETIC):
            raise ValueError("position_itrs_km says the whole place; leave out latitude, longitude and altitude")
        if {"velocity_itrs_km_s", "heading_deg"} <= given:
            raise ValueError("give at most one of velocity_itrs_km_s and heading_deg")
        if len(given & set(QUATERNIONS)) + bool(given & set(ANGLES)) > 1:
            raise ValueError(f"give at most one of {', '.join(QUATERNIONS)}, and yaw, pitch and roll")
        for key in given & set(QUATERNIONS):
            length = math.hypot(*getattr(self, key))
            if abs(length - 1.0) > UNIT_LENGTH:
                raise ValueError(f"{key} has the length {length:.7g}; divide it by its length")
        return self


VECTORS = tuple(key for key in PoseKeys.model_fields if key not in TABLE_OF)
"""Keys that no scene file holds."""
_Numbers: TypeAlias = Sequence[float] | NDArray[np.float64]


class PoseKeywords(TypedDict, total=False):
    """The keys of :class:`PoseKeys` for type checkers and editors, as keywords of Python calls."""

    epoch_utc: str | datetime
    latitude_deg: float
    longitude_deg: float
    altitude_km: float
    heading_deg: float
    position_itrs_km: _Numbers
    velocity_itrs_km_s: _Numbers
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    q_body_from_lvlh: _Numbers
    q_body_from_itrs: _Numbers
    rate_deg_s: _Numbers
    hold: Literal["lvlh", "inertial"]
    head: str | None
    mount_yaw_deg: float
    mount_pitch_deg: float
    mount_roll_deg: float
