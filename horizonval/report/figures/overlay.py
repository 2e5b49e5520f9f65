"""Curves over an image as SVG path data in pixel coordinates: the true horizon, hard and infrared, the fitted limb,
the limb points.

The fitted limb is the cone of half angle ``rho`` about the fitted nadir, sent through the camera::

    d(t) = cos(rho) n + sin(rho) (e1 cos t + e2 sin t)
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from horizonval.core.arrays import FloatArray
from horizonval.frame import FrameTruth
from horizonval.geometry.camera import CameraModel, project
from horizonval.geometry.horizon import horizon_pixels
from horizonval.geometry.rotation import perpendicular
from horizonval.truth.infrared_horizon import curve_cam

_CONE_SAMPLES = 40_000
_POINTS_PER_LINE = 160
"""Vertices of a drawn line: a horizon bends by less than 0.1 px between them in a 1000 px image."""


def horizon_path(truth: FrameTruth) -> str:
    """Return the exact horizon inside the image, refracted where light is bent; empty if there is none."""
    ellipsoid = truth.apparent_ellipsoid
    lines = horizon_pixels(truth.camera_model, truth.q_cam_from_itrs, truth.r_itrs, ellipsoid, _POINTS_PER_LINE)
    return "".join(_line(line) for line in lines)


def limb_path(camera: CameraModel, nadir_cam: ArrayLike, angular_radius_rad: float) -> str:
    """Return the fitted limb inside the image; empty if it does not cross it."""
    n = np.asarray(nadir_cam, dtype=np.float64)
    n = n / np.linalg.norm(n)
    first = perpendicular(n)
    t = np.linspace(0, math.tau, _CONE_SAMPLES + 1)[:, None]
    ring = np.cos(t) * first + np.sin(t) * np.cross(n, first)
    return visible_path(camera, math.cos(angular_radius_rad) * n + math.sin(angular_radius_rad) * ring)


def infrared_path(truth: FrameTruth, band: str) -> str:
    """Return the infrared horizon (half plateau) of a band inside the image; empty if there is none."""
    if band not in truth.infrared_horizon:
        return ""
    d_cam, _ = curve_cam(truth, band, _CONE_SAMPLES)
    return visible_path(truth.camera_model, np.concatenate([d_cam, d_cam[:1]]))


def visible_path(camera: CameraModel, d_cam: FloatArray) -> str:
    """Return the parts inside the image of a curve given by close directions."""
    uv, _ = project(camera, d_cam)
    inside = (
        np.abs(uv - [(camera.width - 1) / 2, (camera.height - 1) / 2]) <= [camera.width / 2, camera.height / 2]
    ).all(axis=-1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(np.int8)))
    path = ""
    for start, stop in edges.reshape(-1, 2):
        run = uv[start:stop]
        if len(run) > 1:
            keep = np.unique(np.linspace(0, len(run) - 1, _POINTS_PER_LINE).round().astype(int))
            path += _line(run[keep])
    return path


def points_path(points: ArrayLike) -> str:
    """Return limb points as zero-length strokes, which round line caps turn into dots."""
    uv = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    return "".join(f"M{_coordinate(u)} {_coordinate(v)}h0" for u, v in uv[np.isfinite(uv).all(axis=1)])


def _line(uv: FloatArray) -> str:
    return "M" + "L".join(f"{_coordinate(u)} {_coordinate(v)}" for u, v in uv)


def _coordinate(value: float) -> str:
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
