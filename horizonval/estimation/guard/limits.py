"""Thresholds that the parts of the guard share, and the covariance of what the model of a cone leaves out.

A circular cone leaves out oblateness, uneven height of the limb, its change with the Sun, and slow errors of sub-pixel
points. More points or less noise do not reduce these errors.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, reliefs, systematic_covariance
from horizonval.estimation.guard.sunlit import blur_across, cone_perturbation, unknown_sun_covariance
from horizonval.estimation.limb.cone import SLOW_PX, slow_error
from horizonval.estimation.observation import Observation
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

FEWEST_POINTS = 12
"""Smallest number of points of an image: four for each of a cone's three unknowns."""
SMALLEST_RHO_RAD = float(np.deg2rad(1.0))
"""Where the altitude is not known: the Moon and the Sun measure 0.27 deg, the Earth from the Moon 0.95 deg."""
AGREEMENT_FLOOR_RAD = float(np.deg2rad(0.02))
"""Smallest tolerance for methods with whole pixels or circles where the guard uses sub-pixels and cones."""
SMOOTHED_RAD = float(np.deg2rad(4.0))
"""Length of limb, by azimuth, of a mean along it: clouds vary faster along it than sunlight."""


def model_covariance(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    observation: Observation,
    estimates: str = "geocentric",
    patterns_m: FloatArray | None = None,
    slow_px: float = SLOW_PX,
) -> FloatArray:
    """Return the covariance [rad^2] of (axis along basis 1, along basis 2, half-angle), shape (3, 3).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. Raises ``LinAlgError`` if the points do
    not determine a cone.

    ``los_cam``: shape (n, 3); ``axis_cam``: shape (3,); ``estimates``: one of ``"geocentric"``, ``"geodetic"``;
    ``patterns_m``: shape (k, n), errors of a known height of the limb, where the points have been lowered by one.
    Without, the Sun of a solar band is taken to be anywhere; ``slow_px``: as for
    :func:`horizonval.estimation.limb.cone.slow_error`.
    """
    camera, radius = observation.camera, observation.prior.sphere_radius_m
    covariance = systematic_covariance(
        los_cam,
        axis_cam,
        rho_rad,
        flattening=observation.prior.flattening,
        reliefs=(
            *reliefs(observation.band_kind, observation.prior.limb_relief_m),
            seen_relief(los_cam, axis_cam, rho_rad, radius),
        ),
        earth_radius_m=radius,
        estimates="geodetic" if estimates == "geodetic" else "geocentric",
    )
    covariance = covariance + slow_error(los_cam, axis_cam, 1.0 / max(camera.fx, camera.fy), slow_px)
    if patterns_m is not None:
        moved = cone_perturbation(los_cam, axis_cam, rho_rad, patterns_m, radius)
        return np.asarray(covariance + moved.T @ moved)
    if observation.band_kind == "solar":
        blur = blur_across(camera, los_cam, axis_cam)
        return covariance + unknown_sun_covariance(los_cam, axis_cam, rho_rad, blur, radius, observation.band_um)
    return covariance


def seen_relief(los_cam: FloatArray, axis_cam: FloatArray, rho_rad: float, earth_radius_m: float) -> Relief:
    """Return the relief that the points show: their smoothed distances from the cone.

    The cone has absorbed the longest waves; with this correlation length most of the relief remains.
    """
    off = off_axis_angle(los_cam, axis_cam) - rho_rad
    across = los_cam @ tangent_basis(axis_cam)
    azimuth = np.arctan2(across[:, 1], across[:, 0])
    waves = smoothed(off - off.mean(), azimuth)
    # A mean over k points keeps a k-th of their noise; k - 1 times that is what it took away.
    k = float((np.abs(azimuth[:, None] - azimuth[None, :]) <= 0.5 * SMOOTHED_RAD).sum(axis=1).mean())
    noise = float(np.var(off - waves)) / max(k - 1.0, 1.0)
    sigma = float(np.sqrt(max(float(np.var(waves)) - noise, 0.0)))
    # Clouds and coasts are correlated over some hundred kilometres.
    return Relief(sigma * earth_radius_m / float(np.tan(rho_rad)), correlation_rad=0.15)


def smoothed(values: FloatArray, azimuth: FloatArray) -> FloatArray:
    """Return the mean of values over the neighbours within half of :data:`SMOOTHED_RAD` of azimuth."""
    order = np.argsort(azimuth, kind="stable")
    a = azimuth[order]
    total = np.concatenate([[0.0], np.cumsum(values[order])])
    low = np.searchsorted(a, a - 0.5 * SMOOTHED_RAD, side="left")
    high = np.searchsorted(a, a + 0.5 * SMOOTHED_RAD, side="right")
    out = np.empty_like(values)
    out[order] = (total[high] - total[low]) / (high - low)
    return out
