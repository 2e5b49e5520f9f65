"""Adaptive Kalman filter with its backward smoother, and Gaussian smoothing of directions that keeps a pass's ends.

*Filter.* After Akhlaghi, Zhou & Huang, "Adaptive adjustment of noise covariance in Kalman filter for dynamic state
estimation", IEEE PES General Meeting 2017. The measurement is a position: ``H = [I 0]``. With the innovation ``d = y -
H x-`` and the residual ``e = y - H x+``, a forgetting factor ``alpha`` and the gain ``K``::

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

*Smoothing of directions.* A weighted mean with the weights ``exp(-(t_i - t)^2 / (2 h^2))`` is pulled to the inner side
at both ends of the pass, where half of its neighbours are missing: by ``0.8 h`` times the direction's rate. Repeating
the first and the last measurement ("clamping") changes the share but not the fault. Instead, the weights are used to
fit a polynomial of degree ``p`` around every instant, and its value there is the smoothed one (local polynomial
regression; Fan & Gijbels, "Local Polynomial Modelling and its Applications", 1996, section 3.1; with equal steps,
Savitzky & Golay 1964)::

    s(t) = e_0^T (B^T W B)^-1 B^T W y,      B_ij = (t_i - t)^j

Polynomials up to degree ``p`` pass unchanged everywhere, the ends included.

The degree and the width are chosen from the data alone, the same way for every series (:func:`choose_kernel`): among
some candidates, the one with the least expected mean square error, which is a bias and a noise:

* bias: what the candidate does to a pilot curve. Seen from a station a satellite flies past on almost a straight line,
  its direction is that of ``a + b t``; ``a`` and ``b`` (up to a common factor) come from the measurements by a singular
  value decomposition of ``u x (a + b t) = 0``. Only the pilot's high derivatives matter;
* noise: ``|row of the smoother|^2 sigma^2`` with sigma from the scatter about a polynomial of degree 9 over the whole
  pass. For measurements with independent errors this is exact. Rounding errors are correlated where the angle
  moves slowly; they are smoothed less than the rule assumes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

Motion = Callable[[FloatArray, float], tuple[FloatArray, FloatArray]]
"""``(state, dt) -> (state after dt, its derivative by the state)``."""


@dataclass(frozen=True)
class Track:
    """Filter results at every measurement, along axis 0.

    ``states``, ``covariances``: shape (n, ..., m) and (n, ..., m, m), after the update, position first; ``predicted``,
    ``predicted_covariances``, ``transitions``: before the update, and the prediction's derivative by the last state,
    for the backward pass; ``innovations``: shape (n, ..., 3); ``gains``: shape (n, ..., m, 3); ``r``, ``q``: final
    noise.
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
    """Run the filter over measured positions (n, ..., 3), from first to last; middle axes are independent series.

    ``r``, ``q``: shape (..., 3, 3), initial covariances of a measured position, and of the motion between two;
    ``state``, ``covariance``: at the first measurement, before its use; ``alpha``: forgetting factor in (0, 1], the
    share of the old covariance. With adaptation, every series has separate r, q and covariance.
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
    """Return derivatives of states by measured positions, forward and after the backward pass, (n, m, n, 3) each.

    Gains are those of the track, of one series; ``start``: shape (m, n, 3), derivatives of the first state.
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


DEGREES = (1, 3, 5)
"""Even degrees gain nothing inside a series over the odd ones below them."""

_PILOT_DEGREE = 9


@dataclass(frozen=True)
class Kernel:
    """A local polynomial's degree and the standard deviation of its Gaussian weights."""

    degree: int
    width_s: float


@dataclass(frozen=True)
class KernelChoice:
    """What :func:`choose_kernel` found, with the errors [rad] that it expects, root mean square over the pass."""

    kernel: Kernel
    sigma_rad: float
    bias_rad: float
    noise_rad: float


def smoother_matrix(times_s: ArrayLike, kernel: Kernel) -> FloatArray:
    """Return the matrix, shape (n, n), that smooths a series measured at ``times_s``, shape (n,)."""
    return _smoother_matrix(tuple(np.asarray(times_s, float).tolist()), kernel)


@lru_cache(maxsize=128)
def _smoother_matrix(times_s: tuple[float, ...], kernel: Kernel) -> FloatArray:
    t = np.array(times_s)
    tau = (t[None, :] - t[:, None]) / kernel.width_s
    root = np.exp(-0.25 * tau**2)
    basis = tau[..., None] ** np.arange(kernel.degree + 1)
    return np.linalg.pinv(basis * root[..., None])[:, 0, :] * root


def smooth(times_s: ArrayLike, directions: ArrayLike, kernel: Kernel) -> FloatArray:
    """Return smoothed unit vectors, shape (n, 3), of unit vectors of shape (n, 3)."""
    smoothed = smoother_matrix(times_s, kernel) @ np.asarray(directions, float)
    return smoothed / np.linalg.norm(smoothed, axis=-1, keepdims=True)


def smooth_clamped(times_s: ArrayLike, directions: ArrayLike, width_s: float) -> FloatArray:
    """Return the weighted mean with end vectors repeated, to show its bias; needs equal steps."""
    u = np.asarray(directions, float)
    reach = _reach(times_s, width_s)
    return _gaussian_mean(times_s, width_s, np.repeat(u[:1], reach, axis=0), u, np.repeat(u[-1:], reach, axis=0))


def smooth_extended(times_s: ArrayLike, directions: ArrayLike, width_s: float) -> FloatArray:
    """Return the weighted mean with vectors extrapolated at both ends by the last difference; needs equal steps."""
    u = np.asarray(directions, float)
    beyond = np.arange(1, _reach(times_s, width_s) + 1)[:, None]
    before, after = u[0] - beyond[::-1] * (u[1] - u[0]), u[-1] + beyond * (u[-1] - u[-2])
    return _gaussian_mean(times_s, width_s, before, u, after)


def _reach(times_s: ArrayLike, width_s: float) -> int:
    t = np.asarray(times_s, float)
    return int(np.ceil(5.0 * width_s / float(t[1] - t[0])))


def _gaussian_mean(times_s: ArrayLike, width_s: float, *parts: FloatArray) -> FloatArray:
    """Return unit vectors: the weighted mean of what lies before, in and after a series, where the series is."""
    t, reach = np.asarray(times_s, float), _reach(times_s, width_s)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * float(t[1] - t[0]) / width_s) ** 2)
    padded = np.concatenate(parts)
    smoothed = np.stack([np.convolve(padded[:, i], weights, mode="valid") for i in range(padded.shape[1])], axis=1)
    return smoothed / np.linalg.norm(smoothed, axis=-1, keepdims=True)


def straight_pass(times_s: ArrayLike, directions: ArrayLike) -> FloatArray:
    """Return the directions, shape (n, 3), of the straight flight past the station that fits the measured ones."""
    t, u = np.asarray(times_s, float), np.asarray(directions, float)
    scaled = (t - t.mean()) / np.ptp(t)
    x, y, z = u.T
    zero = np.zeros_like(x)
    cross = np.stack([np.stack(row, axis=-1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], axis=1)
    system = np.concatenate([cross, cross * scaled[:, None, None]], axis=2).reshape(-1, 6)
    a, b = np.linalg.svd(system, full_matrices=False)[2][-1].reshape(2, 3)
    line = a + scaled[:, None] * b
    line /= np.linalg.norm(line, axis=1, keepdims=True)
    return line * np.sign(np.sum(line * u))


def scatter(times_s: ArrayLike, directions: ArrayLike) -> float:
    """Return the standard deviation [rad] of a direction's noise along one axis, shape (n, 3) given, n above 20."""
    t, u = np.asarray(times_s, float), np.asarray(directions, float)
    scaled = 2.0 * (t - t[0]) / np.ptp(t) - 1.0
    basis = chebyshev.chebvander(scaled, _PILOT_DEGREE)
    rest = u - basis @ np.linalg.lstsq(basis, u, rcond=None)[0]
    # A unit vector has noise along two axes only.
    return float(np.sqrt(np.sum(rest**2) / (2.0 * (len(t) - _PILOT_DEGREE - 1))))


def choose_kernel(times_s: ArrayLike, *directions: ArrayLike, widths: int = 16) -> KernelChoice:
    """Return the kernel that fits the data, one for all series; see the module text.

    ``*directions``: shape (n, 3), unit vectors in axes fixed to the station; ``widths``: candidates from two steps to a
    quarter of the pass, in equal ratios.
    """
    t = np.asarray(times_s, float)
    step, length = float(np.median(np.diff(t))), float(np.ptp(t))
    pilot = np.concatenate([straight_pass(t, u) for u in directions], axis=1)
    sigma = float(np.sqrt(np.mean([scatter(t, u) ** 2 for u in directions])))
    best: KernelChoice | None = None
    for degree, width in product(DEGREES, np.geomspace(2.0 * step, length / 4.0, widths)):
        kernel = Kernel(degree, float(width))
        matrix = smoother_matrix(t, kernel)
        bias = float(np.sqrt(np.sum((matrix @ pilot - pilot) ** 2) / (2.0 * len(directions) * len(t))))
        noise = sigma * float(np.sqrt(np.sum(matrix**2) / len(t)))
        if best is None or np.hypot(bias, noise) < np.hypot(best.bias_rad, best.noise_rad):
            best = KernelChoice(kernel, sigma, bias, noise)
    if best is None:
        raise ValueError("no candidates")
    return best
