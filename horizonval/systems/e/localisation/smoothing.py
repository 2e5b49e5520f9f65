"""Gaussian smoothing of direction vectors over time that keeps a pass's ends where they are.

A weighted mean with the weights ``exp(-(t_i - t)^2 / (2 h^2))`` is pulled to the inner side at both ends of the pass,
where half of its neighbours are missing: by ``0.8 h`` times the direction's rate. Repeating the first and the last
measurement ("clamping") changes the share but not the fault. Instead, the weights are used to fit a polynomial of
degree ``p`` around every instant, and its value there is the smoothed one (local polynomial regression; Fan & Gijbels,
"Local Polynomial Modelling and its Applications", 1996, section 3.1; with equal steps, Savitzky & Golay 1964)::

    s(t) = e_0^T (B^T W B)^-1 B^T W y,      B_ij = (t_i - t)^j

Polynomials up to degree ``p`` pass unchanged everywhere, the ends included.

The degree and the width are chosen from the data alone, the same way for every series (:func:`choose_kernel`): among
some candidates, the one with the least expected mean square error, which is a bias and a noise:

* bias: what the candidate does to a pilot curve. Seen from a station a satellite flies past on almost a straight line,
  its direction is that of ``a + b t``; ``a`` and ``b`` (up to a common factor) come from the measurements by a singular
  value decomposition of ``u x (a + b t) = 0``. Only the pilot's high derivatives matter;
* noise: ``|row of the smoother|^2 sigma^2`` with sigma from the scatter about a polynomial of degree 9 over the whole
  pass. For measurements with independent errors this is exact. Rounding errors hang together where the angle
  moves slowly; they are smoothed less than the rule believes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray

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
    """Return the weighted mean with the first and last vector repeated beyond the ends: kept to show its bias.

    Needs equal steps.
    """
    u = np.asarray(directions, float)
    reach = _reach(times_s, width_s)
    return _gaussian_mean(times_s, width_s, np.repeat(u[:1], reach, axis=0), u, np.repeat(u[-1:], reach, axis=0))


def smooth_extended(times_s: ArrayLike, directions: ArrayLike, width_s: float) -> FloatArray:
    """Return the weighted mean with the vectors carried on beyond both ends by the last difference.

    Needs equal steps.
    """
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
    """Return the kernel that the data ask for, one for all series; see the module text.

    Parameters
    ----------
    times_s : array_like, shape (n,)
    *directions : array_like, shape (n, 3)
        Unit vectors in axes that do not turn against the station, one series for every station.
    widths : int
        Candidates between two steps and a quarter of the pass, in equal ratios.
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
