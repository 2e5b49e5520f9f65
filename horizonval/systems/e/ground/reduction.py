"""From a frame to azimuth and elevation: what an observer does, who knows the mount's reading and an old orbit.

streak's middle -> direction in the camera -> station axes (the mount's reading) -> refraction taken off -> light time
taken off (by the old orbit's change of direction in the light time). The result is the geometric direction at the
nominal middle of the exposure. Its covariance, in the plane across the line of sight (x towards rising azimuth, y up),
with the apparent rate w of the satellite [rad/s]::

    C = C_centroid + pointing^2 I + clock^2 w w^T + refraction^2 y y^T

``pointing`` and ``clock`` hold the parts that stay the same during a pass as well, which no averaging takes away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light

from horizonval.core.arrays import FloatArray
from horizonval.geometry.camera import project, unproject
from horizonval.systems.e.ground import frames as cam
from horizonval.systems.e.ground.detection import Detection, NoDetection, Noise, find_streak
from horizonval.systems.e.ground.frames import ARCSEC, Exposure, Frames, azimuth_elevation
from horizonval.systems.e.ground.sky import true_elevation
from horizonval.systems.e.localisation.stations import enu_directions

REFRACTION_RAD = 0.05 * ARCSEC
"""Claimed for what the correction leaves above 45 deg, barometer and thermometer being right."""


@dataclass(frozen=True)
class Sighting:
    """A direction measured in one frame.

    ``azimuth_rad``, ``elevation_rad``: geometric, at the nominal instant; ``covariance``, ``centroid_covariance``:
    shape (2, 2), of (azimuth x cos elevation, elevation) [rad2], and the centroid's share; ``rate_rad_s``: predicted
    motion, likewise.
    """

    azimuth_rad: float
    elevation_rad: float
    covariance: FloatArray
    centroid_covariance: FloatArray
    rate_rad_s: FloatArray
    detection: Detection


def noise_of(frames: Frames) -> Noise:
    """Return the noise the fit reckons with: read and dark counts, the converter's steps, unequal response."""
    detector = cam.detector_of(frames.camera)
    dark = detector.dark_current_e_per_s * detector.exposure_s
    return Noise(math.sqrt(detector.read_noise_e**2 + dark + cam.gain_e_per_dn(frames.camera) ** 2 / 12), detector.prnu)


def measure(frames: Frames, exposure: Exposure) -> Sighting | NoDetection:
    """Return the direction of the satellite in a frame, or why there is none."""
    dark = cam.detector_of(frames.camera).dark_current_e_per_s * cam.detector_of(frames.camera).exposure_s
    electrons = cam.electrons_of_dn(exposure.dn, frames.camera) - dark
    enu_from_cam = cam.cam_from_enu(*exposure.read_az_el_rad).T
    run = predicted_run(frames, exposure, enu_from_cam)
    found = find_streak(electrons, run, frames.camera.optics.psf_sigma_px, noise_of(frames))
    if isinstance(found, NoDetection):
        return found
    return _direction(frames, exposure, found, enu_from_cam)


def predicted_run(frames: Frames, exposure: Exposure, enu_from_cam: FloatArray) -> tuple[float, float]:
    """Return the streak [px] that the old orbit makes in an exposure."""
    half = 0.5 * cam.detector_of(frames.camera).exposure_s
    t = exposure.second + frames.prediction_s + np.array([-half, half])
    uv, _ = project(frames.geometry, frames.path.apparent_enu(frames.air[0], t) @ enu_from_cam)
    return float(uv[1, 0] - uv[0, 0]), float(uv[1, 1] - uv[0, 1])


def _direction(frames: Frames, exposure: Exposure, found: Detection, enu_from_cam: FloatArray) -> Sighting:
    errors, geometry = frames.errors, frames.geometry
    t = exposure.second + frames.prediction_s
    now = frames.path.geometric_enu(t)
    distance = float(np.linalg.norm(now))
    seen = enu_from_cam @ unproject(geometry, np.array(found.fit.middle_uv))
    azimuth, elevation = azimuth_elevation(seen)
    straight = enu_directions(azimuth, true_elevation(frames.air[1], elevation, distance))
    before = frames.path.geometric_enu(t - distance / speed_of_light)
    moved = now / distance - before / np.linalg.norm(before)
    azimuth, elevation = azimuth_elevation(straight + moved)

    across = np.stack(tangents(float(azimuth), float(elevation)))
    step = 0.05
    ends = frames.path.geometric_enu(t + np.array([-step, step]))
    ends /= np.linalg.norm(ends, axis=-1, keepdims=True)
    rate = across @ (ends[1] - ends[0]) / (2.0 * step)
    # Columns run with the azimuth, rows against the elevation; the satellite is near the image's middle.
    to_angle = np.diag([1.0 / geometry.fx, -1.0 / geometry.fy])
    centroid = to_angle @ found.fit.covariance[:2, :2] @ to_angle
    pointing2 = errors.pointing_rad**2 + errors.pointing_common_rad**2
    clock2 = errors.clock_s**2 + errors.clock_common_s**2
    covariance = centroid + pointing2 * np.eye(2) + clock2 * np.outer(rate, rate) + np.diag([0.0, REFRACTION_RAD**2])
    return Sighting(float(azimuth), float(elevation), covariance, centroid, rate, found)


def tangents(azimuth_rad: float, elevation_rad: float) -> tuple[FloatArray, FloatArray]:
    """Return unit vectors (east, north, up) across a line of sight: towards rising azimuth, and upwards."""
    sa, ca, se, ce = np.sin(azimuth_rad), np.cos(azimuth_rad), np.sin(elevation_rad), np.cos(elevation_rad)
    return np.array([ca, -sa, 0.0]), np.array([-se * sa, -se * ca, ce])
