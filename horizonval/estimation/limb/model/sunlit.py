r"""How high above the ground a sunlit limb is steepest, from the place of the Sun: a table of marched limbs.

A camera that does not resolve the air sees the limb where its blurred profile is steepest. That place is not fixed:
ground that gets darker inwards or outwards pulls at it, air that is lit from ahead shines higher up, and towards the
terminator the lowest sunlit layer rises. With pixels of 20 km it moves by 10 km between an overhead and a low Sun, by
another 20 km to the terminator, and differently on the side towards the Sun and away from it. The bow that this makes
of an arc pulls the nadir by tenths of a degree, and it is known where the Sun's direction is: to a degree is enough.

The table (``tests/data/make_sunlit_limb.py`` made it) has the height by the Sun's zenith angle and its azimuth from the
line of sight, both at the tangent point on the ground, by the width of the blur in kilometres, and by altitude, which
says how far tangent points of different heights lie apart. It is for clear US standard air, 450 to 750 nm, a ground of
albedo 0.3 and no clouds. What a sensor cannot know is beside it: albedo (0.05 to 0.8), the colour within the band, and
haze. Each is taken to lie evenly between its two ends, which gives three patterns of one standard deviation.

Against the place in the table: refraction (the limb is raised by 1 km at most, everywhere alike), and in wide blurs the
curvature of a small disc.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.directions import tangent_basis

TABLE = Path(__file__).parent / "data" / "sunlit_limb.npz"
EARTH_RADIUS_KM = 6371.0088
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
    """
    sigma_km = blur_rad * EARTH_RADIUS_KM / math.tan(rho_rad)
    zenith, azimuth = sun_angles(los_cam, axis_cam, sun_cam)
    height = _height_km(rho_rad, sigma_km, zenith, azimuth)
    patterns = list(_others_km(sigma_km, zenith, azimuth))
    for k in range(2 if sun_sigma_rad > 0.0 else 0):
        moved = sun_cam + sun_sigma_rad * tangent_basis(sun_cam)[:, k]
        there = _height_km(rho_rad, sigma_km, *sun_angles(los_cam, axis_cam, moved / np.linalg.norm(moved)))
        patterns.append(there - height)
    known = np.isfinite(height) & np.isfinite(patterns).all(axis=0)
    return SunlitLimb(np.where(known, 1e3 * height, np.nan), np.where(known, 1e3 * np.array(patterns), np.nan), zenith)


def height_under(
    los_cam: FloatArray, axis_cam: FloatArray, rho_rad: float, suns_cam: FloatArray, blur_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the height [m] alone, and the Sun's zenith angle, shape (n,) each; of Suns (k, 3) the shape is (k, n).

    NaN where the table has no height; other parameters as above.
    """
    zenith, azimuth = sun_angles(los_cam, axis_cam, suns_cam)
    sigma_km = np.broadcast_to(blur_rad * EARTH_RADIUS_KM / math.tan(rho_rad), zenith.shape)
    height = _height_km(rho_rad, sigma_km.ravel(), zenith.ravel(), azimuth.ravel())
    return 1e3 * height.reshape(zenith.shape), zenith


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


def _height_km(rho_rad: float, sigma_km: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
    table, _, (least, most) = _tables()
    slant = np.full(len(zenith), np.clip(math.tan(rho_rad), least, most))
    return np.asarray(table(np.column_stack([slant, *_sheet(sigma_km, zenith, azimuth)])))


def _others_km(sigma_km: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> FloatArray:
    _, tables, _ = _tables()
    at = np.column_stack(_sheet(sigma_km, zenith, azimuth))
    return np.array([table(at) for table in tables])


def _sheet(sigma_km: FloatArray, zenith: FloatArray, azimuth: FloatArray) -> list[FloatArray]:
    # Wider and narrower blurs than the table's are taken for its last.
    low, high = _sigma_range()
    return [np.log(np.clip(np.nan_to_num(sigma_km, nan=high), low, high)), np.degrees(zenith), np.degrees(azimuth)]


@cache
def _sigma_range() -> tuple[float, float]:
    with np.load(TABLE) as data:
        return float(data["sigma_km"][0]), float(data["sigma_km"][-1])


@cache
def _tables() -> tuple[RegularGridInterpolator, list[RegularGridInterpolator], tuple[float, float]]:
    """Return the table of heights, those of the patterns, and the range of tan(rho)."""
    with np.load(TABLE) as data:
        sheet = (np.log(data["sigma_km"]), data["zenith_deg"], data["azimuth_deg"])
        slant = np.tan(np.arcsin(EARTH_RADIUS_KM / (EARTH_RADIUS_KM + data["altitude_km"])))[::-1]
        height = data["height_km"][::-1].astype(np.float64)
        dark, bright, blue, red, haze = data["other_km"].astype(np.float64)
    even = math.sqrt(12.0)
    patterns = [(bright - dark) / even, (blue - red) / even, haze / even]
    outside = {"bounds_error": False, "fill_value": np.nan}
    return (
        RegularGridInterpolator((slant, *sheet), height, **outside),
        [RegularGridInterpolator(sheet, pattern, **outside) for pattern in patterns],
        (float(slant[0]), float(slant[-1])),
    )
