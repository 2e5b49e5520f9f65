"""System C: the comparisons of the ideal module hold, and they would notice an error."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.core.errors import UserError
from horizonval.estimation.methods.ideal import horizon_sensor
from horizonval.geometry.ellipsoid import sphere
from horizonval.geometry.horizon import horizon_directions
from horizonval.systems.c import experiment
from horizonval.systems.c.experiment import RADIUS_M, edge_points, pose_above_horizon, reading_of_edge

R = np.array([0.0, RADIUS_M + 700e3, 0.0])


def test_points_and_axes_of_the_module_are_those_of_its_text() -> None:
    q = pose_above_horizon(R, np.radians(-2.0), np.radians(10.0), 0.7)
    found = horizon_sensor(R, q, RADIUS_M)
    nadir = Rotation.from_quat(q).apply(-R / np.linalg.norm(R))
    assert np.arccos(found.tangents_cam @ nadir) == pytest.approx(found.theta_rad, abs=1e-12)
    assert np.sin(found.theta_rad) == pytest.approx(RADIUS_M / np.linalg.norm(R))
    assert found.axes_cam @ found.axes_cam.T == pytest.approx(np.eye(3), abs=1e-12)
    forward, right, up = found.axes_cam
    assert np.cross(forward, up) == pytest.approx(right)
    assert forward == pytest.approx(found.horizon_cam)
    assert up @ nadir < 0.0
    assert np.degrees([found.roll_error_rad, found.pitch_error_rad]) == pytest.approx([10.0, -2.0], abs=1e-9)


@pytest.mark.parametrize(
    ("position", "attitude", "radius"),
    [([0, 0, 0], [0, 0, 0, 1], 1.0), ([1, 2], [0, 0, 0, 1], 1.0), ([9, 0, 0], [0, 0, 0, 0], 1.0),
     ([9, 0, 0], [0, 0, 0, 1], 0.0)],
)  # fmt: skip
def test_what_is_no_pose_is_refused(position: list[float], attitude: list[float], radius: float) -> None:
    with pytest.raises(UserError):
        horizon_sensor(position, attitude, radius)


def test_the_comparison_notices_a_turn_of_two_nanoradians(monkeypatch: pytest.MonkeyPatch) -> None:
    item = {"seed": 5, "count": 20}
    assert max(experiment.random_figures(item)["off"]) < 1e-9
    turn = Rotation.from_rotvec([2e-9, 2e-9, 2e-9])
    monkeypatch.setattr(
        experiment,
        "horizon_sensor",
        lambda r, q, radius: horizon_sensor(r, (turn * Rotation.from_quat(q)).as_quat(), radius),
    )
    point, _, roll, pitch = experiment.random_figures(item)["off"]
    assert min(point, roll, pitch) > 1e-9


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
    """Lines of sight to the exact horizon, half of it in view."""
    q = pose_above_horizon(R, np.radians(-7.0), np.radians(130.0), 0.4)
    los = Rotation.from_quat(q).apply(horizon_directions(R, sphere(RADIUS_M), np.linspace(-1.0, 1.0, 50)))
    found = horizon_sensor(R, q, RADIUS_M)
    assert reading_of_edge(los) == pytest.approx((found.roll_error_rad, found.pitch_error_rad), abs=1e-9)
