"""The exact horizon of a truth as the camera sees it: sampled evenly round the Earth, and what of it is in view."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import horizon_cam, tangency_points
from horizonval.geometry.rotation import perpendicular
from horizonval.scoring import limits

BoolArray = NDArray[np.bool_]

_STEPS_ACROSS_FIELD = 1000
"""Samples of the horizon per field of view, the narrower side: lengths are right to 0.2 %."""
_SAMPLES_MIN, _SAMPLES_MAX = 21600, 400_000


@dataclass(frozen=True)
class HorizonView:
    """n samples of the horizon, in order.

    ``los_cam`` (n, 3); ``uv`` (n, 2), NaN for directions without an image; ``in_view`` (n,): on the detector and not
    behind a part of the spacecraft; ``cos_zenith`` (n,): of the Sun at the tangent point; ``cos_azimuth`` (n,): of the
    angle there between the line of sight and the Sun's azimuth, 1 with the Sun ahead.
    """

    los_cam: FloatArray
    uv: FloatArray
    in_view: BoolArray
    cos_zenith: FloatArray
    cos_azimuth: FloatArray


def horizon_view(truth: FrameTruth, camera: CameraModel) -> HorizonView:
    """Sample the horizon of a truth."""
    ellipsoid = truth.ellipsoid
    samples = _samples(camera)
    los = horizon_cam(truth.r_itrs, truth.q_cam_from_itrs, ellipsoid, samples)
    uv, _ = project(camera, los)
    points = tangency_points(truth.r_itrs, ellipsoid, np.arange(samples) * (math.tau / samples))
    # The gradient of (x/a)^2 + (y/a)^2 + (z/b)^2: the points lie on the surface.
    normal = points / ellipsoid.axes_m**2
    normal /= np.linalg.norm(normal, axis=-1)[:, None]
    sun = np.array(truth.sun_itrs)
    cos_zenith = normal @ sun
    ahead = points - np.array(truth.r_itrs)
    ahead /= np.linalg.norm(ahead, axis=-1)[:, None]
    level = sun - cos_zenith[:, None] * normal
    length = np.linalg.norm(level, axis=-1)
    # With the Sun in the zenith its azimuth means nothing: any value will do.
    cos_azimuth = np.einsum("ij,ij->i", level, ahead) / np.where(length > 1e-9, length, 1.0)
    return HorizonView(los, uv, seen_in_image(truth, camera, los, uv), cos_zenith, np.clip(cos_azimuth, -1.0, 1.0))


def seen_in_image(truth: FrameTruth, camera: CameraModel, los_cam: FloatArray, uv: FloatArray) -> BoolArray:
    """Return which directions (n, 3) with images (n, 2) lie on the detector and not behind a part of the spacecraft."""
    inside = inside_image(camera, uv)
    outline = truth.part_outline
    if outline is not None:
        inside[inside] = ~outline.covers(los_cam[inside])
    return inside


def inside_image(camera: CameraModel, uv: FloatArray, margin_px: float = 0.0) -> BoolArray:
    """Return which image points lie on the detector, a margin left out."""
    # Comparisons with NaN, the mark of a direction without an image, are False.
    inside: BoolArray = (
        (uv[..., 0] >= -0.5 + margin_px)
        & (uv[..., 0] <= camera.width - 0.5 - margin_px)
        & (uv[..., 1] >= -0.5 + margin_px)
        & (uv[..., 1] <= camera.height - 0.5 - margin_px)
    )
    return inside


def extent(uv: FloatArray, member: BoolArray) -> float:
    """Return the length of the members of a closed curve [px]."""
    pair = member & np.roll(member, -1)
    steps = np.linalg.norm(np.roll(uv, -1, axis=0) - uv, axis=-1)
    return float(steps[pair].sum())


def sun_in_frame(camera: CameraModel, truth: FrameTruth) -> bool:
    """Whether any visible part of the Sun's disc lies inside the image."""
    if truth.sun_visible_fraction <= 0:
        return False
    return disc_in_frame(camera, np.array(truth.sun_cam), truth.sun_angular_radius_rad, truth)


def moon_in_frame(camera: CameraModel, truth: FrameTruth) -> bool:
    """Whether any part of the Moon's disc, lit or not, lies inside the image."""
    if truth.moon_cam is None or truth.moon_visible_fraction <= 0:
        return False
    return disc_in_frame(camera, np.array(truth.moon_cam), truth.moon_angular_radius_rad, truth)


def disc_in_frame(camera: CameraModel, centre: FloatArray, radius_rad: float, truth: FrameTruth | None = None) -> bool:
    """Whether a disc's centre or any of 64 points of its rim lies inside the image and, by a truth, behind no part."""
    across = perpendicular(centre)
    angle = np.linspace(0, math.tau, 64, endpoint=False)[:, None]
    ring = np.cos(angle) * across + np.sin(angle) * np.cross(centre, across)
    disc = np.concatenate([centre[None, :], math.cos(radius_rad) * centre + math.sin(radius_rad) * ring])
    uv, _ = project(camera, disc)
    return bool((inside_image(camera, uv) if truth is None else seen_in_image(truth, camera, disc, uv)).any())


def usable_margin_px(camera: CameraModel) -> float:
    """Return the width of the image's rim in which no search can follow a limb to either side."""
    return limits.RIM_PX * min(1.0, min(camera.width, camera.height) / limits.RIM_FULL_AT_PX)


def _samples(camera: CameraModel) -> int:
    field = min(camera.width / camera.fx, camera.height / camera.fy)
    return int(min(max(_STEPS_ACROSS_FIELD * math.tau / field, _SAMPLES_MIN), _SAMPLES_MAX))
