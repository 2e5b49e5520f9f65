"""Rivals of the altitude-free method on exact lines of sight."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import off_axis_angle, tangent_basis
from horizonval.systems.a.rivals import SeenPixels, known_altitude, straight_line, two_sensors

CAMERA = CameraModel(400, 400, 346.0, 346.0, 199.5, 199.5)


def seen(nadir: np.ndarray, rho: float, told: float | None = None) -> SeenPixels:
    """Return the exact limb that falls into the camera."""
    basis = tangent_basis(nadir)
    turn = np.linspace(0.0, 2.0 * np.pi, 4001)
    los = math.cos(rho) * nadir + math.sin(rho) * (
        np.cos(turn)[:, None] * basis[:, 0] + np.sin(turn)[:, None] * basis[:, 1]
    )
    uv, in_front = project(CAMERA, los)
    inside = in_front & (np.abs(uv - 199.5) < 200.0).all(axis=1)
    return SeenPixels(los[inside], uv[inside], CAMERA, rho if told is None else told)


NADIR = np.array([0.2, 0.85, 0.6]) / np.linalg.norm([0.2, 0.85, 0.6])
RHO = math.radians(65.0)


def test_a_known_altitude_gives_the_exact_nadir_and_a_wrong_one_does_not() -> None:
    assert off_axis_angle(known_altitude(seen(NADIR, RHO)), NADIR) < 1e-9
    assert off_axis_angle(known_altitude(seen(NADIR, RHO, RHO + 1e-3)), NADIR) > 3e-4


def test_a_straight_line_misses_by_the_arcs_bend() -> None:
    """The arc bends away from its line by a few degrees over this field; nearly flat ones are met."""
    assert 1e-3 < off_axis_angle(straight_line(seen(NADIR, RHO)), NADIR) < 0.2
    flat = np.array([0.0, math.sin(math.radians(89.0)), math.cos(math.radians(89.0))])
    assert off_axis_angle(straight_line(seen(flat, math.radians(89.0))), flat) < 2e-3


def test_two_chords_are_exact() -> None:
    """The second camera is the first one turned about the nadir, its lines of sight in the first one's axes."""
    first = seen(NADIR, RHO)
    turned = Rotation.from_rotvec(0.5 * math.pi * NADIR).apply(first.los)
    found = two_sensors(first, SeenPixels(turned, first.uv, CAMERA, RHO))
    assert found is not None
    assert off_axis_angle(found, NADIR) == pytest.approx(0.0, abs=1e-9)
