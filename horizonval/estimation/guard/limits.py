"""What makes the limb through points no circle, and whether a claim agrees with what is known of altitude and attitude.

A circular cone leaves out oblateness, relief of the limb (as known, and as the points show it), its change with the
Sun, and slow errors of sub-pixel points. More points or less noise do not reduce these errors.

**Sunlit limbs.** A camera that does not resolve the air sees the limb where its blurred profile is steepest
(:func:`horizonval.estimation.fit.heights.steepest_height`). That height changes with the Sun's direction by tens of
kilometres in wide pixels, and the bow of an arc pulls the nadir by tenths of a degree. Heights are those of limbs
without clouds: the mean of limbs with and without clouds has two steep positions. The table's modes that are correlated
over a low orbit's limb or more (haze, presence of clouds, ground) are patterns of height along the arc; each is half of
the change from one standard deviation below the mean to one above. Shorter variations are the limb's relief. An error
of the Sun's direction is two more patterns. Where the Sun is not known, each direction that lights the whole arc is
one.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.core.outcome import Outcome, Refusal
from horizonval.earth.limb_heights import Relief, limb_height_m, reliefs, systematic_covariance
from horizonval.estimation.fit.edge_pixels import MISPLACED_PX
from horizonval.estimation.fit.guard import SIGMAS
from horizonval.estimation.fit.heights import (
    FAINTEST,
    SUN_SIGMA_RAD,
    SUNS,
    HeightGrid,
    heights_on_grid,
    misread_suns,
    steepest_height,
    sun_angles_at,
    without_clouds,
)
from horizonval.estimation.fit.known import LOCAL_RADIUS_SHARE
from horizonval.estimation.fit.templates import shipped_templates
from horizonval.estimation.limb.cone import SLOW_PX, cone_gain, inwards_of, slow_error
from horizonval.estimation.observation import Fit, Observation
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import angle_between, fibonacci_sphere, off_axis_angle, tangent_basis

FEWEST_POINTS = 12
"""Smallest number of points of an image: four for each of a cone's three unknowns."""
SMALLEST_RHO_RAD = float(np.deg2rad(1.0))
"""Where the altitude is not known: the Moon and the Sun measure 0.27 deg, the Earth from the Moon 0.95 deg."""
VISIBLE_UM = (0.45, 0.75)
"""Assumed band [um] of a camera without a known band."""
LONG_RAD = float(np.deg2rad(28.0))
"""Smallest correlation length of a pattern: half of the horizon's radius from an orbit of 800 km."""
PIECE_RAD = float(np.deg2rad(4.0))
"""Length of a piece of limb, by azimuth: clouds vary faster along it than sunlight."""
LENS_PX = 0.8
"""Blur of a usual lens (0.7 px), the pixel and reading between pixels."""


def model_error(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    observation: Observation,
    estimates: str = "geocentric",
    slow_px: float = SLOW_PX,
) -> tuple[FloatArray, FloatArray]:
    """Return how far the known height raises the limb [rad], shape (n,), and the covariance [rad^2] of (axis along
    basis 1, along basis 2, half-angle) of what is not known, shape (3, 3).

    The basis is :func:`horizonval.geometry.rotation.tangent_basis` of the axis. ``los_cam``: shape (n, 3);
    ``axis_cam``: shape (3,); ``estimates``: ``"geocentric"`` or ``"geodetic"``; ``slow_px``: as for
    :func:`horizonval.estimation.limb.cone.slow_error`. Raises ``LinAlgError``: the points do not determine a cone.
    """
    camera, prior = observation.camera, observation.prior
    by_height, gain = math.tan(rho_rad) / prior.sphere_radius_m, cone_gain(los_cam, axis_cam)
    height, patterns = np.zeros(len(los_cam)), np.zeros((0, len(los_cam)))
    if observation.band_kind == "solar":
        height, patterns = sunlit_heights(los_cam, axis_cam, rho_rad, observation)
    u, v = (los_cam @ tangent_basis(axis_cam)).T
    azimuth = np.arctan2(v, u)
    off = off_axis_angle(los_cam, axis_cam) - rho_rad - by_height * height
    off -= np.column_stack([np.cos(azimuth), np.sin(azimuth), np.ones(len(off))]) @ (gain @ off)
    seen = Relief(seen_relief(off, azimuth) / by_height, correlation_rad=0.15)
    covariance = systematic_covariance(
        los_cam,
        axis_cam,
        rho_rad,
        flattening=prior.flattening,
        reliefs=(*reliefs(observation.band_kind, prior.limb_relief_m), seen),
        earth_radius_m=prior.sphere_radius_m,
        estimates="geodetic" if estimates == "geodetic" else "geocentric",
    )
    covariance = covariance + slow_error(los_cam, axis_cam, 1.0 / max(camera.fx, camera.fy), slow_px)
    moved = by_height * patterns @ gain.T
    return by_height * height, np.asarray(covariance + moved.T @ moved)


def seen_relief(off: FloatArray, azimuth: FloatArray) -> float:
    """Return the standard deviation of points' distances from the limb, shape (n,), without their own scatter.

    It is taken over means of pieces of the limb, of :data:`PIECE_RAD`, less the part of the points' scatter in them.
    """
    _, piece = np.unique(np.floor(azimuth / PIECE_RAD), return_inverse=True)
    count = np.bincount(piece)
    means = np.bincount(piece, off) / count
    free = max(len(off) - len(count), 1)
    scatter = float(np.sum((off - means[piece]) ** 2)) / free
    return math.sqrt(max(float(count @ means**2) / len(off) - scatter * len(count) / len(off), 0.0))


def sunlit_heights(
    los_cam: FloatArray, axis_cam: FloatArray, rho_rad: float, observation: Observation
) -> tuple[FloatArray, FloatArray]:
    """Return the height at which a sunlit limb is steepest [m], shape (n,), and one standard deviation of its patterns
    [m], shape (k, n).

    Parameters as for :func:`model_error`. A limb that the Sun does not light has the height 0.
    """
    sun, sigma = observation.sun_cam, observation.prior.sun_sigma_rad
    sigma = SUN_SIGMA_RAD if sigma is None else sigma
    suns = fibonacci_sphere(SUNS) if sun is None else np.concatenate([[sun], misread_suns(sun, sigma)])
    zenith, azimuth = sun_angles_at(los_cam, -inwards_of(los_cam, axis_cam), suns)
    if sun is None:
        lit = (zenith <= 0.5 * np.pi).all(axis=1)
        if not lit.any():
            return np.zeros(len(los_cam)), np.zeros((0, len(los_cam)))
        zenith, azimuth = zenith[lit], azimuth[lit]
    blur_m = observation.prior.sphere_radius_m / math.tan(rho_rad) * blur_across(observation.camera, los_cam, axis_cam)
    found = _heights(observation.band_um).at(np.tile(blur_m, len(zenith)), zenith.ravel(), azimuth.ravel())
    heights, *patterns = np.nan_to_num(found).reshape(len(found), *zenith.shape)
    if sun is None:
        # The bow that all of them make is an error of a method that knows no Sun; the mean height is none.
        return np.zeros(len(los_cam)), (heights - heights.mean()) / math.sqrt(len(heights))
    return heights[0], np.concatenate([heights[1:] - heights[0], np.array(patterns)[:, 0]])


@cache
def _heights(band_um: tuple[float, float] | None) -> HeightGrid:
    """Return the steepest height of a sunlit band without clouds, and its patterns, by blur and the Sun's angles."""
    table = None if band_um is None else shipped_templates("solar", band_um)
    if table is None:
        assert band_um != VISIBLE_UM
        return _heights(VISIBLE_UM)
    # A blur below 4 km sees the layers of one haze, which a mean over many has not.
    sigmas_m = np.geomspace(4e3, 512e3, 15)
    modes = np.moveaxis(table.modes[:, :, (table.correlation_rad >= LONG_RAD).all(axis=(0, 2))], 2, 0)
    states = np.concatenate([without_clouds(table)[None], table.mean + modes, table.mean - modes])
    axes, found = heights_on_grid(table, np.maximum(states, FAINTEST * table.mean), sigmas_m, steepest_height)
    mean, more, less = np.split(np.moveaxis(found[0], 1, 0), [1, 1 + len(modes)])
    return HeightGrid(sigmas_m, axes, np.concatenate([mean, 0.5 * (more - less)]))


def blur_across(camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray) -> FloatArray:
    """Return the blur across the limb [rad], shape (n,): of the lens in pixels, and of the search in angles."""
    step_rad = 1.0 / max(camera.fx, camera.fy)
    half = 0.5 * step_rad * inwards_of(los_cam, axis_cam)
    uv, _ = project(camera, np.array([los_cam - half, los_cam + half]))
    px = np.linalg.norm(uv[1] - uv[0], axis=1)
    return np.asarray(step_rad * np.hypot(LENS_PX / np.where(px > 0.0, px, np.nan), 1.0))


def contradicted(claim: Fit, observation: Observation, rho_rad: float, variance: float) -> Refusal | None:
    """Refuse a claim at :data:`SIGMAS` standard deviations from the known altitude or attitude.

    ``rho_rad``: half-angle of the limb as it is seen, ``variance``: its variance [rad^2].
    """
    off = _altitude_off(observation, rho_rad, variance)
    if off is not None:
        reason = f"the angular radius is {np.degrees(off):+.2f} deg from that of the known altitude"
        return Refusal(Outcome.AMBIGUOUS, reason, claim.points)
    if observation.prior.rough_nadir is None:
        return None
    known, sigma = observation.prior.rough_nadir
    nadir = np.asarray(claim.nadir_cam)
    basis = tangent_basis(nadir)
    apart = basis.T @ (known - nadir)
    spread = basis.T @ claim.total_covariance_nadir_cam @ basis + sigma**2 * np.eye(2)
    # Beyond a right angle the difference of two unit vectors gets no longer across the first one.
    if known @ nadir > 0.0 and apart @ np.linalg.solve(spread, apart) <= SIGMAS**2:
        return None
    degrees = np.degrees(angle_between(known, nadir))
    return Refusal(Outcome.AMBIGUOUS, f"the nadir lies {degrees:.1f} deg from that of the known attitude", claim.points)


def _altitude_off(observation: Observation, rho_rad: float, variance: float) -> float | None:
    """Return the departure of an angular radius from the one at the known altitude, None if nothing contradicts it."""
    prior, camera = observation.prior, observation.camera
    radius = prior.sphere_radius_m
    if prior.angular_radius is not None:
        expected, of_altitude = prior.angular_radius
    elif prior.r_itrs is not None and prior.position_sigma_m is not None and np.linalg.norm(prior.r_itrs) > radius:
        distance = float(np.linalg.norm(prior.r_itrs))
        expected = float(np.arcsin(radius / distance))
        # The Earth's radius below the satellite is that of the sphere to so much.
        local = LOCAL_RADIUS_SHARE * prior.flattening * radius
        of_altitude = float(np.tan(expected) / distance) ** 2 * (prior.position_sigma_m**2 + local**2)
    else:
        return None
    # In coarse pixels points lie in the limb's light, not at its edge.
    misplaced = (MISPLACED_PX / max(camera.fx, camera.fy)) ** 2
    slack = SIGMAS * float(np.sqrt(variance + of_altitude + misplaced))
    # A limb h higher adds h tan(rho) / R.
    low, high = (height * np.tan(expected) / radius for height in limb_height_m(observation.band_kind))
    off = rho_rad - expected
    return None if low - slack <= off <= high + slack else off
