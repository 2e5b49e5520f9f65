"""From two stations' angles to a satellite's orbit: the plain way, the published way, and a fit of the whole pass.

``plain``: two-ray least squares at every instant. ``proposed``: the published order, rotate, smooth, least
squares, adaptive Kalman filter, celestial coordinates; then the filter's way back. ``batch``: all angles at once.

The filter is given smoothed positions, whose errors are correlated over the smoother's width, and takes them as
independent. Its states hardly change by that, but its covariance is too small. The covariance claimed here is
therefore not the filter's: every state is a weighted sum of the smoothed positions,
these are one of the angles, and the angles' errors are independent from instant to instant::

    P_k = sum_j V_kj C_j V_kj^T,     V_kj = sum_i w_ki S_ij D_j

with the states' weights ``w`` (:func:`~horizonval.systems.e.localisation.smoothing.weights`), the smoother's matrix
``S``, the positions' derivatives ``D`` by the angles, and the angles' covariances ``C``. Neglected: the adapted gains
depend on the errors themselves.

``as published`` is the printed order with the printed factor: a Gaussian mean of the directions, least squares, the
filter, no way back (:func:`locate_as_published`).
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import numpy as np
from numpy.polynomial import polynomial
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import itrs_from_gcrs, turn
from horizonval.systems.e.localisation.batch import (
    OrbitFit,
    fit_orbit,
    propagate,
    transition,
    triangulate,
    triangulate_with_partials,
)
from horizonval.systems.e.localisation.smoothing import (
    KernelChoice,
    Track,
    choose_kernel,
    filter_positions,
    rts_smoother,
    smooth,
    smooth_extended,
    smoother_matrix,
    weights,
)
from horizonval.systems.e.localisation.stations import Station

ALPHA = 0.995
"""Forgetting factor: a memory of 200 measurements, about a pass. Chosen after the results of others had been seen."""
PUBLISHED_ALPHA = 0.3
"""Remembers one or two measurements."""
PUBLISHED_WIDTH_S = 1.0
"""Standard deviation of the published Gaussian mean, which the paper does not print: fitted to its figures."""

_START_S, _START_LEAST = 20.0, 12
_START_SPEED_M_S = 100.0
_DRIFT = 1e-8
"""Variance that a step adds to begin with [m^2 and m^2/s^2]: the motion is good to metres over the pass."""


@dataclass(frozen=True)
class TwoStationPass:
    """Measurements of two stations.

    ``times_s``: shape (n,), after the epoch, equal steps; ``angles_rad``: shape (n, 4), azimuth and elevation of the
    first, then of the second station; ``covariance_rad2``: shape (4, 4), of errors that differ between instants, None
    for the directions' scatter; ``consider_partials_rad``: shape (n, 4, k), effect of one standard deviation of each
    lasting error.
    """

    stations: tuple[Station, Station]
    epoch_utc: datetime
    times_s: FloatArray
    angles_rad: FloatArray
    covariance_rad2: FloatArray | None = None
    consider_partials_rad: FloatArray | None = None

    @property
    def directions_itrs(self) -> tuple[FloatArray, FloatArray]:
        """Unit vectors, shape (n, 3), of the two stations."""
        a = self.angles_rad
        first, second = self.stations
        return first.directions_itrs(a[:, 0], a[:, 1]), second.directions_itrs(a[:, 2], a[:, 3])


@dataclass(frozen=True)
class PassPositions:
    """Positions of a pass [m], shape (n, 3), celestial axes, with covariances [m^2], shape (n, 3, 3).

    ``filtered`` uses past measurements only; ``proposed`` is after the backward pass.
    """

    plain: FloatArray
    smoothed: FloatArray
    filtered: FloatArray
    proposed: FloatArray
    batch: FloatArray
    filtered_covariances: FloatArray
    proposed_covariances: FloatArray
    batch_covariances: FloatArray
    kernel: KernelChoice
    orbit: OrbitFit


def locate(measured: TwoStationPass, *, alpha: float = ALPHA) -> PassPositions:
    """Run all three ways over a pass of at least some 40 measurements."""
    t, angles = measured.times_s, measured.angles_rad
    first, second = measured.stations
    turns = itrs_from_gcrs(measured.epoch_utc, t)
    back = np.swapaxes(turns, -1, -2)
    raw = measured.directions_itrs
    kernel = choose_kernel(t, *raw)
    smoothed = [smooth(t, u, kernel.kernel) for u in raw]
    # itrs -> gcrs
    plain, positions = (turn(back, triangulate(first.r_itrs, second.r_itrs, *u)[0]) for u in (raw, smoothed))
    spread = measured.covariance_rad2
    if spread is None:
        spread = np.eye(4) * _angle_sigma(kernel.sigma_rad, angles) ** 2
    share = float(np.sum(smoother_matrix(t, kernel.kernel) ** 2) / len(t))
    partials = back @ triangulate_with_partials(measured.stations, angles)[1]
    r = share * np.mean(partials @ spread @ np.swapaxes(partials, -1, -2), axis=0)
    track = follow(t, positions, r, alpha=alpha)
    states, _ = rts_smoother(track)
    middle = len(t) // 2
    orbit = fit_orbit(
        measured.stations, t, angles, spread, turns, _carried(states[middle], t, middle), measured.consider_partials_rad
    )
    considered = _considered(partials, measured.consider_partials_rad)
    seen = partials @ _root(np.broadcast_to(spread, (len(t), 4, 4)))
    forward, way_back = (
        _claimed(w[:, :3], smoother_matrix(t, kernel.kernel), seen) for w in weights(track, _start_weights(t))
    )
    return PassPositions(
        plain=plain,
        smoothed=positions,
        filtered=track.states[:, :3],
        proposed=states[:, :3],
        batch=orbit.states_gcrs[:, :3],
        filtered_covariances=forward + considered,
        proposed_covariances=way_back + considered,
        batch_covariances=orbit.covariances[:, :3, :3],
        kernel=kernel,
        orbit=orbit,
    )


def locate_as_published(
    measured: TwoStationPass, *, alpha: float = PUBLISHED_ALPHA, width_s: float = PUBLISHED_WIDTH_S
) -> tuple[FloatArray, FloatArray]:
    """Return positions in celestial axes [m], shape (n, 3) each: smoothed, and after the filter that follows.

    The Gaussian mean has one width; directions are extrapolated linearly at both ends. The paper does not say how its
    filter begins; here with the first position and its difference to the second.
    """
    t, angles = measured.times_s, measured.angles_rad
    first, second = measured.stations
    back = np.swapaxes(itrs_from_gcrs(measured.epoch_utc, t), -1, -2)
    raw = measured.directions_itrs
    smoothed = [smooth_extended(t, u, width_s) for u in raw]
    positions = turn(back, triangulate(first.r_itrs, second.r_itrs, *smoothed)[0])
    spread = np.eye(4) * _angle_sigma(choose_kernel(t, *raw).sigma_rad, angles) ** 2
    partials = back @ triangulate_with_partials(measured.stations, angles)[1]
    r = np.mean(partials @ spread @ np.swapaxes(partials, -1, -2), axis=0)
    step = float(t[1] - t[0])
    start = np.concatenate([positions[0], (positions[1] - positions[0]) / step])
    spread6 = np.kron(np.diag([1.0, 2.0 / step**2]), r)
    track = filter_positions(t, positions, r, _DRIFT * np.eye(6), start, spread6, _motion, alpha=alpha)
    return positions, track.states[:, :3]


def follow(times_s: ArrayLike, r_gcrs: ArrayLike, covariance: ArrayLike, *, alpha: float = ALPHA) -> Track:
    """Return the adaptive filter's track of positions (n, 3) with a common covariance (3, 3).

    It begins with a cubic through the first 20 s (at least 12 positions), whose speed has a sigma of 100 m/s.
    """
    t, r = np.asarray(times_s, float), np.asarray(r_gcrs, float)
    early = _early(t)
    coefficients = polynomial.polyfit(t[early] - t[0], r[early], 3)
    spread = np.zeros((6, 6))
    spread[:3, :3] = 4.0 * np.asarray(covariance, float)
    spread[3:, 3:] = _START_SPEED_M_S**2 * np.eye(3)
    return filter_positions(
        t,
        r,
        covariance,
        _DRIFT * np.eye(6),
        np.concatenate(coefficients[:2]),
        spread,
        _motion,
        alpha=alpha,
    )


def _motion(state: FloatArray, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the state after a time, and its derivative by the state."""
    return propagate(state, dt_s), transition(state, dt_s)


def _early(t: FloatArray) -> NDArray[np.bool_]:
    """Return which measurements the filter's start is made of, shape (n,)."""
    return np.asarray(t <= max(t[0] + _START_S, t[min(_START_LEAST, len(t)) - 1]))


def _start_weights(t: FloatArray) -> FloatArray:
    """Return what the filter's start is of the positions, shape (6, n, 3): place and speed of the cubic."""
    early = _early(t)
    fit = np.zeros((2, len(t)))
    fit[:, early] = np.linalg.pinv(polynomial.polyvander(t[early] - t[0], 3))[:2]
    return np.einsum("pn,ab->panb", fit, np.eye(3)).reshape(6, len(t), 3)


def _root(spread: FloatArray) -> FloatArray:
    """Return roots ``L`` of covariances, ``L L^T``, shape (n, 4, 4): they need not be definite."""
    values, vectors = np.linalg.eigh(spread)
    return vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]


def _claimed(of_positions: FloatArray, smoother: FloatArray, seen: FloatArray) -> FloatArray:
    """Return covariances (n, 3, 3) of states with weights (n, 3, n, 3), from independent errors ``seen`` (n, 3, 4)."""
    of_raw = np.einsum("kaib,ij->kajb", of_positions, smoother, optimize=True)
    parts = np.einsum("kajb,jbe->kaje", of_raw, seen, optimize=True).reshape(len(of_positions), 3, -1)
    return np.asarray(parts @ np.swapaxes(parts, -1, -2))


def _considered(partials: FloatArray, consider_partials_rad: FloatArray | None) -> FloatArray:
    """Return the covariance that lasting errors leave in a position: neither smoother nor filter takes it away."""
    if consider_partials_rad is None:
        return np.zeros((len(partials), 3, 3))
    position_partials = partials @ consider_partials_rad
    return position_partials @ np.swapaxes(position_partials, -1, -2)


def _angle_sigma(sigma_rad: float, angles_rad: FloatArray) -> float:
    """Return the angles' sigma from the directions': azimuth's error moves a direction by its cosine of elevation."""
    return sigma_rad * float(np.sqrt(2.0 / (1.0 + np.mean(np.cos(angles_rad[:, 1::2]) ** 2))))


def _carried(state: FloatArray, t: FloatArray, at: int) -> FloatArray:
    """Return the state at the middle of the pass, which need not be a measurement's instant."""
    return propagate(state, float(t[0] + t[-1]) / 2.0 - float(t[at]))
