"""How bright the limb is, from the Sun's place alone: a small table in place of a renderer.

Reflectance ``pi L / E`` (L radiance of the limb's brightest layer, E the Sun's irradiance across its rays, both in the
band) of clean US-standard air seen from 500 km in 450 to 750 nm, computed once with this suite's own march, all orders
of scattering. It depends on the Sun's zenith angle z at the tangent point and on the side from which the Sun comes:
ahead (the Sun is behind the limb and its light is scattered forwards), from the side, from behind the camera. The
ground's part is ``albedo G(z)`` at the limb and ``albedo B(z)`` some ten kilometres below it.

Haze makes a limb a little darker, and up to five times brighter where the Sun stands low behind it: ``HAZE`` is the
ratio of the brightest layers with and without the default background of particles (the same march, ground of albedo
0.3), by the Sun's zenith angle and azimuth. It serves for every model of particles.

Good to 30 % by day in visible bands; a factor of two in other bands, other air and in twilight, where the table falls
by ten every 1.5 to 4 deg. What is decided with it is a signal against five times its noise and against full scale, and
frames within a factor of three of a threshold are called borderline (:mod:`horizonval.scoring.limits`).

Without air the ground alone is seen: ``pi L / E = albedo cos(z)``.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from horizonval.core.arrays import FloatArray

ZENITH_DEG = np.array([0, 30, 60, 70, 80, 85, 88, 90, 92, 94, 96, 98, 100, 104, 110], dtype=np.float64)
AHEAD = np.array(
    [0.154, 0.185, 0.238, 0.241, 0.212, 0.152, 0.092, 0.048, 1.7e-2, 5.3e-3, 1.5e-3, 4.1e-4, 9.9e-5, 2.6e-6, 5e-8]
)
SIDE = np.array(
    [0.154, 0.154, 0.150, 0.144, 0.127, 0.103, 0.074, 0.046, 1.9e-2, 3.3e-3, 2.8e-4, 1.1e-5, 1.8e-6, 8e-8, 5e-8]
)
BEHIND = np.array(
    [0.154, 0.184, 0.240, 0.247, 0.231, 0.200, 0.164, 0.126, 8.1e-2, 4.2e-2, 1.7e-2, 5.0e-3, 1.2e-3, 4.5e-5, 5e-8]
)
GROUND_AT_LIMB = np.array(
    [0.317, 0.275, 0.150, 0.096, 0.042, 0.017, 0.007, 0.003, 5e-4, 1e-4, 2e-5, 2e-6, 2e-7, 1e-8, 1e-8]
)
GROUND_BELOW = np.array([0.59, 0.51, 0.28, 0.185, 0.083, 0.035, 0.012, 0.005, 1e-3, 2e-4, 4e-5, 4e-6, 4e-7, 1e-8, 1e-8])
HAZE_ZENITH_DEG = np.array([0, 30, 60, 70, 80, 85, 88, 90, 92, 94, 96, 98, 100, 104], dtype=np.float64)
HAZE_AZIMUTH_DEG = np.array([0, 15, 30, 45, 60, 90, 180], dtype=np.float64)
HAZE = np.array(
    [
        [0.93, 0.93, 0.93, 0.93, 0.93, 0.93, 0.93],
        [1.06, 1.05, 1.03, 1.01, 0.98, 0.94, 0.86],
        [1.71, 1.57, 1.34, 1.17, 1.06, 0.95, 0.82],
        [2.38, 2.03, 1.53, 1.24, 1.09, 0.96, 0.82],
        [3.32, 2.54, 1.67, 1.28, 1.11, 0.96, 0.82],
        [3.46, 2.56, 1.62, 1.25, 1.09, 0.95, 0.81],
        [3.66, 2.46, 1.50, 1.16, 1.05, 0.92, 0.80],
        [4.40, 2.88, 1.59, 1.16, 1.02, 0.91, 0.81],
        [5.13, 3.43, 1.90, 1.31, 1.07, 0.87, 0.84],
        [4.38, 3.01, 1.71, 1.18, 0.99, 0.88, 0.84],
        [3.50, 2.38, 1.45, 1.17, 1.02, 0.83, 0.85],
        [3.24, 2.34, 1.52, 1.20, 1.07, 1.56, 0.87],
        [3.02, 2.24, 1.50, 1.20, 1.11, 1.66, 0.89],
        [2.43, 1.95, 1.47, 1.59, 2.20, 1.71, 0.94],
    ]
)


def limb_reflectance(
    zenith_rad: FloatArray, cos_azimuth: FloatArray, albedo: float, *, air: bool, hazy: bool = False
) -> FloatArray:
    """Return ``pi L / E`` of the limb.

    Parameters
    ----------
    zenith_rad : ndarray
        Sun's zenith angle at the tangent point.
    cos_azimuth : ndarray
        Cosine of the angle between the line of sight and the Sun's azimuth there: 1 with the Sun ahead.
    albedo : float
        Of the ground.
    air : bool
        Whether there is any.
    hazy : bool
        Whether the air has particles.
    """
    if not air:
        return np.asarray(albedo * np.maximum(np.cos(zenith_rad), 0.0))
    clear = _path(zenith_rad, cos_azimuth) + albedo * _log_table(zenith_rad, GROUND_AT_LIMB)
    return clear * _haze(zenith_rad, cos_azimuth) if hazy else clear


def brightest_reflectance(
    zenith_rad: FloatArray, cos_azimuth: FloatArray, albedo: float, *, air: bool, hazy: bool = False
) -> FloatArray:
    """Return ``pi L / E`` of the brightest thing near the limb, at it or below it; parameters as above."""
    at_limb = limb_reflectance(zenith_rad, cos_azimuth, albedo, air=air, hazy=hazy)
    if not air:
        return at_limb
    path = _path(zenith_rad, cos_azimuth)
    if hazy:
        path = path * _haze(zenith_rad, cos_azimuth)
    return np.maximum(at_limb, 0.8 * path + albedo * _log_table(zenith_rad, GROUND_BELOW))


def _haze(zenith_rad: FloatArray, cos_azimuth: FloatArray) -> FloatArray:
    azimuth = np.degrees(np.arccos(np.clip(cos_azimuth, -1.0, 1.0)))
    zenith = np.clip(np.degrees(zenith_rad), HAZE_ZENITH_DEG[0], HAZE_ZENITH_DEG[-1])
    table = RegularGridInterpolator((HAZE_ZENITH_DEG, HAZE_AZIMUTH_DEG), HAZE)
    return np.asarray(table(np.stack([zenith, azimuth], axis=-1)))


def _path(zenith_rad: FloatArray, cos_azimuth: FloatArray) -> FloatArray:
    side = _log_table(zenith_rad, SIDE)
    ahead, behind = (_log_table(zenith_rad, table) for table in (AHEAD, BEHIND))
    return np.where(
        cos_azimuth > 0, side + (ahead - side) * np.abs(cos_azimuth), side + (behind - side) * np.abs(cos_azimuth)
    )


def _log_table(zenith_rad: FloatArray, table: FloatArray) -> FloatArray:
    return np.asarray(np.exp(np.interp(np.degrees(zenith_rad), ZENITH_DEG, np.log(table))))
