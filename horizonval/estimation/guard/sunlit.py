"""The height at which a sunlit limb is steepest, and how heights of the limb move a fitted cone.

A camera that does not resolve the air sees the limb where its blurred profile is steepest. That height changes with the
Sun's direction by tens of kilometres in wide pixels, and the resulting bow of an arc pulls the nadir by tenths of a
degree. It is predictable where the Sun's direction is known to a degree.

**Steepest position of a blurred profile.** A profile is a polygon over the height ``z``, level below its first height,
with the slope changes ``D_j`` at ``z_j``; above the last height its radiance falls to zero over a kilometre. Blurred by
a Gaussian of ``s`` it falls at ``x`` by ::

    -P_s'(x) = - sum_j D_j Phi((x - z_j) / s)

with ``Phi`` the normal distribution. The maximum on a grid is refined by a parabola.

**Sun's angles along the limb.** The profiles (:mod:`horizonval.estimation.fit.templates`) are tabulated by the
Sun's angles at the *lowest point* of each line. The lowest point of a line at the height ``h`` lies the angle ::

    d = acos((R + h) / r) - acos(R / r)

farther from an observer at the distance ``r`` from the Earth's centre than that of the ground's horizon. The table of
heights therefore has the distance as an axis. Logarithms of the profiles are interpolated linearly, because radiance in
twilight falls by an order of magnitude in three degrees.

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
from scipy.interpolate import RegularGridInterpolator
from scipy.special import ndtr

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.heights import (
    EARTH_RADIUS_M,
    FAINTEST,
    SEEN_FROM_M,
    SUNS,
    ZENITHS_RAD,
    seen_from,
    without_clouds,
)
from horizonval.estimation.fit.templates import LimbTemplates, shipped_templates
from horizonval.estimation.limb.cone import cone_gain
from horizonval.estimation.limb.steepest import SIGMA_PX, inwards_of
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import fibonacci_sphere, tangent_basis

TYPICAL_M = 20e3
"""Where the search has its middle: sunlit limbs are steepest from the ground to some 40 km."""
SEARCH_SIGMAS = 5.0
"""As far as the guard looks for the steepest place: six pixels, of 1.25 pixels of blur."""
LEAST_REACH_M = 35e3
"""Smallest search range about the typical height: to 55 km, above which no band has radiance."""
STEPS = 5.0
"""Grid points per blur of the search; a parabola between them leaves a thousandth of the blur."""
FADE_M = 1e3
"""Distance over which the last height's radiance fades: one step of the shipped tables."""


def steepest_height(height_m: FloatArray, profiles: FloatArray, sigma_m: float) -> FloatArray:
    """Return the heights [m], shape (n,); NaN where a profile has no steepest place within reach.

    ``height_m``: shape (h,), rising; ``profiles``: shape (n, h); ``sigma_m``: of the blur.
    """
    slopes = np.diff(profiles, axis=1) / np.diff(height_m)
    ends = np.zeros((len(profiles), 1))
    slopes = np.concatenate([ends, slopes, -profiles[:, -1:] / FADE_M, ends], axis=1)
    places = np.append(height_m, height_m[-1] + FADE_M)
    reach = max(SEARCH_SIGMAS * sigma_m, LEAST_REACH_M)
    step = sigma_m / STEPS
    x = np.arange(TYPICAL_M - reach, TYPICAL_M + reach, step)
    fall = -np.diff(slopes, axis=1) @ ndtr((x[None, :] - places[:, None]) / sigma_m)
    best = np.argmax(fall, axis=1)
    inside = (best > 0) & (best < len(x) - 1)
    best = np.clip(best, 1, len(x) - 2)
    row = np.arange(len(fall))
    before, middle, after = fall[row, best - 1], fall[row, best], fall[row, best + 1]
    bent = before - 2.0 * middle + after
    found = x[best] + 0.5 * step * (before - after) / np.where(bent < 0.0, bent, -1.0)
    return np.where(inside & (middle > 0.0) & (bent < 0.0), found, np.nan)


ALTITUDES_M = (300e3, 700e3, 2000e3, 36000e3)
"""Altitudes of observers, from low orbits to the geostationary one; heights are linear in the slant between."""
SIGMAS_M = np.geomspace(4e3, 512e3, 15)
"""A narrower blur sees the layers of one haze, which a mean over many has not."""
LEAST_LENGTH_RAD = math.radians(28.0)
"""Smallest correlation length of modes that are patterns: half the horizon's radius from an orbit of 800 km."""
VISIBLE_UM = (0.45, 0.75)
"""Assumed band of a camera without a known band."""


class SunlitHeights:
    """Heights of a band's steepest place, and their patterns, on a grid. ``table``: of a sunlit band."""

    def __init__(self, table: LimbTemplates) -> None:
        sheet = (np.log(SIGMAS_M), ZENITHS_RAD, table.axes[1])
        self._slants = [math.tan(math.asin(EARTH_RADIUS_M / (EARTH_RADIUS_M + up))) for up in ALTITUDES_M[::-1]]
        clear = without_clouds(table)
        mean = np.stack([_heights(table, clear[None], up)[0] for up in ALTITUDES_M[::-1]])
        long = table.modes[:, :, (table.correlation_rad >= LEAST_LENGTH_RAD).all(axis=(0, 2))]
        states = [
            np.maximum(table.mean + s * m, FAINTEST * table.mean) for m in np.moveaxis(long, 2, 0) for s in (1, -1)
        ]
        changed = _heights(table, np.array(states), SEEN_FROM_M)
        patterns = np.moveaxis(0.5 * (changed[::2] - changed[1::2]), 0, -1)
        outside = {"bounds_error": False, "fill_value": np.nan}
        self._mean = RegularGridInterpolator((self._slants, *sheet), mean, **outside)
        self._patterns = RegularGridInterpolator(sheet, patterns, **outside)

    def height_m(self, rho_rad: float, sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return the heights, shape (n,), of points with a blur and the Sun's angles there; NaN where it is night.

        ``rho_rad``: angular radius of the Earth; ``sigma_m``: shape (n,), wider and narrower blurs than the table's are
        taken for its last, as are nearer and farther observers; ``zenith``, ``azimuth``: shape (n,).
        """
        slant = np.full(len(zenith), np.clip(math.tan(rho_rad), self._slants[0], self._slants[-1]))
        return np.asarray(self._mean(np.column_stack([slant, _sheet(sigma_m, zenith, azimuth)])))

    def patterns_m(self, sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
        """Return one standard deviation of every pattern, shape (k, n)."""
        return np.asarray(self._patterns(_sheet(sigma_m, zenith, azimuth)).T)


@cache
def heights_of(band_um: tuple[float, float] | None) -> SunlitHeights:
    """Return the heights of a band; those of the visible one where no table is of it, or nobody says the band."""
    table = None if band_um is None else shipped_templates("solar", band_um)
    if table is None and band_um != VISIBLE_UM:
        return heights_of(VISIBLE_UM)
    assert table is not None
    return SunlitHeights(table)


def _sheet(sigma_m: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
    low, high = SIGMAS_M[0], SIGMAS_M[-1]
    return np.column_stack([np.log(np.clip(np.nan_to_num(sigma_m, nan=high), low, high)), zenith, azimuth])


def _heights(table: LimbTemplates, states: FloatArray, altitude_m: float) -> FloatArray:
    """Return the steepest heights of states (s, A, B, h), shape (s, sigma, A, B)."""
    seen = seen_from(table, np.log(np.maximum(states, 1e-300)), altitude_m)
    flat = np.exp(seen).reshape(-1, len(table.height_m))
    found = np.array([steepest_height(table.height_m, flat, float(sigma)) for sigma in SIGMAS_M])
    return np.moveaxis(found.reshape(len(SIGMAS_M), *seen.shape[:3]), 1, 0)


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
    sigma = blur_rad * EARTH_RADIUS_M / math.tan(rho_rad)
    zenith, azimuth = sun_angles(los_cam, axis_cam, sun_cam)
    height = heights.height_m(rho_rad, sigma, zenith, azimuth)
    patterns = list(heights.patterns_m(sigma, zenith, azimuth))
    if sun_sigma_rad > 0.0:
        moved = sun_cam + sun_sigma_rad * tangent_basis(sun_cam).T
        moved /= np.linalg.norm(moved, axis=1)[:, None]
        patterns += list(height_under(los_cam, axis_cam, rho_rad, moved, blur_rad, band_um)[0] - height)
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
    sigma = np.broadcast_to(blur_rad * EARTH_RADIUS_M / math.tan(rho_rad), zenith.shape)
    height = heights_of(band_um).height_m(rho_rad, sigma.ravel(), zenith.ravel(), azimuth.ravel())
    return height.reshape(zenith.shape), zenith


def sun_angles(los_cam: FloatArray, axis_cam: FloatArray, sun_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth from the line of sight [rad] of the Sun, shape (n,) each or (k, n) for k Suns.

    The vertical at a tangent point is perpendicular to the line of sight, away from the cone's axis.
    """
    up = los_cam * (los_cam @ axis_cam)[:, None] - axis_cam
    up /= np.linalg.norm(up, axis=1)[:, None]
    cosine = np.clip(sun_cam @ up.T, -1.0, 1.0)
    level = sun_cam[..., None, :] - cosine[..., None] * up
    length = np.linalg.norm(level, axis=-1)
    ahead = np.einsum("...ij,ij->...i", level, los_cam) / np.where(length > 1e-9, length, 1.0)
    return np.arccos(cosine), np.arccos(np.clip(ahead, -1.0, 1.0))


LENS_PX = 0.8
"""Blur of a usual lens (0.7 px), of the pixel's own width and of reading between pixels."""


def blur_across(camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray) -> FloatArray:
    """Return the blur across the limb [rad], shape (n,): of lens, pixels and the search for the steepest place."""
    inwards = inwards_of(los_cam, axis_cam)
    rad_per_px = 1.0 / max(camera.fx, camera.fy)
    before, _ = project(camera, los_cam - 0.5 * rad_per_px * inwards)
    behind, _ = project(camera, los_cam + 0.5 * rad_per_px * inwards)
    px = np.linalg.norm(behind - before, axis=1)
    local = LENS_PX * rad_per_px / np.where(px > 0.0, px, np.nan)
    return np.hypot(local, SIGMA_PX * rad_per_px)


MOST_POINTS = 60
"""Points that stand for all of them: heights are smooth along the limb."""


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
    stride = max(1, len(los_cam) // MOST_POINTS)
    los_cam, blur_rad = los_cam[::stride], blur_rad[::stride]
    height, zenith = height_under(los_cam, axis_cam, rho_rad, fibonacci_sphere(SUNS), blur_rad, band_um)
    lit = (zenith.max(axis=1) <= 0.5 * np.pi) & np.isfinite(height).all(axis=1)
    if not lit.any():
        return np.zeros((3, 3))
    moved = cone_perturbation(los_cam, axis_cam, rho_rad, height[lit], earth_radius_m)
    moved[:, 2] -= moved[:, 2].mean()
    return np.asarray(moved.T @ moved / len(moved))
