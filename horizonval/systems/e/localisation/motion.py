"""A satellite's motion over some minutes: attraction of a point and of the Earth's flattening.

In celestial axes, with the Earth's axis along z::

    a = -mu r / |r|^3 - 3/2 J2 mu a_e^2 / |r|^5 * ((1 - 5 z^2 / r^2) r + 2 z e_z)

Neglected over 60 s from the middle of a pass, with sizes at 800 km: J3 and beyond (3e-5 m/s^2: 0.05 m), Moon and Sun
(1e-6 m/s^2), drag (1e-8 m/s^2), and the precession of the axis since 2000 (0.1 deg: the pull of J2 turned by 2e-3 of
itself, 3e-5 m/s^2). The SGP4 orbits that serve as truth keep their own company of neglected terms, metres over a pass.

The state is position and velocity, shape (..., 6); it is carried by the classical Runge-Kutta rule of fourth order
(local error ``(w dt)^5 / 120``: with steps of 10 s, 1 mm).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.geometry.ellipsoid import WGS84

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
