"""Altitude-free horizon sensor: roll, pitch and the Earth's angular radius from limb pixels, by Newton's method.

After Raeisy and Ghofrani, "Imaged Based Earth Horizon Sensor with no Altitude Information" (2021). A limb pixel at
angle eta from the optical axis and azimuth alpha gives one equation, their (8)::

    cos rho = -sin eta cos alpha sin theta + sin eta sin alpha cos theta sin phi + cos eta cos theta cos phi

in the unknowns ``x = (phi, theta, rho)``: roll, pitch, angular radius. Stacked over all pixels, F(x) = 0 is solved by
Newton-Raphson with the pseudo-inverse ``(A^T A)^-1 A^T`` of the Jacobian; then ``H = R / sin rho - R``. The right side
is the line of sight ``u`` times the nadir ``n = (-sin theta, cos theta sin phi, cos theta cos phi)``: limb directions
lie on a cone about the nadir.

**Start.** The paper does not give one. Here it is the cone through three pixels, a sixth, a half and five sixths along
the arc.

**Pole.** Roll and pitch degenerate at theta = +-90 deg. The iteration runs in axes turned about the optical axis so
that the guessed nadir has theta = 0, and the result is turned back; with the guess on the optical axis these are the
paper's axes.

Neglected: the Earth is a sphere (on the ellipsoid the fitted cone is tilted by up to 0.1 deg); refraction and the
height of the visible limb go into rho, hence into the altitude.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.guard.limits import model_error
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.limb.cone import (
    SLOW_PX,
    SOFT_SLOW_PX,
    ConeUncertainty,
    arc_order,
    cone_gain,
    cone_uncertainty,
)
from horizonval.estimation.limb.finder import find_limb
from horizonval.estimation.observation import Estimator, Fit, Observation, fit_of_nadir
from horizonval.geometry.frames import nadir_of_roll_pitch, roll_pitch_of_nadir
from horizonval.geometry.horizon import cones_through, fit_cone
from horizonval.geometry.rotation import off_axis_angle

Step = Callable[[FloatArray, FloatArray], FloatArray]
"""Function of the Jacobian (n, 3) and F (n,) that returns Newton's decrement of the state (3,)."""


def step_by_qr(jacobian: FloatArray, f: FloatArray) -> FloatArray:
    """Return the least-squares step by QR: the paper's step, without squaring the condition number."""
    q, r = np.linalg.qr(jacobian)
    return np.asarray(np.linalg.solve(r, q.T @ f))


def newton(los_cam: FloatArray, start: FloatArray, step_of: Step = step_by_qr) -> FloatArray:
    """Return the iterates of the published method, shape (k, 3), from ``start`` (phi, theta, rho) [rad].

    ``los_cam``: shape (n, 3), n >= 3; ``step_of``: solver of a step's equations. Raises ``LinAlgError``: undetermined.
    """
    steps = [np.asarray(start, dtype=float)]
    # Each step doubles the digits: five from a tenth of a radian, and some to get there.
    for _ in range(20):
        phi, theta, rho = steps[-1]
        f = los_cam @ nadir_of_roll_pitch(phi, theta) - np.cos(rho)
        by_phi = np.array([0.0, np.cos(theta) * np.cos(phi), -np.cos(theta) * np.sin(phi)])
        by_theta = np.array([-np.cos(theta), -np.sin(theta) * np.sin(phi), -np.sin(theta) * np.cos(phi)])
        jacobian = np.column_stack([los_cam @ by_phi, los_cam @ by_theta, np.full(len(f), np.sin(rho))])
        step = step_of(jacobian, f)
        steps.append(steps[-1] - step)
        if not np.all(np.isfinite(step)):
            raise np.linalg.LinAlgError("the Newton step is not finite")
        # After a step of 1e-10 quadratic convergence leaves nothing to gain in float64.
        if np.abs(step).max() < 1e-10:
            break
    return np.array(steps)


def start_from(los_cam: FloatArray) -> tuple[Rotation, FloatArray]:
    """Return the turn about the optical axis and the start (phi, theta, rho) in the turned axes.

    Raises ``LinAlgError`` if the three pixels coincide.
    """
    order = arc_order(los_cam, fit_cone(los_cam).axis_cam)
    three = los_cam[order[(len(order) * np.array([1, 3, 5])) // 6]]
    axes, _ = cones_through(*(point[None, :] for point in three))
    guess = axes[0]
    if not np.isfinite(guess).all() or not guess.any():
        raise np.linalg.LinAlgError("the limb points do not span an arc")
    # turned so that the guess lies in the y-z plane: theta = 0
    turn = Rotation.from_euler("z", np.arctan2(guess[0], guess[1]))
    turned = turn.apply(guess)
    return turn, np.array([np.arctan2(turned[1], turned[2]), 0.0, float(off_axis_angle(three[1], guess))])


def solve(los_cam: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Return nadir (3,), angular radius [rad] and iterates (k, 3) of (phi, theta, rho) in the camera's own axes.

    Raises ``LinAlgError``: undetermined, or no convergence.
    """
    turn, start = start_from(los_cam)
    steps = newton(turn.apply(los_cam), start)
    if np.abs(steps[-1] - steps[-2]).max() > 1e-8:
        raise np.linalg.LinAlgError(f"no convergence in {len(steps) - 1} Newton steps")
    nadirs = turn.inv().apply(np.array([nadir_of_roll_pitch(phi, theta) for phi, theta, _ in steps]))
    rho = float(steps[-1, 2])
    nadir = nadirs[-1]
    if np.cos(rho) < 0.0:
        # cos rho = u.n also holds for (-n, pi - rho); the Earth is the smaller cap
        nadir, rho, nadirs = -nadir, np.pi - rho, -nadirs
    iterates = np.column_stack([*roll_pitch_of_nadir(nadirs), steps[:, 2]])
    return nadir, float(rho), iterates


Answer = tuple[FloatArray, float, ConeUncertainty, FloatArray | None]
"""Nadir (3,), angular radius [rad], how well they are known, and iterates (k, m)."""


def answer(los_cam: FloatArray) -> Answer:
    """Return what Newton's method makes of limb points (n, 3); raises ``LinAlgError``: undetermined."""
    nadir, rho, steps = solve(los_cam)
    return nadir, rho, cone_uncertainty(los_cam, nadir, rho), steps


def run(observation: Observation, answer: Callable[[FloatArray], Answer] = answer) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image."""
    found = find_limb(observation.image, observation.camera, observation.full_scale, observation.prior)
    if isinstance(found, Refusal):
        return found
    return fit_points(found.los_cam, found.uv, observation, SOFT_SLOW_PX, answer)


def fit_points(
    los_cam: FloatArray,
    uv: FloatArray,
    observation: Observation,
    slow_px: float = SLOW_PX,
    answer: Callable[[FloatArray], Answer] = answer,
) -> Fit | Refusal:
    """Fit limb points ``los_cam`` (n, 3), in pixels ``uv`` (n, 2), of any search."""
    if len(los_cam) < 4:
        return Refusal(Outcome.SHORT_ARC, f"{len(los_cam)} limb points; at least 4 are needed", uv)
    try:
        nadir, rho, uncertainty, steps = answer(los_cam)
        raised, model = model_error(los_cam, nadir, rho, observation, slow_px=slow_px)
        # The method does not know the limb's height along it, which its claim must have.
        moved = cone_gain(los_cam, nadir) @ raised
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e), uv)
    if not 0.0 < rho < np.pi / 2:
        reason = f"angular radius of {np.degrees(rho):.3g} deg is not that of a planet"
        return Refusal(Outcome.NOT_CONVERGED, reason, uv)
    return fit_of_cone(los_cam, uv, nadir, rho, uncertainty, observation, steps, model + np.outer(moved, moved))


def fit_of_cone(
    los_cam: FloatArray,
    uv: FloatArray,
    nadir_cam: FloatArray,
    rho_rad: float,
    uncertainty: ConeUncertainty,
    observation: Observation,
    steps: FloatArray | None = None,
    model: FloatArray | None = None,
) -> Fit:
    """Return the fit that a cone of sight lines means.

    ``los_cam``, ``uv``: shape (n, 3) and (n, 2), the points it was fitted to; ``nadir_cam``: shape (3,); ``steps``:
    shape (k, m); ``model``: shape (3, 3), what the cone leaves out
    (:func:`horizonval.estimation.guard.limits.model_error`).
    """
    basis = uncertainty.basis
    variance_rho = uncertainty.covariance[2, 2] + (0.0 if model is None else model[2, 2])
    return fit_of_nadir(
        observation,
        nadir_cam,
        uncertainty.covariance_axis,
        rho_rad,
        float(np.sqrt(variance_rho)),
        points=uv,
        residuals_rad=off_axis_angle(los_cam, nadir_cam) - rho_rad,
        steps=steps,
        systematic_nadir_cam=None if model is None else basis @ model[:2, :2] @ basis.T,
    )


ESTIMATOR = Estimator(
    name="altitude-free",
    title="Altitude-free Newton method (Raeisy and Ghofrani 2021)",
    run=with_lens_error(run),
    estimates="geocentric",
    from_points=fit_points,
)
