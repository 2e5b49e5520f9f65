"""The infrared horizon of a stored truth as a curve in the camera: where a perfect locator would find it."""

from __future__ import annotations

import math

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import project
from horizonval.geometry.frames import rotate
from horizonval.geometry.horizon import horizon_by_azimuth
from horizonval.truth.infrared_horizon.rays import directions

HALF_PLATEAU, MAXIMUM_GRADIENT = "half_plateau", "maximum_gradient"
_VISIBLE_SAMPLES = 7200


def curve_cam(truth: FrameTruth, band: str, samples: int, locator: str = HALF_PLATEAU) -> tuple[FloatArray, FloatArray]:
    """Return directions in camera axes, shape (samples, 3), and heights [m] round the infrared horizon of a band.

    In equal steps of azimuth about the geocentric nadir, from north. Between the stored azimuths the height, and the
    angle by which the curve stands above the exact hard horizon, are linear.
    """
    stored = truth.infrared_horizon[band]
    azimuth = np.arange(samples) * (math.tau / samples)
    at = np.radians(stored["azimuth_deg"])
    above = np.array(stored[f"{locator}_angle_rad"]) - np.array(stored["geometric_angle_rad"])
    ellipsoid = truth.ellipsoid
    hard = horizon_by_azimuth(truth.r_itrs, ellipsoid, azimuth)
    d_itrs = directions(truth.r_itrs, azimuth, hard + np.interp(azimuth, at, above, period=math.tau))
    height = np.interp(azimuth, at, stored[f"{locator}_height_m"], period=math.tau)
    return rotate(truth.q_cam_from_itrs, d_itrs), height


def visible_height_m(truth: FrameTruth, band: str, locator: str = HALF_PLATEAU) -> float | None:
    """Return the mean height of a band's infrared horizon over what of it lies inside the image; None without."""
    if band not in truth.infrared_horizon:
        return None
    camera = truth.camera_model
    d_cam, height = curve_cam(truth, band, _VISIBLE_SAMPLES, locator)
    uv, _ = project(camera, d_cam)
    low, high = -0.5, np.array([camera.width, camera.height]) - 0.5
    # Comparisons with NaN, the mark of a direction without an image, are False.
    inside = ((uv >= low) & (uv <= high)).all(axis=-1)
    return float(height[inside].mean()) if inside.any() else None
