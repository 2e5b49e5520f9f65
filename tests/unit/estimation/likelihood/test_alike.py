"""How alike air is at two places, against matrices of three by three and against what is the same everywhere."""

from __future__ import annotations

import numpy as np
import pytest

from horizonval.estimation.likelihood.height import correlations, lengths_along

POLE = np.array([0.0, 0.0, 1.0])


def places(count: int, seed: int) -> np.ndarray:
    up = np.random.default_rng(seed).standard_normal((count, 3))
    return np.asarray(up / np.linalg.norm(up, axis=1, keepdims=True))


def test_the_closed_form_is_that_of_whole_matrices() -> None:
    """Equation 1 of Paciorek and Schervish (2006) with determinants and inverses by numpy, north by the meridian."""
    up = places(12, 2)
    lengths = np.random.default_rng(3).uniform(0.1, 1.2, (12, 1, 2))
    latitude, longitude = np.arcsin(up[:, 2]), np.arctan2(up[:, 1], up[:, 0])
    north = np.column_stack(
        [-np.sin(latitude) * np.cos(longitude), -np.sin(latitude) * np.sin(longitude), np.cos(latitude)]
    )
    found = correlations(lengths, up, POLE)[0]
    kernel = [
        east**2 * np.eye(3) + (along**2 - east**2) * np.outer(n, n)
        for n, (along, east) in zip(north, lengths[:, 0], strict=True)
    ]
    for i in range(12):
        for j in range(12):
            middle, d = 0.5 * (kernel[i] + kernel[j]), up[i] - up[j]
            size = (np.linalg.det(kernel[i]) * np.linalg.det(kernel[j])) ** 0.25 / np.linalg.det(middle) ** 0.5
            assert found[i, j] == pytest.approx(size * np.exp(-0.5 * d @ np.linalg.solve(middle, d)), rel=1e-10)


def test_it_is_a_covariance_over_a_pole_and_wherever_lengths_change() -> None:
    latitude = np.radians(np.linspace(40.0, 140.0, 51))
    up = np.column_stack([np.cos(latitude), np.zeros(51), np.sin(latitude)])
    lengths = np.random.default_rng(4).uniform(0.05, 1.5, (51, 3, 2))
    found = correlations(lengths, up, POLE)
    assert np.linalg.eigvalsh(found).min() > -1e-12
    np.testing.assert_allclose(np.einsum("kii->ki", found), 1.0, rtol=1e-12)


def test_lengths_along_a_line_are_those_of_its_direction() -> None:
    up = np.array([[1.0, 0.0, 0.0]] * 3)
    level = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    lengths = np.broadcast_to([0.2, 0.5], (3, 1, 2))
    slanted = (0.5 * (0.2**-2 + 0.5**-2)) ** -0.5
    np.testing.assert_allclose(lengths_along(lengths, up, level, POLE)[:, 0], [0.2, 0.5, slanted], rtol=1e-12)
