"""Modes of an ensemble that is drawn here from modes that are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from horizonval.core.arrays import FloatArray
from horizonval.tables.modes import empirical_modes, kept_arrays, scene_mode, smoothed

HEIGHT = np.linspace(-20e3, 60e3, 41)


def ensemble(states: int):
    """Return departures (3, 4, states, 41) of two modes that grow along the first axis, and a little noise."""
    rng = np.random.default_rng(2)
    bell = np.exp(-(((HEIGHT - 20e3) / 8e3) ** 2))
    wave = np.sin(HEIGHT / 15e3)
    strong = np.array([1.0, 1.5, 2.0])[:, None, None] * np.array([bell, 0.4 * wave])
    a = rng.standard_normal((3, 4, states, 2))
    noise = 0.02 * rng.standard_normal((3, 4, states, len(HEIGHT)))
    return strong, np.einsum("abnk,akh->abnh", a, strong) + noise + 0.3


def test_covariance_is_that_of_the_ensemble_and_modes_are_smooth_from_place_to_place():
    strong, d = ensemble(4000)
    found = empirical_modes(d, np.ones(41), 2, around=True, beside=0.0)
    np.testing.assert_allclose(found.mean, 0.3, atol=0.15)
    for i in range(3):
        truth = strong[i].T @ strong[i] + 0.02**2 * np.eye(41)
        # of 4000 draws a covariance is known to some 3 %
        got = found.modes[i, 1].T @ found.modes[i, 1] + np.diag(found.left_variance[i, 1])
        np.testing.assert_allclose(got, truth, atol=0.1 * truth.max())
    np.testing.assert_allclose(np.sqrt(found.left_variance), 0.02, atol=0.006)
    # neighbours of one first coordinate have one truth: no flip of sign, no change of order
    size = np.abs(found.modes).max()
    assert np.abs(found.modes[:, 1:] - found.modes[:, :-1]).max() < 0.15 * size
    # half way between places the covariance is that of the modes' own interpolation
    middle = 0.5 * (found.modes[0] + found.modes[2])
    assert np.abs(middle - found.modes[1]).max() < 0.15 * size


def test_coefficients_of_the_ensemble_have_unit_variance_and_are_independent():
    _, d = ensemble(2000)
    found = empirical_modes(d, np.ones(41), 2, around=False, beside=0.0)
    c = found.coefficients.reshape(-1, 2)
    np.testing.assert_allclose(c.T @ c / len(c), np.eye(2), atol=0.03)


def test_shares_count_as_copies_would():
    _, d = ensemble(3)
    copies = np.repeat(d, [1, 2, 3], axis=2)
    plain = empirical_modes(copies, np.ones(41), 2, around=False)
    shared = empirical_modes(d, np.ones(41), 2, around=False, shares=np.array([1.0, 2.0, 3.0]) / 6.0)
    np.testing.assert_allclose(shared.mean, plain.mean, atol=1e-12)
    np.testing.assert_allclose(
        np.einsum("abkh,abkg->abhg", shared.modes, shared.modes),
        np.einsum("abkh,abkg->abhg", plain.modes, plain.modes),
        atol=1e-9,
    )


def test_what_a_scene_has_or_has_not_is_one_mode():
    effect = np.exp(-((HEIGHT / 10e3) ** 2))
    has = np.array([1.0, 0.0, 1.0, 1.0])[None, None]
    d = np.broadcast_to(effect, (3, 4, 4, 41)) * np.broadcast_to(has, (3, 4, 4))[..., None]
    found = scene_mode(d, np.broadcast_to(has, (1, 4, 4)), 0.75, around=True)
    np.testing.assert_allclose(found.mean, np.broadcast_to(0.75 * effect, (3, 4, 41)))
    np.testing.assert_allclose(found.mode, np.broadcast_to(np.sqrt(0.1875) * effect, (3, 4, 41)))
    np.testing.assert_allclose(found.of_state, d)


def test_smoothing_keeps_what_is_the_same_everywhere_and_closes_the_year():
    same = smoothed(np.full((3, 12, 2), 4.0), around=True)
    np.testing.assert_allclose(same, 4.0)
    peak = np.zeros((1, 12, 1))
    peak[0, 0] = 1.0
    np.testing.assert_allclose(smoothed(peak, around=True)[0, [11, 0, 1, 2], 0], [0.25, 0.5, 0.25, 0.0])


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04", b"\x93NUMPY"])
def test_damaged_parts_are_made_again(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "part.npz"
    made: list[int] = []

    def make() -> dict[str, FloatArray]:
        made.append(1)
        return {"a": np.arange(3.0), "b": np.ones((2, 2))}

    first = kept_arrays(path, "ab", make)
    again = kept_arrays(path, "ab", make)
    assert len(made) == 1
    assert set(again) == {"a", "b"}
    np.testing.assert_array_equal(again["b"], first["b"])
    path.write_bytes(damage)
    np.testing.assert_array_equal(kept_arrays(path, "ab", make)["a"], first["a"])
    assert len(made) == 2
    path.write_bytes(path.read_bytes()[:-40])
    kept_arrays(path, "ab", make)
    assert len(made) == 3
