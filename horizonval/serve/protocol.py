"""What a client may ask for, key by key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from horizonval.core.errors import UserError, one_of
from horizonval.spec.detector import LONGEST_EXPOSURE_S
from horizonval.spec.load import validate
from horizonval.spec.pose import PoseKeys
from horizonval.wire import SCHEMA

Text = Annotated[str, Field(max_length=256)]
Seed = Annotated[int, Field(ge=0, lt=1 << 63)]
KINDS = ("image", "status")


class ImageRequest(PoseKeys):
    """One image: its pose, how long it is exposed. What is left out is as in the scene that is served."""

    exposure_s: Annotated[float, Field(gt=0, le=LONGEST_EXPOSURE_S)] | None = None
    """Exposure time."""
    seed: Seed = 0
    """Another one is another draw of all noise."""
    band: Text | None = None
    """Name of a band; the camera's first one without."""
    truth: bool = False
    """Whether the reply holds the exact truth."""
    radiance: bool = False
    """Whether the reply holds the band's radiance."""


def identity_of(message: Mapping[str, Any]) -> int | str | None:
    """Return the ``id`` that a reply repeats; None where there is none that can be repeated."""
    identity = message.get("id")
    short = isinstance(identity, str) and len(identity) <= 256
    return identity if short or (type(identity) is int and abs(identity) < 1 << 63) else None


def kind_of(message: Mapping[str, Any]) -> str:
    """Return what a message asks for; ``UserError`` for another schema, no kind, or an invalid ``id``."""
    if message.get("schema") != SCHEMA:
        found = f"found {message['schema']!r}" if "schema" in message else "missing"
        raise UserError(found, where="request: schema", expected=repr(SCHEMA))
    if message.get("id") is not None and identity_of(message) is None:
        raise UserError("found something else", where="request: id", expected="a whole number, or text of 256 letters")
    kind = message.get("kind")
    if kind not in KINDS:
        found = f"found {kind!r}" if "kind" in message else "missing"
        raise UserError(found, where="request: kind", expected=one_of(kind, KINDS))
    return str(kind)


def image_request(message: Mapping[str, Any]) -> ImageRequest:
    """Return a checked request for an image; ``UserError`` for unknown, invalid or contradicting keys."""
    head = ("schema", "kind", "id", "token")
    data = {key: value for key, value in message.items() if key not in head and value is not None}
    return validate(ImageRequest, data, "request")
