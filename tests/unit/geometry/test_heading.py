"""`platform.heading_deg` is the geocentric azimuth of the velocity."""

from __future__ import annotations

import math

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.geometry.frames import inverse, rotate
from horizonval.geometry.orbit import heading
from horizonval.geometry.pose import Pose, pose_from_spec
from horizonval.spec.scene import SceneSpec

ARCSEC = math.radians(1.0 / 3600.0)


def pose_of(latitude_deg: float, heading_deg: float) -> Pose:
    platform = {"altitude_km": 500.0, "latitude_deg": latitude_deg, "longitude_deg": 25.0, "heading_deg": heading_deg}
    return pose_from_spec(SceneSpec.model_validate({"camera": {"file": "test"}, "platform": platform}))


def axis_itrs(pose: Pose, axis: int) -> FloatArray:
    return rotate(inverse(pose.q_lvlh_from_itrs), np.eye(3)[axis])


@pytest.mark.parametrize("heading_deg", [-135.0, -20.0, 45.0, 100.0])
@pytest.mark.parametrize("latitude_deg", [-60.0, 0.0, 45.0])
def test_orbit_of_the_heading_has_the_inclination_of_spherical_trigonometry(
    latitude_deg: float, heading_deg: float
) -> None:
    """Clairaut's relation, ``cos i = cos(geocentric latitude) sin(heading)``, for the plane of position and x."""
    pose = pose_of(latitude_deg, heading_deg)
    x, y, z = pose.r_itrs
    geocentric_latitude = math.atan2(z, math.hypot(x, y))
    inclination = math.acos(math.cos(geocentric_latitude) * math.sin(math.radians(heading_deg)))
    normal = np.cross(pose.r_itrs, axis_itrs(pose, 0))
    assert math.acos(normal[2] / np.linalg.norm(normal)) == pytest.approx(inclination, abs=1e-12)


def test_flown_orbits_mean_the_same_azimuth() -> None:
    """The heading of a velocity, put into a scene, points x along its part across the line to the centre."""
    r = pose_of(45.0, 0.0).r_itrs
    velocity = np.array([-3e3, 4.5e3, 5.2e3])
    x = axis_itrs(pose_of(45.0, math.degrees(float(heading(r, velocity)))), 0)
    level = velocity - (velocity @ r) / (r @ r) * r
    assert x == pytest.approx(level / np.linalg.norm(level), abs=1e-12)
