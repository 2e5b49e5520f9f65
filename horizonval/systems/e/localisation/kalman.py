"""Kalman filter whose noise covariances follow its own innovations and residuals, and the way back.

After Akhlaghi, Zhou & Huang, "Adaptive adjustment of noise covariance in Kalman filter for dynamic state estimation",
IEEE PES General Meeting 2017. The measurement is a position: ``H = [I 0]``. With the innovation
``d = y - H x-`` and the residual ``e = y - H x+``, a forgetting factor ``alpha`` and the gain ``K``::

    R_k = alpha R_{k-1} + (1 - alpha) (e e^T + H P- H^T)          (residual)
    Q_k = alpha Q_{k-1} + (1 - alpha) (K d d^T K^T)               (innovation)

in the order predict, gain, update, adapt. In theory ``E[e e^T] = R - H P+ H^T``: P- in place of P+, as printed, makes
R a little too large. ``alpha = 1`` leaves both as they were given: the plain filter.

A filter knows only what came before, and at the start of the pass that is nothing. :func:`rts_smoother` carries what
came after to every instant (Rauch, Tung & Striebel, "Maximum likelihood estimates of linear dynamic systems", AIAA
Journal 3, 1965), with the covariances that the filter used::

    G = P_k F^T (P-_{k+1})^-1,     xs_k = x_k + G (xs_{k+1} - x-_{k+1}),     Ps_k = P_k + G (Ps_{k+1} - P-_{k+1}) G^T

The filter takes errors of different instants as independent. Where they are not, its covariances are not those of its
states; the states' weights on the measurements are (:func:`weights`)::

    w_k = (I - K_k H) F_k w_{k-1} + K_k e_k^T,     ws_k = w_k + G (ws_{k+1} - F_{k+1} w_k)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

Motion = Callable[[FloatArray, float], tuple[FloatArray, FloatArray]]
"""``(state, dt) -> (state after dt, its derivative by the state)``."""


@dataclass(frozen=True)
class Track:
    """What a filter gives at every measurement, the measurements along axis 0.

    Attributes
    ----------
    states : ndarray, shape (n, ..., m)
        After the update; the first three numbers are the position.
    covariances : ndarray, shape (n, ..., m, m)
    predicted, predicted_covariances, transitions : ndarray
        Before the update, and the derivative of the prediction by the state before it: what the way back needs.
    innovations : ndarray, shape (n, ..., 3)
    gains : ndarray, shape (n, ..., m, 3)
    r, q : ndarray, shape (..., 3, 3) and (..., m, m)
        The noise covariances as they stood at the end.
    """

    states: FloatArray
    covariances: FloatArray
    predicted: FloatArray
    predicted_covariances: FloatArray
    transitions: FloatArray
    innovations: FloatArray
    gains: FloatArray
    r: FloatArray
    q: FloatArray


def filter_positions(
    times_s: ArrayLike,
    positions: ArrayLike,
    r: ArrayLike,
    q: ArrayLike,
    state: ArrayLike,
    covariance: ArrayLike,
    motion: Motion,
    *,
    alpha: float = 1.0,
) -> Track:
    """Run the filter over measured positions, from first to last.

    Parameters
    ----------
    times_s : array_like, shape (n,)
    positions : array_like, shape (n, ..., 3)
        Axes between: independent series.
    r, q : array_like, shape (..., 3, 3) and (..., m, m)
        Covariance of a measured position, and of what motion adds between two measurements, to begin with.
    state, covariance : array_like, shape (..., m) and (..., m, m)
        At the first measurement, before it is used. With adaptation, every series has its own of r, q and this.
    motion : callable
    alpha : float
        Forgetting factor in (0, 1]: the share of the old covariance that is kept.
    """
    t, y = np.asarray(times_s, float), np.asarray(positions, float)
    x = np.asarray(state, float)
    p, q_now, r_now = (np.asarray(m, float) for m in (covariance, q, r))
    one = np.eye(x.shape[-1])
    rows = []
    for k in range(len(t)):
        f = np.broadcast_to(one, p.shape)
        if k:
            x, f = motion(x, float(t[k] - t[k - 1]))
            p = f @ p @ np.swapaxes(f, -1, -2) + q_now
        before, p_before = x, p
        seen = p[..., :3, :3]
        gain = np.swapaxes(np.linalg.solve(seen + r_now, p[..., :3, :]), -1, -2)
        d = y[k] - x[..., :3]
        step = np.einsum("...ij,...j->...i", gain, d)
        x = x + step
        # Joseph's form: stays symmetric and positive
        keep = one - np.concatenate([gain, np.zeros_like(p[..., 3:])], axis=-1)
        p = keep @ p @ np.swapaxes(keep, -1, -2) + gain @ r_now @ np.swapaxes(gain, -1, -2)
        if alpha < 1.0:
            r_now = alpha * r_now + (1.0 - alpha) * (_outer(y[k] - x[..., :3]) + seen)
            q_now = alpha * q_now + (1.0 - alpha) * _outer(step)
        rows.append((x, p, before, p_before, np.broadcast_to(f, p.shape), d, gain))
    states, covariances, predicted, p_predicted, transitions, innovations, gains = (
        np.stack(column) for column in zip(*rows, strict=True)
    )
    return Track(states, covariances, predicted, p_predicted, transitions, innovations, gains, r_now, q_now)


def rts_smoother(track: Track) -> tuple[FloatArray, FloatArray]:
    """Return states and covariances, shapes (n, ..., m) and (n, ..., m, m), that know all measurements."""
    states, covariances = list(track.states), list(track.covariances)
    for k in range(len(states) - 2, -1, -1):
        p_next = track.predicted_covariances[k + 1]
        gain = _way_back(track, k)
        states[k] = states[k] + np.einsum("...ij,...j->...i", gain, states[k + 1] - track.predicted[k + 1])
        covariances[k] = covariances[k] + gain @ (covariances[k + 1] - p_next) @ np.swapaxes(gain, -1, -2)
    return np.stack(states), np.stack(covariances)


def weights(track: Track, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what every state is of the measurements, forward and after the way back, shape (n, m, n, 3) each.

    The derivatives of one series' states by the measured positions, with the gains as they came out. ``start`` of
    shape (m, n, 3): those of the state that the filter began with.
    """
    count, size = track.states.shape
    one = np.eye(size)
    forward = np.zeros((count, *start.shape))
    w = start
    for k in range(count):
        keep = one - np.concatenate([track.gains[k], np.zeros((size, size - 3))], axis=1)
        w = np.tensordot(keep @ track.transitions[k], w, axes=1)
        w[:, k] += track.gains[k]
        forward[k] = w
    back = forward.copy()
    for k in range(count - 2, -1, -1):
        rest = back[k + 1] - np.tensordot(track.transitions[k + 1], forward[k], axes=1)
        back[k] += np.tensordot(_way_back(track, k), rest, axes=1)
    return forward, back


def _way_back(track: Track, k: int) -> FloatArray:
    """Return the gain ``G`` with which what comes after instant ``k`` is heard."""
    known = track.transitions[k + 1] @ track.covariances[k]
    return np.asarray(np.swapaxes(np.linalg.solve(track.predicted_covariances[k + 1], known), -1, -2))


def _outer(v: FloatArray) -> FloatArray:
    return v[..., :, None] * v[..., None, :]
