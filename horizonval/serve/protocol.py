"""What a client may ask for, key by key."""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from horizonval.core.errors import UserError, nearest
from horizonval.spec.base import Angle, Finite, Listed, Model, Positive, unit
from horizonval.spec.load import validate
from horizonval.wire import SCHEMA

Vector = Annotated[tuple[Finite, Finite, Finite], Listed]
Quaternion = Annotated[tuple[Finite, Finite, Finite, Finite], Listed, unit("1")]
Text = Annotated[str, Field(max_length=256)]
Seed = Annotated[int, Field(ge=0, lt=1 << 63)]

GEODETIC = ("latitude_deg", "longitude_deg", "altitude_km")
ANGLES = ("yaw_deg", "pitch_deg", "roll_deg")
QUATERNIONS = ("q_body_from_lvlh", "q_body_from_itrs")
UNIT_LENGTH = 1e-6
"""How far a quaternion's length may be from one."""
KINDS = ("image", "status")


class ImageRequest(Model):
    """One image: where, how turned, exposed for how long. What is left out is as in the scene that is served."""

    epoch_utc: Text | None = None
    """Date and time, UTC, in the form of ISO 8601."""
    latitude_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    """Geodetic latitude."""
    longitude_deg: Angle | None = None
    """Longitude, positive to the east."""
    altitude_km: Annotated[float, Field(gt=0, le=2_000_000)] | None = None
    """Geodetic altitude."""
    heading_deg: Angle | None = None
    """Geocentric azimuth of the velocity among the stars, from north towards east."""
    position_itrs_km: Vector | None = None
    """Position along Earth-fixed axes, in place of latitude, longitude and altitude."""
    velocity_itrs_km_s: Vector | None = None
    """How fast the Earth-fixed position changes, in place of the heading. The Earth's own turn is added."""
    yaw_deg: Angle | None = None
    """Yaw of the body against lvlh, about z."""
    pitch_deg: Angle | None = None
    """Pitch, about y."""
    roll_deg: Angle | None = None
    """Roll, about x."""
    q_body_from_lvlh: Quaternion | None = None
    """Attitude against lvlh, scalar last, in place of the angles."""
    q_body_from_itrs: Quaternion | None = None
    """Attitude against the Earth-fixed axes, scalar last, in place of the angles."""
    rate_deg_s: Vector | None = None
    """Angular velocity of the body, in body axes: it blurs the exposure."""
    hold: Literal["lvlh", "inertial"] | None = None
    """What the rate is counted from: `lvlh`, or `inertial`, which adds the orbital rate."""
    exposure_s: Positive | None = None
    """Exposure time."""
    seed: Seed = 0
    """Another one is another draw of all noise."""
    band: Text | None = None
    """Name of a band; the camera's first one without."""
    head: Text | None = None
    """Name of a head, of a camera that has several."""
    truth: bool = False
    """Whether the reply holds the exact truth."""
    radiance: bool = False
    """Whether the reply holds the band's radiance."""

    @field_validator("epoch_utc")
    @classmethod
    def _is_a_time(cls, value: str | None) -> str | None:
        if value is not None:
            _time(value)
        return value

    @model_validator(mode="after")
    def _says_nothing_twice(self) -> ImageRequest:
        given = {key for key in type(self).model_fields if getattr(self, key) is not None}
        if self.position_itrs_km is not None and given & set(GEODETIC):
            raise ValueError("position_itrs_km says the whole place; leave out latitude, longitude and altitude")
        if {"velocity_itrs_km_s", "heading_deg"} <= given:
            raise ValueError("give at most one of velocity_itrs_km_s and heading_deg")
        if len(given & set(QUATERNIONS)) + bool(given & set(ANGLES)) > 1:
            raise ValueError(f"give at most one of {', '.join(QUATERNIONS)}, and yaw, pitch and roll")
        for key in QUATERNIONS:
            q = getattr(self, key)
            if q is not None and abs(math.hypot(*q) - 1.0) > UNIT_LENGTH:
                raise ValueError(f"{key} has the length {math.hypot(*q):.7g}; divide it by its length")
        return self

    @property
    def epoch(self) -> datetime | None:
        """The instant, with its time zone; None where the scene's holds."""
        return None if self.epoch_utc is None else _time(self.epoch_utc)


def _time(text: str) -> datetime:
    try:
        value = datetime.fromisoformat(text)
    except ValueError:
        raise ValueError(f"found {text[:40]!r}, expected a date and time such as 2026-03-20T12:00:00Z") from None
    return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


def identity_of(message: Mapping[str, Any]) -> int | str | None:
    """Return the ``id`` that a reply repeats; None where there is none that can be repeated."""
    identity = message.get("id")
    short = isinstance(identity, str) and len(identity) <= 256
    return identity if short or (type(identity) is int and abs(identity) < 1 << 63) else None


def kind_of(message: Mapping[str, Any]) -> str:
    """Return what a message asks for, after checking that it follows our schema.

    Raises
    ------
    UserError
        Another schema or version, no kind, or an ``id`` that is none.
    """
    if message.get("schema") != SCHEMA:
        found = f"found {message['schema']!r}" if "schema" in message else "missing"
        raise UserError(found, where="request: schema", expected=repr(SCHEMA))
    if message.get("id") is not None and identity_of(message) is None:
        raise UserError("found something else", where="request: id", expected="a whole number, or text of 256 letters")
    kind = message.get("kind")
    if kind not in KINDS:
        found = f"found {kind!r}" if "kind" in message else "missing"
        raise UserError(found, where="request: kind", expected=f"one of {', '.join(nearest(str(kind), KINDS))}")
    return str(kind)


def image_request(message: Mapping[str, Any]) -> ImageRequest:
    """Return a checked request for an image of a message that asks for one.

    Raises
    ------
    UserError
        An unknown key, a value that cannot be, or two keys that say the same.
    """
    data = {key: value for key, value in message.items() if key not in ("schema", "kind", "id", "token")}
    return validate(ImageRequest, data, "request")
