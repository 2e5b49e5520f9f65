"""The closed form that the altitude-free equation allows: linear in the nadir over the cosine of the Earth's radius.

Raeisy and Ghofrani's (8) is ``u . n = cos rho`` (see :mod:`horizonval.estimation.methods.altitude_free`). Divided by
``cos rho`` it is linear in ``m = n / cos rho``::

    u_i . m = 1,    m = (U^T U)^-1 U^T 1,    n = m / |m|,    cos rho = 1 / |m|

Ordinary least squares: no start, no steps.

**Bias.** Noise is in ``u``, where least squares expects exact numbers, so ``U^T U`` grows with the
noise and ``m`` shrinks (attenuation). A point displaced by the angle ``e`` across the limb moves along ``w = cos rho t
- sin rho n`` (``t`` from the nadir towards the point), and to second order in ``e``, of variance ``s^2``::

    dm = s^2 (U^T U)^-1 (tan rho sum w_i + 1/2 sum u_i)

It is nothing on a long arc, and on a short one, where ``U^T U`` is nearly singular, it outgrows the scatter; at rho =
90 deg ``m`` does not exist. Newton's method and the orthogonal regression of
:func:`horizonval.geometry.horizon.fit_cone` (which are one: both minimise the sum of ``(u . n - cos rho)^2``
over unit ``n``) suffer ``cos^2 rho`` times as much. The bias is not taken away here; its outer product is in the
covariance.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.lens_error import with_lens_error
from horizonval.estimation.limb.cone import ConeUncertainty, cone_scatter
from horizonval.estimation.methods import altitude_free
from horizonval.estimation.observation import Estimator
from horizonval.geometry.rotation import off_axis_angle


def solve(los_cam: FloatArray) -> tuple[FloatArray, float]:
    """Return nadir (3,) and angular radius [rad] by ordinary least squares on ``u . m = 1``, n >= 3.

    Raises ``LinAlgError`` if the points do not determine ``m``.
    """
    m, _, rank, _ = np.linalg.lstsq(los_cam, np.ones(len(los_cam)), rcond=None)
    length = float(np.linalg.norm(m))
    if rank < 3 or not np.isfinite(length) or length < 1.0:
        raise np.linalg.LinAlgError("the limb points do not determine a cone")
    # arc tangent: the arc cosine loses half of the digits of a small cone
    return np.asarray(m / length), float(np.arctan2(np.sqrt((length - 1.0) * (length + 1.0)), 1.0))


def attenuation(los_cam: FloatArray, nadir_cam: FloatArray, rho_rad: float, sigma_rad: float) -> FloatArray:
    """Return the bias (3,) of ``m`` that noise of ``sigma_rad`` across the limb causes, to second order.

    Raises ``LinAlgError`` if the points do not determine ``m``.
    """
    across = los_cam - np.outer(los_cam @ nadir_cam, nadir_cam)
    across /= np.linalg.norm(across, axis=1)[:, None]
    outwards = np.cos(rho_rad) * across - np.sin(rho_rad) * nadir_cam
    pull = np.tan(rho_rad) * outwards.sum(axis=0) + 0.5 * los_cam.sum(axis=0)
    return np.asarray(sigma_rad**2 * np.linalg.solve(los_cam.T @ los_cam, pull))


def uncertainty_of(los_cam: FloatArray, nadir_cam: FloatArray, rho_rad: float) -> ConeUncertainty:
    """Return the covariance of the closed form: scatter as of any fit of the cone, and the attenuation.

    To first order in the noise ``u . m - 1`` is the same multiple of every point's angle from the limb, so the scatter
    is that of the fit by angles. Raises ``LinAlgError`` if the points do not determine a cone.
    """
    scatter = cone_scatter(los_cam, nadir_cam, rho_rad)
    sigma = float(np.std(off_axis_angle(los_cam, nadir_cam) - rho_rad))
    dm = attenuation(los_cam, nadir_cam, rho_rad, sigma)
    # m = n / cos rho: along the tangent dm = dn / cos rho, along n dm = tan rho / cos rho drho
    shift = np.cos(rho_rad) * np.append(scatter.basis.T @ dm, dm @ nadir_cam / np.tan(rho_rad))
    return ConeUncertainty(scatter.basis, scatter.covariance + np.outer(shift, shift), scatter.correlation_length)


def answer(los_cam: FloatArray) -> altitude_free.Answer:
    """Return what the closed form makes of limb points (n, 3); raises ``LinAlgError``: undetermined."""
    nadir, rho = solve(los_cam)
    return nadir, rho, uncertainty_of(los_cam, nadir, rho), None


run = partial(altitude_free.run, answer=answer)
fit_points = partial(altitude_free.fit_points, answer=answer)

ESTIMATOR = Estimator(
    name="altitude-free-closed-form",
    title="Altitude-free method in closed form (least squares on n / cos rho)",
    run=with_lens_error(run),
    estimates="geocentric",
)
