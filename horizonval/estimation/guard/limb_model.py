"""What the model of a circular cone leaves out of a limb, as a covariance that any method of one limb may claim.

Oblateness, uneven height of the limb, its change with the Sun, and slow errors of sub-pixel points: none of it gets
less with more points or other noise.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, reliefs, systematic_covariance
from horizonval.estimation.guard import guard_limits as limits
from horizonval.estimation.limb.model.height_perturbation import cone_perturbation, unknown_sun_covariance
from horizonval.estimation.limb.model.steepest import SIGMA_PX
from horizonval.estimation.limb.model.sunlit import blur_rad
from horizonval.estimation.limb.model.trusted import SMOOTHED_RAD, smoothed
from horizonval.estimation.limb.shape.cone import SLOW_PX, slow_error
from horizonval.estimation.observation import Observation
from horizonval.geometry.rotation import off_axis_angle, tangent_basis


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

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis.

    Parameters
    ----------
    los_cam : ndarray, shape (n, 3)
    axis_cam : ndarray, shape (3,)
    rho_rad : float
    observation : Observation
    estimates : {"geocentric", "geodetic"}
    patterns_m : ndarray, shape (k, n), optional
        Errors of a known height of the limb, where the points have been lowered by one. Without, the Sun of a solar
        band is taken to be anywhere.
    slow_px : float
        As for :func:`horizonval.estimation.limb.shape.cone.slow_error`.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the points do not determine a cone.
    """
    camera, radius = observation.camera, observation.prior.sphere_radius_m
    covariance = systematic_covariance(
        los_cam,
        axis_cam,
        rho_rad,
        flattening=observation.prior.flattening,
        reliefs=(*reliefs(observation.band_kind), _seen_relief(los_cam, axis_cam, rho_rad, radius)),
        earth_radius_m=radius,
        estimates="geodetic" if estimates == "geodetic" else "geocentric",
    )
    covariance = covariance + slow_error(los_cam, tangent_basis(axis_cam), 1.0 / max(camera.fx, camera.fy), slow_px)
    if patterns_m is not None:
        moved = cone_perturbation(los_cam, axis_cam, rho_rad, patterns_m, radius)
        return np.asarray(covariance + moved.T @ moved)
    if observation.band_kind == "solar":
        blur = blur_of(los_cam, axis_cam, observation)
        return covariance + unknown_sun_covariance(los_cam, axis_cam, rho_rad, blur, radius, observation.band_um)
    return covariance


def _seen_relief(los_cam: FloatArray, axis_cam: FloatArray, rho_rad: float, earth_radius_m: float) -> Relief:
    """Return the relief that the points themselves show: their smoothed distances from the cone.

    Clouds, coasts and haze are known by it. The cone has followed the longest waves already; what is left of a relief
    with this correlation length is most of it.
    """
    off = off_axis_angle(los_cam, axis_cam) - rho_rad
    across = los_cam @ tangent_basis(axis_cam)
    azimuth = np.arctan2(across[:, 1], across[:, 0])
    waves = smoothed(off - off.mean(), azimuth)
    # A mean over k points keeps a k-th of their noise; k - 1 times that is what it took away.
    k = float((np.abs(azimuth[:, None] - azimuth[None, :]) <= 0.5 * SMOOTHED_RAD).sum(axis=1).mean())
    noise = float(np.var(off - waves)) / max(k - 1.0, 1.0)
    sigma = float(np.sqrt(max(float(np.var(waves)) - noise, 0.0)))
    return Relief(sigma * earth_radius_m / float(np.tan(rho_rad)), limits.SEEN_RELIEF_RAD)


def blur_of(los_cam: FloatArray, axis_cam: FloatArray, observation: Observation) -> FloatArray:
    """Return the blur of a search for the steepest place across the limb [rad], shape (n,)."""
    camera = observation.camera
    return blur_rad(camera, los_cam, axis_cam, SIGMA_PX / max(camera.fx, camera.fy))
