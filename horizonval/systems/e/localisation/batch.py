"""The orbit that fits all angles of a pass best: position and velocity at the middle, by weighted least squares.

The unknowns are six numbers; :func:`propagate` carries them to every instant, the
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

*Triangulation*: the point nearest to two lines of sight. From the stations ``L1``, ``L2`` along unit vectors ``r1``,
``r2`` (Hadinejad & Amiri 2020)::

    [r1  -r2] [d1  d2]^T = L2 - L1,      X = (A^T A)^-1 A^T B,      R = (L1 + L2 + [r1  r2] X) / 2

three equations, two distances; the answer is the middle of the shortest line between the two lines of sight. The
least squares give both directions the same weight *in metres*, so the farther station's error counts as much as the
nearer one's.

To first order, for a small change ``dA`` of the directions,
``dX = (A^T A)^-1 (dA^T (B - A X) - A^T dA X)``.

*Motion* over some minutes: attraction of a point and of the Earth's flattening. In celestial axes, with the Earth's
axis along z::

    a = -mu r / |r|^3 - 3/2 J2 mu a_e^2 / |r|^5 * ((1 - 5 z^2 / r^2) r + 2 z e_z)

Neglected over 60 s from the middle of a pass, with sizes at 800 km: J3 and beyond (3e-5 m/s^2: 0.05 m), Moon and Sun
(1e-6 m/s^2), drag (1e-8 m/s^2), and the precession of the axis since 2000 (0.1 deg: the pull of J2 turned by 2e-3 of
itself, 3e-5 m/s^2). The SGP4 orbits that serve as truth neglect other terms: metres over a pass.

The state is position and velocity, shape (..., 6); it is carried by the classical Runge-Kutta rule of fourth order
(local error ``(w dt)^5 / 120``: with steps of 10 s, 1 mm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import WGS84
from horizonval.geometry.rotation import turn
from horizonval.systems.e.localisation.stations import Station


def triangulate(
    r1_itrs: ArrayLike, r2_itrs: ArrayLike, u1_itrs: ArrayLike, u2_itrs: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the point between two lines [m], both distances and the shortest distance between the lines [m].

    ``r1_itrs``, ``r2_itrs``: shape (3,), stations [m]; ``u1_itrs``, ``u2_itrs``: shape (..., 3), unit directions, not
    parallel, where the result is meaningless. Result: shapes (..., 3), (..., 2) and (...).
    """
    l1, l2 = np.asarray(r1_itrs, float), np.asarray(r2_itrs, float)
    u1, u2 = np.broadcast_arrays(np.asarray(u1_itrs, float), np.asarray(u2_itrs, float))
    a = np.stack([u1, -u2], axis=-1)
    x = _solve(a, np.einsum("...ij,i->...j", a, l2 - l1))
    p1, p2 = l1 + x[..., :1] * u1, l2 + x[..., 1:] * u2
    return 0.5 * (p1 + p2), x, np.linalg.norm(p1 - p2, axis=-1)


def triangulate_with_partials(
    stations: tuple[Station, Station], angles_rad: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Return positions [m], shape (..., 3), and derivatives by the angles [m/rad], shape (..., 3, 4), Earth-fixed.

    ``angles_rad``: shape (..., 4), azimuth and elevation of the first, then of the second station.
    """
    both = np.asarray(angles_rad, float)
    angles = (both[..., :2], both[..., 2:])
    station1, station2 = stations
    u1, u2 = (s.directions_itrs(a[..., 0], a[..., 1]) for s, a in zip(stations, angles, strict=True))
    r, x, _ = triangulate(station1.r_itrs, station2.r_itrs, u1, u2)
    a = np.stack([u1, -u2], axis=-1)
    rest = (station2.r_itrs - station1.r_itrs) - np.einsum("...ij,...j->...i", a, x)
    columns = []
    for i, (station, angle) in enumerate(zip(stations, angles, strict=True)):
        for du in _partials(station, angle):
            da = np.zeros_like(a)
            da[..., i] = du if i == 0 else -du
            dx = _solve(
                a,
                np.einsum("...ij,...i->...j", da, rest)
                - np.einsum("...ij,...i->...j", a, np.einsum("...ij,...j->...i", da, x)),
            )
            columns.append(0.5 * (u1 * dx[..., :1] + u2 * dx[..., 1:] + du * x[..., i, None]))
    return r, np.stack(columns, axis=-1)


def _solve(a: FloatArray, right: FloatArray) -> FloatArray:
    """Return ``(A^T A)^-1 right``: the diagonal of ``A^T A`` is 1 for unit directions."""
    c = np.einsum("...i,...i->...", a[..., 0], a[..., 1])
    # 1 - c^2 from the cross product: two stations near each other see almost parallel lines.
    d = np.sum(np.cross(a[..., 0], a[..., 1]) ** 2, axis=-1)
    return np.stack([right[..., 0] - c * right[..., 1], right[..., 1] - c * right[..., 0]], axis=-1) / d[..., None]


def _partials(station: Station, angles_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives of the direction by azimuth and by elevation, shape (..., 3) each."""
    sa, ca = np.sin(angles_rad[..., 0]), np.cos(angles_rad[..., 0])
    se, ce = np.sin(angles_rad[..., 1]), np.cos(angles_rad[..., 1])
    by_azimuth = np.stack([ce * ca, -ce * sa, np.zeros_like(sa)], axis=-1)
    by_elevation = np.stack([-se * sa, -se * ca, ce], axis=-1)
    m = station.itrs_from_enu.T
    return by_azimuth @ m, by_elevation @ m


MU_M3_S2 = 3.986004418e14
"""Earth's gravitational constant, EGM2008 / WGS84."""

J2 = 1.08262668e-3
"""Flattening term, EGM2008."""

_LONGEST_STEP_S = 10.0


def acceleration(r_gcrs: ArrayLike) -> FloatArray:
    """Return the acceleration [m/s^2], shape (..., 3), at positions (..., 3) [m] outside the Earth."""
    r = np.asarray(r_gcrs, float)
    r2 = np.sum(r * r, axis=-1, keepdims=True)
    z = r[..., 2:]
    k = 1.5 * J2 * WGS84.a_m**2 / r2
    pull = -MU_M3_S2 / (r2 * np.sqrt(r2))
    return pull * (r * (1.0 + k * (1.0 - 5.0 * z**2 / r2)) + 2.0 * k * z * np.array([0.0, 0.0, 1.0]))


def gravity_gradient(r_gcrs: ArrayLike) -> FloatArray:
    """Return the derivative of the acceleration by the position [1/s^2], shape (..., 3, 3), of the point mass alone.

    J2 changes it by 2e-3 of itself: after 60 s, 1e-5 of the change of an error.
    """
    r = np.asarray(r_gcrs, float)
    distance = np.linalg.norm(r, axis=-1)[..., None, None]
    outer = r[..., :, None] * r[..., None, :]
    return MU_M3_S2 / distance**3 * (3.0 * outer / distance**2 - np.eye(3))


def _rate(state: FloatArray) -> FloatArray:
    return np.concatenate([state[..., 3:], acceleration(state[..., :3])], axis=-1)


def propagate(state_gcrs: ArrayLike, dt_s: ArrayLike) -> FloatArray:
    """Return states, shape (..., 6), after times ``dt_s``, shape (...) (negative: before); both broadcast."""
    dt = np.asarray(dt_s, float)
    steps = _steps(dt)
    h = dt[..., None] / steps
    state = np.asarray(state_gcrs, float)
    for _ in range(steps):
        k1 = _rate(state)
        k2 = _rate(state + 0.5 * h * k1)
        k3 = _rate(state + 0.5 * h * k2)
        k4 = _rate(state + h * k3)
        state = state + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return state


def transition(state_gcrs: ArrayLike, dt_s: ArrayLike) -> FloatArray:
    """Return the derivatives, shape (..., 6, 6), of the states after ``dt_s``, shape (...), by the state before.

    The product of the steps' ``[[I + G h^2/2, I h + G h^3/6], [G h, I + G h^2/2]]``, with the gradient ``G`` at the
    middle of each: neglects ``(w h)^4 / 24``, which is 1e-9 for steps of 10 s, and what ``G`` does within a step.
    """
    dt = np.asarray(dt_s, float)
    steps = _steps(dt)
    h = dt[..., None, None] / steps
    state = propagate(state_gcrs, 0.5 * dt / steps)
    total = np.asarray(np.eye(6))
    for k in range(steps):
        g = gravity_gradient(state[..., :3])
        same = np.eye(3) + g * (0.5 * h**2)
        top = np.concatenate([same, np.eye(3) * h + g * (h**3 / 6.0)], axis=-1)
        total = np.concatenate([top, np.concatenate([g * h, same], axis=-1)], axis=-2) @ total
        if k + 1 < steps:
            state = propagate(state, dt / steps)
    return total


def _steps(dt: FloatArray) -> int:
    return max(1, int(np.ceil(np.max(np.abs(dt)) / _LONGEST_STEP_S)))


_NOT_MEASURED_RAD2 = 1e5
_SCALE = np.array([1e3, 1e3, 1e3, 10.0, 10.0, 10.0])


@dataclass(frozen=True)
class OrbitFit:
    """An orbit and its covariance.

    ``epoch_s``: of ``state_gcrs``, shape (6,), position [m] and velocity [m/s]; ``covariance``: shape (6, 6);
    ``states_gcrs``, ``covariances``: shape (n, 6) and (n, 6, 6), at every measurement; ``residuals``: shape (n, 4),
    measured minus fitted, whitened: azimuth and elevation of both stations; ``chi2_per_dof``: 1 for correct
    covariances.
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

    ``times_s``: shape (n,), rising; ``angles_rad``: shape (n, 4), azimuth and elevation of the first, then of the
    second station; ``covariance_rad2``: shape (4, 4), 1e6 for no measurement (the angle must be a number);
    ``itrs_from_gcrs``: shape (n, 3, 3); ``start_gcrs``: shape (6,), state at the middle of the pass, within hundreds of
    kilometres; ``consider_partials_rad``: shape (n, 4, k), effect of one standard deviation of each lasting error on
    the angles.
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
