"""Every key of a request is checked, and a mistake is one line that names it."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest

from horizonval.core.errors import UserError
from horizonval.serve.protocol import ImageRequest, identity_of, image_request, kind_of
from horizonval.wire import SCHEMA

HEAD: dict[str, Any] = {"schema": SCHEMA, "kind": "image"}
NAN, INF = float("nan"), float("inf")

GOOD: dict[str, Any] = {
    "epoch_utc": "2026-03-20T12:00:00Z",
    "latitude_deg": 10,
    "longitude_deg": -20.5,
    "altitude_km": 550.0,
    "heading_deg": 90.0,
    "position_itrs_km": [6900.0, 0, 0],
    "velocity_itrs_km_s": [0.0, 1.0, 7.0],
    "yaw_deg": 1.0,
    "pitch_deg": 2.0,
    "roll_deg": 3.0,
    "q_body_from_lvlh": [0, 0, 0, 1],
    "q_body_from_itrs": [0.6, 0.0, 0.0, 0.8],
    "rate_deg_s": [0.0, 0.1, 0.0],
    "mount_yaw_deg": 1.0,
    "mount_pitch_deg": 2.0,
    "mount_roll_deg": 3.0,
    "hold": "inertial",
    "exposure_s": 1e-3,
    "seed": 7,
    "band": "vis",
    "head": "a",
    "truth": True,
    "radiance": False,
}
NUMBERS = ["7", True, NAN, INF, [1.0], {}, b"1"]
VECTORS = ["123", 1.0, [1.0, 2.0], [1.0, 2.0, NAN], [1.0, 2.0, "3"], [1.0, 2.0, 3.0, 4.0, 5.0]]
ANGLES = [key for key in GOOD if key.endswith(("yaw_deg", "pitch_deg", "roll_deg", "longitude_deg", "heading_deg"))]
BAD: dict[str, list[Any]] = {
    **{key: [*NUMBERS, -400, 361] for key in ANGLES},
    **{key: VECTORS for key in ("position_itrs_km", "velocity_itrs_km_s", "rate_deg_s")},
    "latitude_deg": [*NUMBERS, 90.1, -91],
    "altitude_km": [*NUMBERS, 0, -5, 3e6],
    "exposure_s": [*NUMBERS, 0, -1e-3],
    "epoch_utc": ["noon", 7, "2026-13-01", "x" * 300, "", "0001-01-01T00:00:00+02:00"],
    "q_body_from_lvlh": [*VECTORS, [0, 0, 0, 0], [0, 0, 0, 1.1]],
    "q_body_from_itrs": [*VECTORS, [1, 1, 1, 1]],
    "hold": ["earth", 1],
    "seed": ["7", True, 1.5, -1, 1 << 63],
    "band": [1, [], "x" * 300],
    "head": [1, [], "x" * 300],
    "truth": [1, "yes", []],
    "radiance": [0, "no", {}],
}


def test_every_key_is_tried():
    assert set(GOOD) == set(BAD) == set(ImageRequest.model_fields)


@pytest.mark.parametrize("key", GOOD)
def test_a_good_value_is_taken_and_a_bad_one_is_one_line_that_names_the_key(key):
    image_request({**HEAD, key: GOOD[key]})
    for value in BAD[key]:
        with pytest.raises(UserError) as raised:
            image_request({**HEAD, key: value})
        line = raised.value.line()
        assert line.startswith("request")
        assert key in line
        assert "\n" not in line


def test_an_unknown_key_is_one_line_that_offers_the_nearest():
    with pytest.raises(UserError, match="request: rol_deg: unknown key; expected one of roll_deg"):
        image_request({**HEAD, "rol_deg": 1.0})


@pytest.mark.parametrize(
    "keys",
    [
        ("position_itrs_km", "latitude_deg"),
        ("position_itrs_km", "altitude_km"),
        ("velocity_itrs_km_s", "heading_deg"),
        ("q_body_from_lvlh", "q_body_from_itrs"),
        ("q_body_from_lvlh", "yaw_deg"),
        ("q_body_from_itrs", "roll_deg"),
    ],
)
def test_what_is_said_twice_is_refused(keys):
    with pytest.raises(UserError, match="request"):
        image_request({**HEAD, **{key: GOOD[key] for key in keys}})


def test_an_epoch_without_offset_is_utc():
    noon = datetime(2026, 3, 20, 12, tzinfo=UTC)
    for text in ("2026-03-20T12:00:00", "2026-03-20T12:00:00Z", "2026-03-20T14:00:00+02:00"):
        assert image_request({**HEAD, "epoch_utc": text}).given == {"epoch_utc": noon}
    assert image_request(HEAD).given == {}


@pytest.mark.parametrize(
    ("key", "messages"),
    [
        ("schema", [{}, {"schema": "horizonval/2", "kind": "image"}, {"schema": 1, "kind": "image"}]),
        ("kind", [{"schema": SCHEMA}, {"schema": SCHEMA, "kind": "picture"}, {"schema": SCHEMA, "kind": ["image"]}]),
        ("id", [{**HEAD, "id": identity} for identity in (1.5, "x" * 300, True, 1 << 63)]),
    ],
)
def test_what_follows_another_schema_is_refused(key, messages):
    for message in messages:
        with pytest.raises(UserError) as raised:
            kind_of(message)
        assert raised.value.where == f"request: {key}"


def test_an_id_is_repeated_as_it_is():
    assert identity_of({"id": -3}) == -3
    assert identity_of({"id": "step 4"}) == "step 4"
    assert identity_of({"id": []}) is None
    assert kind_of({**HEAD, "id": "step 4"}) == "image"
