"""What a simulator has along Earth-fixed axes is the pose that the scene gets."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.core.errors import UserError
from horizonval.geometry.pose import pose_from_spec
from horizonval.serve.pose import attitude_keywords, place_keywords
from horizonval.serve.protocol import ImageRequest

SCENE = hv.Scene(
    "vis-cmos-512-60deg", altitude_km=550, latitude_deg=10, heading_deg=40, yaw_deg=5, epoch="2026-03-20T12:00Z"
)


def _moved(request: ImageRequest, **changes: object) -> hv.Scene:
    return SCENE.changed(**place_keywords(request, SCENE.spec), **changes)


def test_what_is_left_out_is_as_in_the_scene():
    assert _moved(ImageRequest()) == SCENE
    assert attitude_keywords(ImageRequest(), SCENE.spec) == {}


@pytest.mark.parametrize("place", [(51.0, -170.0, 420.0), (-89.9, 3.0, 800.0), (0.0, 180.0, 35786.0)])
def test_a_position_along_earth_fixed_axes_comes_back(place):
    latitude, longitude, altitude = place
    there = SCENE.changed(latitude_deg=latitude, longitude_deg=longitude, altitude_km=altitude)
    r_itrs = pose_from_spec(there.spec).r_itrs
    found = pose_from_spec(_moved(ImageRequest(position_itrs_km=tuple(r_itrs / 1e3))).spec).r_itrs
    assert np.linalg.norm(found - r_itrs) < 2e-8


def test_the_heading_is_that_among_the_stars():
    """A polar orbit keeps its plane among the stars; over the ground it drifts to the west."""
    r = np.array([6928.0, 0.0, 0.0])
    turning = np.cross([0.0, 0.0, 7.292115146706979e-5], r)
    request = ImageRequest(position_itrs_km=tuple(r), velocity_itrs_km_s=tuple(np.array([0.3, 0.0, 7.6]) - turning))
    assert abs(place_keywords(request, SCENE.spec)["heading_deg"]) < 1e-12
    still = ImageRequest(position_itrs_km=tuple(r), velocity_itrs_km_s=(0.0, 0.0, 0.0))
    assert place_keywords(still, SCENE.spec)["heading_deg"] == pytest.approx(90.0)


def test_an_attitude_against_earth_fixed_axes_is_that_of_the_camera():
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = Rotation.random(rng=rng).as_quat()
        request = ImageRequest(latitude_deg=-30.0, heading_deg=120.0, q_body_from_itrs=tuple(q))
        moved = _moved(request)
        turned = moved.changed(**attitude_keywords(request, moved.spec))
        pose = pose_from_spec(turned.spec)
        body_from_itrs = Rotation.from_quat(pose.q_body_from_lvlh) * Rotation.from_quat(pose.q_lvlh_from_itrs)
        assert (body_from_itrs * Rotation.from_quat(q).inv()).magnitude() < 1e-14


def test_a_quaternion_against_lvlh_and_its_angles_are_the_same():
    truth = pose_from_spec(SCENE.changed(yaw_deg=12, pitch_deg=-4, roll_deg=3).spec)
    found = attitude_keywords(ImageRequest(q_body_from_lvlh=tuple(truth.q_body_from_lvlh)), SCENE.spec)
    assert [found[key] for key in ("yaw_deg", "pitch_deg", "roll_deg")] == pytest.approx([12, -4, 3], abs=1e-13)


def test_the_identity_is_the_scene_without_angles():
    """Bit by bit: the noise is drawn from the scene as it is written."""
    found = attitude_keywords(ImageRequest(q_body_from_lvlh=(0.0, 0.0, 0.0, 1.0)), SCENE.spec)
    assert [str(value) for value in found.values()] == ["0.0", "0.0", "0.0"]


def test_rates_and_single_angles_go_through():
    request = ImageRequest(roll_deg=2.0, rate_deg_s=(0.0, 0.5, 0.0), hold="inertial")
    assert attitude_keywords(request, SCENE.spec) == {
        "roll_deg": 2.0,
        "rate_deg_s": (0.0, 0.5, 0.0),
        "hold": "inertial",
    }


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ({"position_itrs_km": (0.0, 0.0, 0.0)}, "request: position_itrs_km"),
        ({"position_itrs_km": (6378.0, 0.0, 0.0)}, "request: position_itrs_km"),
        ({"position_itrs_km": (6.9e6, 0.0, 0.0)}, "request: position_itrs_km"),
        ({"position_itrs_km": (1e300, 1e300, 0.0)}, "request: position_itrs_km"),
        (
            {"position_itrs_km": (0.0, 0.0, 7000.0), "velocity_itrs_km_s": (0.0, 0.0, 7.0)},
            "request: velocity_itrs_km_s",
        ),
    ],
)
def test_a_place_that_is_none_is_one_line(keys, where):
    with pytest.raises(UserError) as raised:
        place_keywords(ImageRequest(**keys), SCENE.spec)
    assert raised.value.where == where
