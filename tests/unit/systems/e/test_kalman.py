"""The filter without adaptation against closed forms; with it, against its own claims; its way back against one fit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from horizonval.systems.e.localisation.smoothing import filter_positions, rts_smoother, weights

DT = 1.0
F = np.block([[np.eye(3), DT * np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
R = np.diag([4.0, 9.0, 1.0])
Q = 0.01 * np.block([[np.eye(3) / 3.0, np.eye(3) / 2.0], [np.eye(3) / 2.0, np.eye(3)]])
H = np.concatenate([np.eye(3), np.zeros((3, 3))], axis=1)


def _motion(x: np.ndarray, dt: float) -> tuple[np.ndarray, np.ndarray]:
    return x @ F.T, F


def _simulated(n: int, series: int, seed: int, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    x = np.concatenate([np.zeros((series, 3)), np.ones((series, 3))], axis=1)
    truth, measured = [], []
    for k in range(n):
        if k:
            x = x @ F.T + rng.multivariate_normal(np.zeros(6), q, series)
        truth.append(x)
        measured.append(x[:, :3] + rng.multivariate_normal(np.zeros(3), R, series))
    return np.array(truth), np.array(measured)


def test_covariance_settles_where_the_riccati_equation_says() -> None:
    """Scipy's solution of the discrete Riccati equation; the filter has forgotten its start after 300 steps."""
    measured = np.zeros((300, 3))
    track = filter_positions(np.arange(300.0), measured, R, Q, np.zeros(6), 100.0 * np.eye(6), _motion)
    assert track.predicted_covariances[-1] == pytest.approx(solve_discrete_are(F.T, H.T, Q, R), rel=1e-9, abs=1e-12)
    assert track.r == pytest.approx(R)
    assert track.q == pytest.approx(Q)


def test_without_process_noise_the_end_is_the_least_squares_line() -> None:
    """And the way back is the same line everywhere: 1e-5 of the measurements' size, what the wide start leaves."""
    _, measured = _simulated(40, 1, 5, np.zeros((6, 6)))
    y, t = measured[:, 0], np.arange(40.0)
    track = filter_positions(t, y, R, np.zeros((6, 6)), np.zeros(6), 1e8 * np.eye(6), _motion)
    slope, offset = np.polyfit(t, y, 1)
    line = offset + t[:, None] * slope
    assert track.states[-1, :3] == pytest.approx(line[-1], abs=1e-5)
    states, covariances = rts_smoother(track)
    assert np.abs(states[:, :3] - line).max() < 1e-4
    basis = np.stack([np.ones(40), t], axis=1)
    spread = np.einsum("ni,ij,nj->n", basis, np.linalg.inv(basis.T @ basis), basis)
    assert covariances[:, 0, 0] == pytest.approx(spread * R[0, 0], rel=1e-4)


@pytest.mark.parametrize("way", ["forward", "back"])
def test_errors_are_as_large_as_claimed(way: str) -> None:
    """400 series: the mean of 6 chi-square is 6 +- 0.17; 0.6 is three standard deviations and more."""
    truth, measured = _simulated(60, 400, 6, Q)
    start = np.concatenate([measured[0], np.ones((400, 3))], axis=1)
    spread = np.diag([*np.diag(R), 1e-6, 1e-6, 1e-6])
    # the first position is in the start already: the filter begins with the second
    x, f = _motion(start, DT)
    track = filter_positions(
        np.arange(59.0), measured[1:], R, Q, x, np.broadcast_to(f @ spread @ f.T + Q, (400, 6, 6)), _motion
    )
    states, covariances = (track.states, track.covariances) if way == "forward" else rts_smoother(track)
    for k in (5, 30, 58):
        e = states[k] - truth[k + 1]
        squares = np.einsum("ni,ni->n", e, np.linalg.solve(covariances[k], e[..., None])[..., 0])
        assert squares.mean() == pytest.approx(6.0, abs=0.6)


def test_adaptation_finds_the_measurements_noise() -> None:
    """Begun with a hundredth of R, it comes within a factor of two; without adaptation it would stay there."""
    _, measured = _simulated(400, 30, 7, 1e-6 * np.eye(6))
    track = filter_positions(
        np.arange(400.0),
        measured,
        np.broadcast_to(0.01 * R, (30, 3, 3)),
        np.broadcast_to(1e-6 * np.eye(6), (30, 6, 6)),
        np.concatenate([measured[0], np.ones((30, 3))], axis=1),
        np.broadcast_to(10.0 * np.eye(6), (30, 6, 6)),
        _motion,
        alpha=0.98,
    )
    ratio = np.diagonal(track.r.mean(axis=0)) / np.diagonal(R)
    assert np.all((ratio > 0.5) & (ratio < 2.0)), ratio


def test_one_step_of_the_adaptation_is_as_printed() -> None:
    """By hand, from the equations of Akhlaghi, Zhou and Huang."""
    alpha, p, y = 0.3, np.diag([2.0, 3.0, 5.0, 1.0, 1.0, 1.0]), np.array([[1.0, -2.0, 0.5]])
    track = filter_positions([0.0], y, R, Q, np.zeros(6), p, _motion, alpha=alpha)
    gain = p @ H.T @ np.linalg.inv(H @ p @ H.T + R)
    d = y[0]
    e = y[0] - H @ gain @ d
    assert track.r == pytest.approx(alpha * R + (1 - alpha) * (np.outer(e, e) + H @ p @ H.T))
    assert track.q == pytest.approx(alpha * Q + (1 - alpha) * gain @ np.outer(d, d) @ gain.T)


def test_weights_are_what_the_states_are_of_the_measurements() -> None:
    """A linear filter: its states are the start's share and the weighted sum of the measurements, both ways."""
    _, measured = _simulated(30, 1, 7, Q)
    y, t = measured[:, 0], np.arange(30.0)
    start = np.zeros((6, 30, 3))
    start[:3, 0] = np.eye(3)
    first = np.concatenate([y[0], np.zeros(3)])
    track = filter_positions(t, y, R, Q, first, 100.0 * np.eye(6), _motion)
    forward, back = weights(track, start)
    assert np.einsum("kmic,ic->km", forward, y) == pytest.approx(track.states, abs=1e-9)
    assert np.einsum("kmic,ic->km", back, y) == pytest.approx(rts_smoother(track)[0], abs=1e-9)
