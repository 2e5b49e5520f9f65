"""What the oracle command says of a pose."""

from __future__ import annotations

import math

import pytest
from synthetic import truth_at

from horizonval.commands.oracle import oracle_of
from horizonval.geometry.ellipsoid import sphere

CAMERA = {
    "camera": {"name": "c", "width": 64, "height": 48, "fov_deg": 50.0},
    "band": [{"name": "red", "kind": "solar", "lo_um": 0.6, "hi_um": 0.7}],
}


def test_both_readings_of_a_pose_off_the_nadir() -> None:
    truth = truth_at(CAMERA, roll_deg=55.0, yaw_deg=20.0, altitude_km=700.0)
    found = oracle_of(truth)
    assert found["status"] == "defined"
    off = math.degrees(math.acos(truth.nadir_geocentric_cam[2]))
    assert found["pitch_error_deg"] == pytest.approx(off - found["angular_radius_deg"], abs=1e-9)
    # The boresight is less than a quarter turn from the plane: both readings of the pitch agree.
    assert found["pitch_elevation_deg"] == pytest.approx(found["pitch_error_deg"], abs=1e-9)
    assert found["roll_deg"] == pytest.approx(55.0)


def test_a_boresight_at_the_nadir_has_a_status_and_no_number() -> None:
    """Over a sphere, where the geodetic and the geocentric nadir are one."""
    truth = truth_at(CAMERA, ellipsoid=sphere(6371e3))
    found = oracle_of(truth)
    assert found["status"] == "boresight_at_nadir"
    assert found["roll_error_deg"] is None
    assert found["horizon_cam"] is None
