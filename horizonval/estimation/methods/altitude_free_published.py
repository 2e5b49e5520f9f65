"""The altitude-free horizon sensor as published (Raeisy and Ghofrani 2021).

Every pixel that Canny marks, at its centre, is a point of the limb. Newton-Raphson on ``x = (phi, theta, rho)`` uses
the pseudo-inverse as printed, ``(A^T A)^-1 A^T``, in the paper's axes; see
:mod:`horizonval.estimation.methods.altitude_free` for the equation. Any other edge is taken for limb.

**Start.** The paper gives none; here it is ``phi = theta = 0`` and rho = 45 deg. The choice of rho hardly matters: at
``phi = theta = 0`` the linearised equation is ``u_y dphi - u_x dtheta + u_z = const``, whose ``dphi`` and ``dtheta``
are the tangents of the angles for any rho. Beyond some 60 deg off the optical axis the first step overshoots, and the
iteration may end at the mirrored cone (-n, pi - rho), or nowhere.

**Covariance.** A whole-pixel point is off by up to half a pixel, with correlation where the limb runs along the pixels;
:func:`horizonval.estimation.limb.cone.cone_uncertainty` counts the correlation of the residuals along the arc. Errors
common to all points (Canny's choice between equally steep pixels, the pull of shaded ground) are
a pixel over the root of 12.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.estimation.fit.light import PIXEL_VARIANCE
from horizonval.estimation.limb.cone import cone_uncertainty
from horizonval.estimation.limb.edges import find_canny_pixels
from horizonval.estimation.methods.altitude_free import fit_of_cone, newton
from horizonval.estimation.observation import Estimator, Fit, Observation
from horizonval.geometry.frames import nadir_of_roll_pitch

START = np.array([0.0, 0.0, np.pi / 4])
"""(phi, theta, rho) [rad]."""


def step_by_pseudo_inverse(jacobian: FloatArray, f: FloatArray) -> FloatArray:
    """Return ``pinv(A) F`` with the pseudo-inverse as printed, ``(A^T A)^-1 A^T``."""
    return np.asarray(np.linalg.inv(jacobian.T @ jacobian) @ jacobian.T @ f)


def run(observation: Observation) -> Fit | Refusal:
    """Estimate nadir, roll, pitch and altitude from one image."""
    found = find_canny_pixels(observation.image, observation.camera, observation.full_scale)
    if isinstance(found, Refusal):
        return found
    return fit_pixels(found.los_cam, found.uv, observation)


def fit_pixels(los_cam: FloatArray, uv: FloatArray, observation: Observation, *, whole: bool = True) -> Fit | Refusal:
    """Fit points (n, 3), in pixels ``uv`` (n, 2): the method behind the edge detector, ``whole`` pixels or of another
    search."""
    if len(los_cam) < 4:
        return Refusal(Outcome.SHORT_ARC, f"{len(los_cam)} edge points; at least 4 are needed", uv)
    if np.linalg.matrix_rank(los_cam) < 3:
        return Refusal(Outcome.NOT_CONVERGED, "the points do not determine a cone", uv)
    try:
        steps = newton(los_cam, START, step_by_pseudo_inverse)
        phi, theta, rho = steps[-1]
        # A last step of 0.002 arcsec is followed by one below rounding.
        if np.abs(steps[-1] - steps[-2]).max() > 1e-8:
            return Refusal(Outcome.NOT_CONVERGED, f"no convergence in {len(steps) - 1} Newton steps", uv)
        # cos rho = u.n is periodic in rho, and also holds for (-n, pi - rho); the Earth is the smaller cap
        nadir = np.copysign(1.0, np.cos(rho)) * nadir_of_roll_pitch(phi, theta)
        rho = float(np.arcsin(np.abs(np.sin(rho))))
        uncertainty = cone_uncertainty(los_cam, nadir, rho)
    except np.linalg.LinAlgError as e:
        return Refusal(Outcome.NOT_CONVERGED, str(e), uv)
    if whole:
        # An offset that all points have in common changes the radius, which residuals do not show.
        common = np.diag([0.0, 0.0, PIXEL_VARIANCE / observation.camera.fx**2])
        uncertainty = replace(uncertainty, covariance=uncertainty.covariance + common)
    return fit_of_cone(los_cam, uv, nadir, rho, uncertainty, observation, steps)


ESTIMATOR = Estimator(
    name="altitude-free-published",
    title="Altitude-free Newton method exactly as published (Raeisy and Ghofrani 2021)",
    run=run,
    estimates="geocentric",
    from_points=partial(fit_pixels, whole=False),
)
