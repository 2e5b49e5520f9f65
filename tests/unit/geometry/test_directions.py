"""Vectors across a direction, angles between two, and points spread over the sphere."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from horizonval.geometry.rotation import (
    angle_between,
    fibonacci_sphere,
    off_axis_angle,
    perpendicular,
    rotation_vector,
    tangent_basis,
)

AXES = [np.array(v) / np.linalg.norm(v) for v in ([0, 0, 1], [1, 0, 0], [-1, 2, 3], [1e-9, 1, 0], [1, 1, 1])]


@pytest.mark.parametrize("axis", AXES)
def test_tangent_basis_is_a_right_handed_triad(axis):
    basis = tangent_basis(axis)
    triad = np.column_stack([basis, axis])
    np.testing.assert_allclose(triad.T @ triad, np.eye(3), atol=1e-15)
    assert np.linalg.det(triad) == pytest.approx(1.0)
    np.testing.assert_array_equal(perpendicular(axis), -basis[:, 0])


def test_angles_keep_their_digits_at_both_ends():
    axis = np.array([0.0, 0.0, 1.0])
    for angle in (0.0, 1e-12, 1.0, math.pi / 2, math.pi - 1e-12, math.pi):
        d = np.array([math.sin(angle), 0.0, math.cos(angle)])
        assert angle_between(axis, 3.0 * d) == pytest.approx(angle, rel=1e-15, abs=1e-15)
        assert off_axis_angle(d, axis) == pytest.approx(angle, rel=1e-15, abs=1e-15)


def test_the_spiral_spreads_points_evenly():
    points = fibonacci_sphere(1000)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, rtol=1e-15)
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=1e-3)
    # Neighbours of points that lie evenly are about as far apart as the square root of each one's area.
    cosine = points @ points.T
    np.fill_diagonal(cosine, -1.0)
    nearest = np.arccos(cosine.max(axis=1)) / math.sqrt(4 * math.pi / 1000)
    assert 0.7 < nearest.min() <= nearest.max() < 1.1


@pytest.mark.parametrize("angle_rad", [0.0, 1e-9, 1e-3, 1.0, 1.6, 3.0])
def test_rotation_vector_is_scipys(angle_rad):
    axis = np.array([0.48, -0.6, 0.64])
    matrix = Rotation.from_rotvec(angle_rad * axis).as_matrix()
    np.testing.assert_allclose(rotation_vector(matrix), angle_rad * axis, rtol=0.0, atol=4e-16 + 4e-16 * angle_rad)
