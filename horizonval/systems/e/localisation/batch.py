"""The orbit that fits all angles of a pass best: position and velocity at the middle, by weighted least squares.

The unknowns are six numbers; :mod:`horizonval.systems.e.localisation.motion` carries them to every instant, the
stations say which azimuth and elevation they would have measured there, and the weighted differences from the measured
ones are made small (Tapley, Schutz & Born, "Statistical Orbit Determination", 2004, chapter 4)::

    x = argmin sum_i |L_i^-1 (z_i - h_i(x))|^2,        P = (J^T J)^-1

with the four angles' covariance ``L_i L_i^T`` at an instant, and ``J`` the derivative of all that is squared.

No angle is smoothed, no position is triangulated: every measurement counts once, with its own weight, also where the
two lines of sight miss each other, and even where one station did not see the satellite. The answer is as good as the
covariance says while the motion is (metres over a pass) and while the errors of different instants are independent.

Some errors last: a mount's tilt, a clock's offset. They are not estimated, but considered (Tapley, Schutz & Born,
chapter 6): with ``C`` what one standard deviation of each does to all that is squared, ``S = P J^T C`` is what it does
to the orbit, and ``S S^T`` is added to the covariance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from horizonval.core.arrays import FloatArray
from horizonval.geometry.rotation import turn
from horizonval.systems.e.localisation.motion import propagate, transition
from horizonval.systems.e.localisation.stations import Station

_NOT_MEASURED_RAD2 = 1e5
_SCALE = np.array([1e3, 1e3, 1e3, 10.0, 10.0, 10.0])


@dataclass(frozen=True)
class OrbitFit:
    """An orbit and how well it is known.

    Attributes
    ----------
    epoch_s : float
        When the state holds.
    state_gcrs : ndarray, shape (6,)
        Position [m], velocity [m/s].
    covariance : ndarray, shape (6, 6)
    states_gcrs : ndarray, shape (n, 6)
        At every measurement.
    covariances : ndarray, shape (n, 6, 6)
    residuals : ndarray, shape (n, 4)
        Measured less fitted, made independent and of unit variance: azimuth and elevation of both stations.
    chi2_per_dof : float
        1 where the given covariances are right.
    converged : bool
    """

    epoch_s: float
    state_gcrs: FloatArray
    covariance: FloatArray
    states_gcrs: FloatArray
    covariances: FloatArray
    residuals: FloatArray
    chi2_per_dof: float
    converged: bool


def fit_orbit(
    stations: tuple[Station, Station],
    times_s: ArrayLike,
    angles_rad: ArrayLike,
    covariance_rad2: ArrayLike,
    itrs_from_gcrs: ArrayLike,
    start_gcrs: ArrayLike,
    consider_partials_rad: ArrayLike | None = None,
) -> OrbitFit:
    """Fit an orbit to a pass.

    Parameters
    ----------
    stations : two stations
    times_s : array_like, shape (n,)
        Rising.
    angles_rad : array_like, shape (n, 4)
        Azimuth and elevation of the first, then of the second station.
    covariance_rad2 : array_like, shape (4, 4) or (n, 4, 4)
        Of the angles. A variance of 1e6 stands for no measurement (the angle must still be a number).
    itrs_from_gcrs : array_like, shape (n, 3, 3)
    start_gcrs : array_like, shape (6,)
        A state at the middle of the pass to begin with; hundreds of kilometres may be missing.
    consider_partials_rad : array_like, shape (n, 4, k), or None
        Consider partials: what one standard deviation of each lasting error does to the angles.
    """
    t = np.asarray(times_s, float)
    measured, matrices = np.asarray(angles_rad, float), np.asarray(itrs_from_gcrs, float)
    spread = np.broadcast_to(np.asarray(covariance_rad2, float), (*measured.shape, 4))
    whiten = np.linalg.inv(np.linalg.cholesky(spread))
    epoch = float(t[0] + t[-1]) / 2.0
    start = np.asarray(start_gcrs, float)

    def orbit(x: FloatArray) -> FloatArray:
        return propagate(start + _SCALE * x, t - epoch)

    def residuals(x: FloatArray) -> FloatArray:
        r_itrs = turn(matrices, orbit(x)[:, :3])
        modelled = np.concatenate([np.stack(s.azimuth_elevation(r_itrs), axis=1) for s in stations], axis=1)
        return turn(whiten, np.remainder(measured - modelled + np.pi, 2.0 * np.pi) - np.pi)

    def jacobian(x: FloatArray) -> FloatArray:
        states = orbit(x)
        by_start = transition(start + _SCALE * x, t - epoch)
        r_itrs = turn(matrices, states[:, :3])
        by_position = np.concatenate([_angle_partials(s, r_itrs) for s in stations], axis=1) @ matrices
        return -(whiten @ by_position @ by_start[:, :3]).reshape(-1, 6) * _SCALE

    solution = least_squares(
        lambda x: residuals(x).ravel(), np.zeros(6), jac=jacobian, method="lm", xtol=1e-10, ftol=1e-10
    )
    rest = residuals(solution.x)
    # from the triangular factor, not from the product with the transpose, which squares the condition
    j = jacobian(solution.x)
    inverse = np.linalg.inv(np.linalg.qr(j, mode="r")) * _SCALE[:, None]
    covariance = inverse @ inverse.T
    if consider_partials_rad is not None:
        considered = (whiten @ np.asarray(consider_partials_rad, float)).reshape(len(j), -1)
        sensitivity = covariance @ (j / _SCALE).T @ considered
        covariance = covariance + sensitivity @ sensitivity.T
    state = start + _SCALE * solution.x
    by_start = transition(state, t - epoch)
    used = int(np.sum(np.diagonal(spread, axis1=-2, axis2=-1) < _NOT_MEASURED_RAD2))
    return OrbitFit(
        epoch_s=epoch,
        state_gcrs=state,
        covariance=covariance,
        states_gcrs=orbit(solution.x),
        covariances=by_start @ covariance @ np.swapaxes(by_start, -1, -2),
        residuals=rest,
        chi2_per_dof=float(np.sum(rest**2) / (used - 6)),
        converged=bool(solution.success),
    )


def _angle_partials(station: Station, r_itrs: FloatArray) -> FloatArray:
    """Return the derivatives of azimuth and elevation by the position, shape (n, 2, 3) [rad/m]."""
    m = station.itrs_from_enu
    east, north, up = np.moveaxis((r_itrs - station.r_itrs) @ m, -1, 0)
    level2 = east**2 + north**2
    level, distance2 = np.sqrt(level2), level2 + up**2
    azimuth = np.stack([north / level2, -east / level2, np.zeros_like(up)], axis=-1)
    elevation = np.stack([-east * up / level, -north * up / level, level], axis=-1) / distance2[:, None]
    return np.stack([azimuth, elevation], axis=1) @ m.T
