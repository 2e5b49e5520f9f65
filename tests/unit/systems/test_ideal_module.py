"""The comparisons of the ideal module: they hold, and they would notice."""

from __future__ import annotations

import numpy as np
import pytest
from horizonval.systems.c.frames import edge_points, reading_of_edge
from horizonval.systems.c.poses import (
    RADIUS_M,
    departures,
    documented_reading,
    exact_reading,
    known_poses,
    pose_above_horizon,
)
from scipy.spatial.transform import Rotation

from horizonval.estimation.methods.ideal import ideal_horizon_sensor
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import horizon_directions
from horizonval.systems.c import poses as ideal_module_poses
from horizonval.systems.c.experiment import LIMIT_RAD

R = np.array([0.0, RADIUS_M + 700e3, 0.0])


def test_module_documentation_and_exact_curve_agree() -> None:
    found = departures({"seed": 5, "count": 60, "brute": 6})
    assert max(*found["documented"], *found["exact"], found["tangent"], found["brute"]) < LIMIT_RAD


def test_known_poses_read_as_they_must() -> None:
    found = known_poses({"seed": 5, "count": 60})
    assert found["wrong"] == 0
    assert found["statuses"] == 0
    assert max(found["pitch"], found["roll"], found["level"], found["near_axis"]) < LIMIT_RAD


@pytest.mark.parametrize("reading", [documented_reading, exact_reading])
def test_yardsticks_read_a_known_pose(reading) -> None:
    """2 deg below the horizon, the right axis 10 deg up."""
    q = pose_above_horizon(R, RADIUS_M, np.radians(-2.0), np.radians(10.0), 0.7)
    roll, pitch, point = reading(R, q, RADIUS_M)
    assert np.degrees([roll, pitch]) == pytest.approx([10.0, -2.0], abs=1e-9)
    # A tangent: the line to H passes the centre at the radius.
    assert np.linalg.norm(np.cross(R, point)) == pytest.approx(RADIUS_M, rel=1e-12)


def test_comparison_notices_a_turn_of_two_nanoradians(monkeypatch: pytest.MonkeyPatch) -> None:
    turn = Rotation.from_rotvec([2e-9, 2e-9, 2e-9])

    def turned(r, q, radius_m):
        return ideal_horizon_sensor(r, (turn * Rotation.from_quat(q)).as_quat(), radius_m)

    monkeypatch.setattr(ideal_module_poses, "ideal_horizon_sensor", turned)
    found = departures({"seed": 5, "count": 20, "brute": 2})
    assert min(found["exact"]) > LIMIT_RAD


def test_an_edge_is_read_from_the_shares_of_its_pixels() -> None:
    """A straight edge over a picture, Earth below or to the right: exact, since a column's sum is the mean place."""
    columns = np.arange(40.0)
    edge = 11.3 + 0.25 * columns
    below = np.clip(np.arange(30.0)[:, None] + 0.5 - edge, 0.0, 1.0)
    points = edge_points(below)
    assert len(points) > 30
    assert points[:, 1] == pytest.approx(np.interp(points[:, 0], columns, edge), abs=1e-12)
    upright = edge_points(np.clip(np.arange(60.0) + 0.5 - (20.7 + 0.1 * np.arange(50.0))[:, None], 0.0, 1.0))
    assert upright[:, 0] == pytest.approx(20.7 + 0.1 * upright[:, 1], abs=1e-12)


def test_a_picture_is_read_as_the_pose_is() -> None:
    """Lines of sight to the exact horizon, half of it in view; and a module off by a minute of arc would show."""
    q = pose_above_horizon(R, RADIUS_M, np.radians(-7.0), np.radians(130.0), 0.4)
    los = Rotation.from_quat(q).apply(horizon_directions(R, sphere(RADIUS_M), np.linspace(-1.0, 1.0, 50)))
    roll, pitch = reading_of_edge(los)
    found = ideal_horizon_sensor(R, q, RADIUS_M)
    assert (roll, pitch) == pytest.approx((found.roll_error_rad, found.pitch_error_rad), abs=1e-9)
