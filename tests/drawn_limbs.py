"""Limbs drawn by numpy alone: the sky of an air with modes, a lens, pixels and noise; and the table of that air."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from horizonval.estimation.fit.heights import everywhere
from horizonval.estimation.fit.templates import LimbTemplates
from horizonval.geometry.camera import CameraModel

RADIUS_M = 6371e3
CAMERA = CameraModel(96, 72, 90.0, 90.0, 47.5, 35.5)
HEIGHT_M = np.concatenate([np.linspace(-400e3, -10e3, 40), np.arange(-9e3, 95e3, 1e3)])
FINE, BLUR_PX, NOISE, BLACK, BRIGHT = 6, 0.6, 4.0, 50.0, 1800.0
LENGTH_RAD = 0.2


def mean_profile(height_m: np.ndarray) -> np.ndarray:
    """An edge at 35 km, 12 km wide, a little brighter inside."""
    return (1.0 + 0.1 * np.exp(np.minimum(height_m - 30e3, 0.0) / 60e3)) / (1.0 + np.exp((height_m - 35e3) / 6e3))


def mode_profiles(height_m: np.ndarray) -> np.ndarray:
    """Brighter air, and a higher edge by 1.2 km."""
    brighter = 0.05 / (1.0 + np.exp((height_m - 35e3) / 6e3))
    higher = mean_profile(height_m - 600.0) - mean_profile(height_m + 600.0)
    return np.array([brighter, higher])


def left_profile(height_m: np.ndarray) -> np.ndarray:
    """What no mode holds: 1.5 % of the brightness, from 10 to 60 km."""
    return 0.015 * mean_profile(height_m) * ((height_m > 10e3) & (height_m < 60e3))


def table(*, modes: bool, left: bool = False) -> LimbTemplates:
    values = mode_profiles(HEIGHT_M)[None, None] if modes else np.zeros((1, 1, 0, len(HEIGHT_M)))
    return LimbTemplates(
        band_kind="thermal",
        band_um=(14.0, 16.3),
        height_m=HEIGHT_M,
        axes=(np.array([0.0]), np.array([1.0])),
        mean=mean_profile(HEIGHT_M)[None, None],
        modes=values,
        mode_kinds=("air",) * values.shape[2],
        correlation_rad=everywhere([LENGTH_RAD] * values.shape[2], 1),
        left_sigma=(left_profile(HEIGHT_M) if left else np.zeros(len(HEIGHT_M)))[None, None],
    )


def picture(
    cam: np.ndarray,
    r: np.ndarray,
    rng: np.random.Generator,
    *,
    modes: bool,
    left: bool = False,
    camera: CameraModel = CAMERA,
    bright: float = BRIGHT,
    noise: float = NOISE,
    strength: float = 1.0,
    air: np.random.Generator | None = None,
    growth: float = 0.0,
) -> np.ndarray:
    """Means over pixels of the sky six times finer, blurred, with the air's coefficients drawn along the limb.

    What is left is a random function too, alike over 5 km of height and 0.1 rad along the limb. The air is drawn from
    ``rng``, or from its own generator: two cameras at one place that are given equal ones see one air. ``growth``: of
    the logarithm of the blur from the axis to the corners, with the square of the angle.
    """
    air = air or rng
    margin = 4
    u = -0.5 - margin + (np.arange((camera.width + 2 * margin) * FINE) + 0.5) / FINE
    v = -0.5 - margin + (np.arange((camera.height + 2 * margin) * FINE) + 0.5) / FINE
    x, y = np.meshgrid((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    length = np.sqrt(1.0 + x * x + y * y)
    d = np.stack([x / length, y / length, 1.0 / length], axis=-1) @ cam
    along = -(d @ r)
    lowest = r + along[..., None] * d
    height = np.linalg.norm(lowest, axis=-1) - RADIUS_M
    sky = mean_profile(height)
    if modes or left:
        up = r / np.linalg.norm(r)
        first = np.cross(up, [0.3, 0.5, 0.8])
        first /= np.linalg.norm(first)
        azimuth = np.arctan2(lowest @ np.cross(up, first), lowest @ first)
        nodes = np.linspace(-np.pi, np.pi, 721)
        sine = np.sqrt(1.0 - (RADIUS_M / np.linalg.norm(r)) ** 2)
        chord2 = (2.0 * sine * np.sin(0.5 * (nodes[:, None] - nodes[None, :]))) ** 2
    if modes:
        draws = along_limb(chord2, LENGTH_RAD, air.standard_normal((len(nodes), 2)))
        for k, profile in enumerate(mode_profiles(height)):
            sky = sky + strength * np.interp(azimuth, nodes, draws[:, k]) * profile
    if left:
        levels = np.arange(0.0, 70e3, 2.5e3)
        over_height = np.linalg.cholesky(
            np.exp(-0.5 * (np.subtract.outer(levels, levels) / 5e3) ** 2) + 1e-6 * np.eye(len(levels))
        )
        field = along_limb(chord2, 0.1, air.standard_normal((len(nodes), len(levels)))) @ over_height.T
        rest = RegularGridInterpolator((nodes, levels), field, bounds_error=False, fill_value=0.0)
        sky = sky + rest(np.stack([azimuth, height], axis=-1)) * left_profile(height)
    sky = np.where(along > 0.0, sky, 0.0) / length**4
    blurred = gaussian_filter(sky, BLUR_PX * FINE)
    if growth:
        off = np.arctan(np.hypot(x, y)) ** 2 / np.arctan(np.hypot(camera.cx / camera.fx, camera.cy / camera.fy)) ** 2
        shares = np.linspace(0.0, 1.4, 15)
        softer = np.array([gaussian_filter(sky, BLUR_PX * np.exp(growth * share) * FINE) for share in shares])
        at = np.clip(off / shares[1], 0.0, len(shares) - 1.001)
        first = at.astype(int)
        one, next_ = (np.take_along_axis(softer, (first + k)[None], axis=0)[0] for k in (0, 1))
        blurred = one + (at - first) * (next_ - one)
    means = blurred.reshape(v.size // FINE, FINE, u.size // FINE, FINE).mean(axis=(1, 3))
    clean = BLACK + bright * means[margin:-margin, margin:-margin]
    return np.rint(clean + rng.normal(0.0, noise, clean.shape))


def along_limb(chord2: np.ndarray, length_rad: float, normals: np.ndarray) -> np.ndarray:
    """Random functions along the limb with a Gaussian correlation, shape of the unit normals (nodes, k).

    By the symmetric root: the signs of eigenvectors are others with other threads, and pictures with them.
    """
    variance, vectors = np.linalg.eigh(np.exp(-0.5 * chord2 / length_rad**2))
    return np.asarray(vectors @ (np.sqrt(np.maximum(variance, 0.0))[:, None] * (vectors.T @ normals)))


def view(seed: int, altitude_m: float = 600e3) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """A place, and a camera that has the limb across its middle."""
    rng = np.random.default_rng(seed)
    up = rng.normal(size=3)
    up /= np.linalg.norm(up)
    r = up * (RADIUS_M + altitude_m)
    level = np.cross(up, rng.normal(size=3))
    level /= np.linalg.norm(level)
    off = np.arcsin((RADIUS_M + 30e3) / (RADIUS_M + altitude_m))
    forward = -np.cos(off) * up + np.sin(off) * level
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return r, np.array([right, np.cross(forward, right), forward]), rng
