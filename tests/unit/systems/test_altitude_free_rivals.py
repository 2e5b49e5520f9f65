"""System A: rivals of the altitude-free method on exact lines of sight, and the count of steps."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.systems.a.experiment import after_four_steps, iterates, known_altitude, two_sensors

NADIR = np.array([0.2, 0.85, 0.6]) / np.linalg.norm([0.2, 0.85, 0.6])
RHO = math.radians(65.0)
TURN = np.linspace(-0.6, 0.5, 400)[:, None]
LOS = math.cos(RHO) * NADIR + math.sin(RHO) * (tangent_basis(NADIR) @ np.hstack([np.cos(TURN), np.sin(TURN)]).T).T


def test_a_known_altitude_gives_the_exact_nadir_and_a_wrong_one_does_not() -> None:
    assert off_axis_angle(known_altitude(LOS, RHO), NADIR) < 1e-9
    assert off_axis_angle(known_altitude(LOS, RHO + 1e-3), NADIR) > 3e-4


def test_two_chords_are_exact() -> None:
    """The second camera is the first one turned about the nadir, its lines of sight in the first one's axes."""
    turned = Rotation.from_rotvec(0.5 * math.pi * NADIR).apply(LOS)
    assert off_axis_angle(two_sensors(LOS, turned), NADIR) == pytest.approx(0.0, abs=1e-9)


def test_the_distance_after_four_steps_is_that_of_the_fourth_iterate() -> None:
    run = {"steps": [[1.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.01, 0.0, 0.0], [1e-3, 0.0, 0.0], [1e-4, 0.0, 0.0], [0.0] * 3]}
    assert after_four_steps(run) == pytest.approx(1e-4)
    assert after_four_steps({"steps": run["steps"][:3]}) == 0.0
    assert all(one["summed"][-1] < 1e-9 for one in iterates(LOS).values())
