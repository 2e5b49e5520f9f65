r"""How high above the ground a sunlit limb is steepest, from the place of the Sun: a table of marched limbs.

A camera that does not resolve the air sees the limb where its blurred profile is steepest. That place is not fixed:
ground that gets darker inwards or outwards pulls at it, air that is lit from ahead shines higher up, and towards the
terminator the lowest sunlit layer rises. With pixels of 20 km it moves by 10 km between an overhead and a low Sun, by
another 20 km to the terminator, and differently on the side towards the Sun and away from it. The bow that this makes
of an arc pulls the nadir by tenths of a degree, and it is known where the Sun's direction is: to a degree is enough.

Heights come from the shipped profiles of the camera's band, which are means over air, haze, clouds and ground, and so
does what a sensor cannot know of them (:mod:`horizonval.estimation.limb.model.sunlit_heights`).

Against the place in the table: refraction is in it, and in wide blurs the curvature of a small disc is not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.model.sunlit_heights import EARTH_RADIUS_M, heights_of
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.rotation import tangent_basis

LENS_PX = 0.8
"""Blur of a usual lens (0.7 px), of the pixel's own width and of reading between pixels."""


@dataclass(frozen=True)
class SunlitLimb:
    """The limb's height at points, shape (n,) each; NaN where the table has none (no light, or no edge).

    Attributes
    ----------
    height_m : ndarray, shape (n,)
        Above the ground.
    patterns_m : ndarray, shape (k, n)
        Independent errors of it, one standard deviation each, every one along the whole limb together.
    zenith_rad : ndarray, shape (n,)
        Of the Sun at the tangent point.
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

    Parameters
    ----------
    los_cam : ndarray, shape (n, 3)
        Unit lines of sight to the limb.
    axis_cam : ndarray, shape (3,)
        Nadir.
    rho_rad : float
        Angular radius of the Earth.
    sun_cam : ndarray, shape (3,)
    blur_rad : ndarray, shape (n,)
        Standard deviation of what blurs the limb across it: see :func:`blur_rad`.
    sun_sigma_rad : float
        Of the Sun's direction, each of two angles: two more patterns.
    band_um : tuple of two floats, optional
        Of the camera; the visible one without.
    """
    heights = heights_of(band_um)
    sigma = blur_rad * EARTH_RADIUS_M / math.tan(rho_rad)
    zenith, azimuth = sun_angles(los_cam, axis_cam, sun_cam)
    height = heights.height_m(rho_rad, sigma, zenith, azimuth)
    patterns = list(heights.patterns_m(sigma, zenith, azimuth))
    for k in range(2 if sun_sigma_rad > 0.0 else 0):
        moved = sun_cam + sun_sigma_rad * tangent_basis(sun_cam)[:, k]
        there = heights.height_m(rho_rad, sigma, *sun_angles(los_cam, axis_cam, moved / np.linalg.norm(moved)))
        patterns.append(there - height)
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
    """Return the height [m] alone, and the Sun's zenith angle, shape (n,) each; of Suns (k, 3) the shape is (k, n).

    NaN where the table has no height; other parameters as above.
    """
    zenith, azimuth = sun_angles(los_cam, axis_cam, suns_cam)
    sigma = np.broadcast_to(blur_rad * EARTH_RADIUS_M / math.tan(rho_rad), zenith.shape)
    height = heights_of(band_um).height_m(rho_rad, sigma.ravel(), zenith.ravel(), azimuth.ravel())
    return height.reshape(zenith.shape), zenith


def sun_angles(los_cam: FloatArray, axis_cam: FloatArray, sun_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return zenith angle and azimuth from the line of sight [rad] of the Sun at the tangent points, shape (n,) each.

    Of several Suns, shape (k, 3), they have the shape (k, n).
    The vertical at a tangent point is across the line of sight, away from the cone's axis.
    """
    up = los_cam * (los_cam @ axis_cam)[:, None] - axis_cam
    up /= np.linalg.norm(up, axis=1)[:, None]
    cosine = np.clip(sun_cam @ up.T, -1.0, 1.0)
    level = sun_cam[..., None, :] - cosine[..., None] * up
    length = np.linalg.norm(level, axis=-1)
    ahead = np.einsum("...ij,ij->...i", level, los_cam) / np.where(length > 1e-9, length, 1.0)
    return np.arccos(cosine), np.arccos(np.clip(ahead, -1.0, 1.0))


def blur_rad(camera: CameraModel, los_cam: FloatArray, axis_cam: FloatArray, smoothing_rad: float) -> FloatArray:
    """Return the blur across the limb [rad], shape (n,): that of lens and pixels, and a search's own smoothing."""
    inwards = axis_cam - los_cam * (los_cam @ axis_cam)[:, None]
    inwards /= np.linalg.norm(inwards, axis=1)[:, None]
    step = 0.5 / max(camera.fx, camera.fy)
    before, _ = project(camera, los_cam - step * inwards)
    behind, _ = project(camera, los_cam + step * inwards)
    px_per_rad = np.linalg.norm(behind - before, axis=1) / (2.0 * step)
    local = np.where(px_per_rad > 0.0, LENS_PX / np.where(px_per_rad > 0.0, px_per_rad, 1.0), np.nan)
    return np.hypot(local, smoothing_rad)
