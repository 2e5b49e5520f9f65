"""One vocabulary of poses: what a program gives along Earth-fixed axes is the pose that the scene gets."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import horizonval as hv
from horizonval.api.client import ImageKeywords
from horizonval.api.scene import FLAT, TABLES, SceneKeywords
from horizonval.geometry.pose import pose_from_spec, scene_keys
from horizonval.serve.protocol import ImageRequest
from horizonval.spec.pose import VECTORS, PoseKeys

SCENE = hv.Scene(
    "vis-cmos-512-60deg", altitude_km=550, latitude_deg=10, heading_deg=40, yaw_deg=5, epoch_utc="2026-03-20T12:00Z"
)


def test_files_python_and_the_service_have_the_same_keys():
    assert set(SceneKeywords.__annotations__) == {*FLAT, *VECTORS, *TABLES}
    assert set(ImageKeywords.__annotations__) == set(ImageRequest.model_fields)
    assert set(ImageRequest.model_fields) & set(SceneKeywords.__annotations__) == {*PoseKeys.model_fields, "seed"}
    named = set(re.findall(r"\w+", str(hv.Scene.__doc__)))
    assert set(SceneKeywords.__annotations__) - named <= {"scene", "platform", "attitude"}


def test_what_is_left_out_is_as_in_the_scene():
    assert SCENE.changed() == SCENE
    assert scene_keys(PoseKeys(), SCENE.spec, "") == {}


@pytest.mark.parametrize("place", [(51.0, -170.0, 420.0), (-89.9, 3.0, 800.0), (0.0, 180.0, 35786.0)])
def test_a_position_along_earth_fixed_axes_comes_back(place):
    latitude, longitude, altitude = place
    there = SCENE.changed(latitude_deg=latitude, longitude_deg=longitude, altitude_km=altitude)
    r_itrs = pose_from_spec(there.spec).r_itrs
    for scene in (SCENE.changed(position_itrs_km=r_itrs / 1e3), hv.Scene(SCENE.camera, position_itrs_km=r_itrs / 1e3)):
        assert np.linalg.norm(pose_from_spec(scene.spec).r_itrs - r_itrs) < 2e-8


def test_the_heading_is_that_among_the_stars():
    """A polar orbit keeps its plane among the stars; over the ground it drifts to the west."""
    r = np.array([6928.0, 0.0, 0.0])
    turning = np.cross([0.0, 0.0, 7.292115146706979e-5], r)
    polar = SCENE.changed(position_itrs_km=r, velocity_itrs_km_s=np.array([0.3, 0.0, 7.6]) - turning)
    assert abs(polar.spec.platform.heading_deg) < 1e-12
    still = SCENE.changed(position_itrs_km=r, velocity_itrs_km_s=(0.0, 0.0, 0.0))
    assert still.spec.platform.heading_deg == pytest.approx(90.0)


def test_an_attitude_against_earth_fixed_axes_is_that_of_the_camera():
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = Rotation.random(rng=rng).as_quat()
        pose = pose_from_spec(SCENE.changed(latitude_deg=-30.0, heading_deg=120.0, q_body_from_itrs=q).spec)
        body_from_itrs = Rotation.from_quat(pose.q_body_from_lvlh) * Rotation.from_quat(pose.q_lvlh_from_itrs)
        assert (body_from_itrs * Rotation.from_quat(q).inv()).magnitude() < 1e-14


def test_a_quaternion_against_lvlh_and_its_angles_are_the_same():
    truth = pose_from_spec(SCENE.changed(yaw_deg=12, pitch_deg=-4, roll_deg=3).spec)
    found = SCENE.changed(q_body_from_lvlh=truth.q_body_from_lvlh).spec.attitude
    assert (found.yaw_deg, found.pitch_deg, found.roll_deg) == pytest.approx((12, -4, 3), abs=1e-13)
    # Bit by bit: the noise is drawn from the scene as it is written.
    found = scene_keys(PoseKeys(q_body_from_lvlh=(0.0, 0.0, 0.0, 1.0)), SCENE.spec, "")
    assert [str(value) for value in found.values()] == ["0.0", "0.0", "0.0"]


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        ({"position_itrs_km": (0.0, 0.0, 0.0)}, "Scene: position_itrs_km"),
        ({"position_itrs_km": (6378.0, 0.0, 0.0)}, "Scene: position_itrs_km"),
        ({"position_itrs_km": (6.9e6, 0.0, 0.0)}, "Scene: position_itrs_km"),
        ({"position_itrs_km": (1e300, 1e300, 0.0)}, "Scene: position_itrs_km"),
        ({"position_itrs_km": (0.0, 0.0, 7000.0), "velocity_itrs_km_s": (0.0, 0.0, 7.0)}, "Scene: velocity_itrs_km_s"),
    ],
)
def test_a_place_that_is_none_is_one_line(keys, where):
    with pytest.raises(hv.UserError) as raised:
        SCENE.changed(**keys)
    assert raised.value.where == where
