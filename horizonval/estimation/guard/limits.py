"""Thresholds of the guard, each with its reason, and the covariance of what the model of a cone leaves out.

A circular cone leaves out oblateness, uneven height of the limb, its change with the Sun, and slow errors of sub-pixel
points. More points or less noise do not reduce these errors.
"""

from __future__ import annotations

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.earth.limb_heights import Relief, reliefs, systematic_covariance
from horizonval.estimation.guard.sunlit import blur_rad, cone_perturbation, unknown_sun_covariance
from horizonval.estimation.limb.cone import SLOW_PX, slow_error
from horizonval.estimation.limb.steepest import SIGMA_PX
from horizonval.estimation.limb.trusted import SMOOTHED_RAD, smoothed
from horizonval.estimation.observation import Observation
from horizonval.geometry.rotation import off_axis_angle, tangent_basis

FEWEST_POINTS = 12

COARSE_PIXEL_KM = 60.0
"""Width of a pixel at the limb from which points rarely pass: the limb of the air, some 60 km high, is within one."""

MUCH_LOST = 0.3
"""Share of the points beyond which what took them is named as the reason of a refusal."""

MOST_SATURATED = 0.5
"""Largest saturated share of a limb that is fitted by its pixels; above it, fits are wrong by 0.03 deg and more."""

LOW_SUN_RAD = float(np.deg2rad(75.0))
"""Sun's zenith angle from which the limb is followed along the cone: a search for edges begins to lose it there."""
FOLLOWED_PX = 3.0
"""Farthest that a followed point may lie from the cone: the limb rises by two pixels of 20 km."""
REACHES_RAD = tuple(float(np.deg2rad(angle)) for angle in (83.0, 86.0, 88.0, 90.0, 91.0, 92.0, 93.0, 94.0))
"""Sun's zenith angles up to which points may be used; the one that determines the nadir best is taken."""

TRIMS = 5
TRIM_SIGMAS = 4.0
SMALLEST_TRIM_PX = 0.3
"""Points nearer than this to the cone are kept whatever the spread: the scatter of single points at full contrast."""

SMALLEST_RHO_RAD = float(np.deg2rad(1.0))
"""Where the altitude is not known: the Moon and the Sun measure 0.27 deg, the Earth from the Moon 0.95 deg."""

LARGEST_SIGMA_RAD = float(np.deg2rad(0.2))
"""Largest standard deviation of the worst direction: 0.4 of the error of 0.5 deg above which a claim is false."""

PIXEL_SHARE = 0.5
"""Share of the accepted accuracy (``Prior.accept_rad``) at which methods that fit the pixels are refused: their claims
are false beyond half of the error that is allowed to a fit of a cone."""

AGREEMENT = 5.0
AGREEMENT_FLOOR_RAD = float(np.deg2rad(0.02))
"""Smallest tolerance for methods with whole pixels or circles where the guard uses sub-pixels and cones."""

HEAD_RIM_PX = 11.0
"""A profile across the limb reaches 10 px to either side."""
HEAD_SCATTER_PX = 2.0
HEAD_LIMB_SHARE = 0.5
"""Smallest limb share of the answer's cone in a head's image; Sun and terminator cross it at a point."""

HEAD_LOWEST_SUN_RAD = float(np.deg2rad(83.0))
"""Sun's zenith angle at which the limb has risen by 0.7 km (5 km at 91 deg). Short arcs cannot tell a rise from a
tilt."""
HEAD_ARC_SHARE = 0.15
"""Smallest arc in every head, relative to the image's shorter side; less is a chord of a few pixels."""
HEADS_MISFIT_RAD = float(np.deg2rad(0.25))
HEADS_MISFIT_PX = 1.5
"""Root mean square by which the limbs of all heads may miss one cone: oblateness, and the search's scatter."""
HEAD_KNOTS = 6
"""Places along a head's arc at which the limb is moved to see what the method makes of it."""

ROW_PX = 16
"""An image whose shorter side has no more pixels is a linear array."""
ROW_NEAR_PX = 10.0
ROW_NEAR_WIDTHS = 4.0
"""How far the limb itself reaches to either side of its half level, in widths from 20 to 80 %: a plateau bends over."""
ROW_FEWEST_PX = 4
ROW_SMOOTHING_PX = 1.0
ROW_SIGMAS = 5.0
"""Largest deviation in units of the smoothed row's noise: among 160 pixels, one row of a million by chance."""
ROW_SPACE_SHARE = 0.1
ROW_EARTH_SHARES = (0.6, 1.5)
"""Levels beyond and within the limb, of its step: carbon dioxide's disc is 0.9 to 1.1 of its plateau, space a hundredth
of it; what comes near half of the step is another edge."""
MISFIT_CHANCE = 1e-6
"""Probability of the crossings' misfit below which they are not of one limb."""
SEEN_RELIEF_RAD = 0.15
"""Correlation length of the relief that an image shows of itself: clouds and coasts of some hundred kilometres."""


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
            _seen_relief(los_cam, axis_cam, rho_rad, radius),
        ),
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
    return Relief(sigma * earth_radius_m / float(np.tan(rho_rad)), SEEN_RELIEF_RAD)


def blur_of(los_cam: FloatArray, axis_cam: FloatArray, observation: Observation) -> FloatArray:
    """Return the blur of a search for the steepest place across the limb [rad], shape (n,)."""
    camera = observation.camera
    return blur_rad(camera, los_cam, axis_cam, SIGMA_PX / max(camera.fx, camera.fy))
