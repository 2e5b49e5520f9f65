"""The height at which a sunlit limb is steepest, and how heights of the limb move a fitted cone.

A camera that does not resolve the air sees the limb where its blurred profile is steepest. That height changes with the
Sun's direction by tens of kilometres in wide pixels, and the resulting bow of an arc pulls the nadir by tenths of a
degree. It is predictable where the Sun's direction is known to a degree.

The position where a blurred profile is steepest, and the profiles that one camera sees, are in
:mod:`horizonval.estimation.fit.heights`. The table of heights has the observer's distance as one more axis.

**What is unknown.** Heights are those of limbs without clouds: the mean of limbs with and without clouds has two steep
positions. The modes of the table that are correlated over a low orbit's limb or more (haze, presence of clouds, ground)
are patterns of height; each is half of the change of height from one standard deviation below the mean to one above.
Shorter variations are part of the limb's relief (:mod:`horizonval.earth.limb_heights`).

**Effect on the cone.** A limb that is ``h`` above the sphere is seen ``delta = h tan(rho) / R`` outside of it, and the
fitted cone moves by the least-squares solution of ``t(phi) . dn + drho = delta(phi)``.

Neglected: refraction is in the table's heights; the curvature of a small disc in wide blurs is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.heights import (
    FAINTEST,
    SUNS,
    ZENITHS_RAD,
    HeightGrid,
    heights_on_grid,
    misread_suns,
    steepest_height,
    sun_angles_at,
    without_clouds,
)
from horizonval.estimation.fit.templates import LimbTemplates, shipped_templates
from horizonval.estimation.limb.cone import cone_gain, inwards_of
from horizonval.estimation.prior import MEAN_RADIUS_M
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import fibonacci_sphere

VISIBLE_UM = (0.45, 0.75)
"""Assumed band [um] of a camera without a known band."""


class SunlitHeights:
    """Heights of a band's steepest position, and their patterns, on a grid. ``table``: of a sunlit band."""

    def __init__(self, table: LimbTemplates) -> None:
        # From low orbits to the geostationary one; heights are linear in the slant between. A blur below 4 km sees the
        # layers of one haze, which a mean over many has not.
        altitudes_m, sigmas_m = (36000e3, 2000e3, 700e3, 300e3), np.geomspace(4e3, 512e3, 15)
        self._slants = np.array([math.tan(math.asin(MEAN_RADIUS_M / (MEAN_RADIUS_M + up))) for up in altitudes_m])

        def steepest(states: FloatArray, *altitude_m: float) -> FloatArray:
            found = heights_on_grid(table, states, sigmas_m, steepest_height, *altitude_m)[1][0]
            return np.moveaxis(found, 1, 0)

        axes = ZENITHS_RAD, table.axes[1]
        clear = without_clouds(table)[None]
        self._mean = HeightGrid(sigmas_m, axes, np.concatenate([steepest(clear, up) for up in altitudes_m]))
        # Half of the horizon's radius from an orbit of 800 km: shorter modes are no patterns of the whole arc.
        long = table.modes[:, :, (table.correlation_rad >= math.radians(28.0)).all(axis=(0, 2))]
        states = table.mean + np.moveaxis(long, 2, 0), table.mean - np.moveaxis(long, 2, 0)
        more, less = (steepest(np.maximum(one, FAINTEST * table.mean)) for one in states)
        self._patterns = HeightGrid(sigmas_m, axes, 0.5 * (more - less))

    def height_m(self, rho_rad: float, sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return the heights, shape (n,), of points with a blur and the Sun's angles there; NaN where it is night.

        ``rho_rad``: angular radius of the Earth; ``sigma_m``, ``zenith``, ``azimuth``: shape (n,). Beyond the ends of
        distances and blurs the last values hold.
        """
        slant = np.clip(math.tan(rho_rad), self._slants[0], self._slants[-1])
        i = min(int(np.searchsorted(self._slants, slant, side="right")), len(self._slants) - 1)
        share = (slant - self._slants[i - 1]) / (self._slants[i] - self._slants[i - 1])
        found = self._mean.at(sigma_m, zenith, azimuth)
        return np.asarray((1.0 - share) * found[i - 1] + share * found[i])

    def patterns_m(self, sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return one standard deviation of every pattern, shape (k, n)."""
        return self._patterns.at(sigma_m, zenith, azimuth)


@cache
def heights_of(band_um: tuple[float, float] | None) -> SunlitHeights:
    """Return the heights of a band; those of the visible one where no table is of it, or nobody says the band."""
    table = None if band_um is None else shipped_templates("solar", band_um)
    if table is None and band_um != VISIBLE_UM:
        return heights_of(VISIBLE_UM)
    assert table is not None
    return SunlitHeights(table)


@dataclass(frozen=True)
class SunlitLimb:
    """The limb's height at n points; NaN where the table has none (no light, or no edge).

    ``height_m``: shape (n,), above the ground; ``patterns_m``: shape (k, n), independent errors of it, one standard
    deviation each, every one along the whole limb together; ``zenith_rad``: shape (n,), of the Sun at the tangent
    point.
    """

    height_m: FloatArray
    patterns_m: FloatArray
    zenith_rad: FloatArray


def sunlit_limb(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    sun_cam: FloatArray,
    blur_rad: FloatArray,
    sun_sigma_rad: float = 0.0,
    band_um: tuple[float, float] | None = None,
) -> SunlitLimb:
    """Return the height at which the limb is steepest.

    ``los_cam``: shape (n, 3), lines of sight to the limb; ``axis_cam``: nadir; ``rho_rad``: angular radius of the
    Earth; ``sun_cam``: shape (3,); ``blur_rad``: shape (n,), standard deviation of what blurs the limb across it:
    :func:`blur_across`; ``sun_sigma_rad``: of the Sun's direction, each of two angles: two more patterns; ``band_um``:
    of the camera, the visible one without.
    """
    heights = heights_of(band_um)
    sigma = blur_rad * MEAN_RADIUS_M / math.tan(rho_rad)
    zenith, azimuth = sun_angles(los_cam, axis_cam, sun_cam)
    height = heights.height_m(rho_rad, sigma, zenith, azimuth)
    patterns = list(heights.patterns_m(sigma, zenith, azimuth))
    if sun_sigma_rad > 0.0:
        suns = misread_suns(sun_cam, sun_sigma_rad)
        patterns += list(height_under(los_cam, axis_cam, rho_rad, suns, blur_rad, band_um)[0] - height)
    known = np.isfinite(height) & np.isfinite(patterns).all(axis=0)
    return SunlitLimb(np.where(known, height, np.nan), np.where(known, np.array(patterns), np.nan), zenith)


def height_under(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    suns_cam: FloatArray,
    blur_rad: FloatArray,
    band_um: tuple[float, float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return height [m] and the Sun's zenith angle, shape (n,) each or (k, n) for Suns (k, 3); NaN without a height."""
    zenith, azimuth = sun_angles(los_cam, axis_cam, suns_cam)
    sigma = np.broadcast_to(blur_rad * MEAN_RADIUS_M / math.tan(rho_rad), zenith.shape)
    height = heights_of(band_um).height_m(rho_rad, sigma.ravel(), zenith.ravel(), azimuth.ravel())
    return height.reshape(zenith.shape), zenith


def sun_angles(los_cam: FloatArray, axis_cam: FloatArray, sun_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth from the line of sight [rad] of the Sun, shape (n,) each or (k, n) for k Suns.

    The vertical at a tangent point is perpendicular to the line of sight, away from the cone's axis.
    """
    up = los_cam * (los_cam @ axis_cam)[:, None] - axis_cam
    up /= np.linalg.norm(up, axis=1)[:, None]
    return sun_angles_at(los_cam, up, sun_cam)


def blur_across(camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray) -> FloatArray:
    """Return the blur across the limb [rad], shape (n,): of lens, pixels and the search for the edge."""
    # A usual lens (0.7 px), the pixel's own width and reading between pixels.
    lens_px = 0.8
    inwards = inwards_of(los_cam, axis_cam)
    rad_per_px = 1.0 / max(camera.fx, camera.fy)
    before, _ = project(camera, los_cam - 0.5 * rad_per_px * inwards)
    behind, _ = project(camera, los_cam + 0.5 * rad_per_px * inwards)
    px = np.linalg.norm(behind - before, axis=1)
    local = lens_px * rad_per_px / np.where(px > 0.0, px, np.nan)
    return np.hypot(local, rad_per_px)


def cone_perturbation(
    los_cam: FloatArray, axis_cam: FloatArray, rho_rad: float, heights_m: FloatArray, earth_radius_m: float
) -> FloatArray:
    """Return how far heights (k, n) move the fitted cone: (axis along basis 1, basis 2, half-angle) [rad], (k, 3).

    Raises ``LinAlgError`` if the points (n, 3) do not determine a cone.
    """
    return np.asarray(heights_m @ cone_gain(los_cam, axis_cam).T * (math.tan(rho_rad) / earth_radius_m))


def unknown_sun_covariance(
    los_cam: FloatArray,
    axis_cam: FloatArray,
    rho_rad: float,
    blur_rad: FloatArray,
    earth_radius_m: float,
    band_um: tuple[float, float] | None = None,
) -> FloatArray:
    """Return the covariance [rad^2], shape (3, 3), of a cone through a sunlit limb for a method that knows no Sun.

    Every Sun that lights the whole arc is taken to be equally likely. Parameters as for :func:`sunlit_limb`; raises
    ``LinAlgError`` if the points do not determine a cone.
    """
    # Heights are smooth along the limb: some 60 points stand for all of them.
    stride = max(1, len(los_cam) // 60)
    los_cam, blur_rad = los_cam[::stride], blur_rad[::stride]
    height, zenith = height_under(los_cam, axis_cam, rho_rad, fibonacci_sphere(SUNS), blur_rad, band_um)
    lit = (zenith.max(axis=1) <= 0.5 * np.pi) & np.isfinite(height).all(axis=1)
    if not lit.any():
        return np.zeros((3, 3))
    moved = cone_perturbation(los_cam, axis_cam, rho_rad, height[lit], earth_radius_m)
    moved[:, 2] -= moved[:, 2].mean()
    return np.asarray(moved.T @ moved / len(moved))
