"""The camera as geometry: directions to pixels and back.

Camera axes: x right, y down, z along the boresight. Pixel ``(0, 0)`` is the *centre* of the upper left pixel, so the
image covers ``[-0.5, W - 0.5] x [-0.5, H - 0.5]``.

Pinhole with Brown-Conrady distortion (coefficients ``k1 k2 p1 p2 k3`` with OpenCV's meaning and order), with
``x = X/Z, y = Y/Z, r2 = x^2 + y^2``::

    x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) + 2 p1 x y + p2 (r2 + 2 x^2)
    y' = y (1 + k1 r2 + k2 r2^2 + k3 r2^3) + p1 (r2 + 2 y^2) + 2 p2 x y
    u = fx x' + cx,   v = fy y' + cy

Brown-Conrady is the gradient of a potential, so its Jacobian is symmetric; where that is positive definite the model is
one to one. Directions and pixels beyond the largest such disc are refused (mask or NaN), never guessed: there the
polynomial folds back over the image.

``equal_angle`` is the geostationary fixed grid: the column is proportional to the scan angle ``atan2(X, Z)`` and the
row to the elevation out of the scan plane ``asin(Y)``, with ``fx``, ``fy`` in pixels per radian.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar

from horizonval.errors import UserError
from horizonval.spec.camera import CameraGeometry

FloatArray = NDArray[np.float64]
Projection = Literal["pinhole", "equal_angle"]


@dataclass(frozen=True)
class Camera:
    """Intrinsics of one camera. Lengths in pixels; see the module text for the conventions."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    projection: Projection = "pinhole"


def camera_from_spec(spec: CameraGeometry) -> Camera:
    """Return the intrinsics of a camera file with every default filled in.

    ``fov_deg`` spans the outer edges of the first and last column; the principal point defaults to the image centre
    ``((W - 1) / 2, (H - 1) / 2)`` and ``fy`` to ``fx``.
    """
    if spec.fx is not None:
        fx = spec.fx
    else:
        assert spec.fov_deg is not None
        half = math.radians(spec.fov_deg) / 2
        fx = spec.width / 2 / (math.tan(half) if spec.projection == "pinhole" else half)
    k = [*spec.distortion, 0.0, 0.0, 0.0, 0.0, 0.0][:5]
    return Camera(
        width=spec.width,
        height=spec.height,
        fx=fx,
        fy=spec.fy if spec.fy is not None else fx,
        cx=spec.cx if spec.cx is not None else (spec.width - 1) / 2,
        cy=spec.cy if spec.cy is not None else (spec.height - 1) / 2,
        distortion=(k[0], k[1], k[2], k[3], k[4]),
        projection=spec.projection,
    )


def _distort(camera: Camera, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def _jacobian(camera: Camera, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``dx'/dx``, ``dx'/dy = dy'/dx`` and ``dy'/dy``: Brown-Conrady is a gradient, its Jacobian symmetric."""
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2.0 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    xy = slope * x * y + 2 * p1 * x + 2 * p2 * y
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    return xx, xy, yy


@lru_cache(maxsize=256)
def _invertible_radius(distortion: tuple[float, float, float, float, float]) -> float:
    """Return the largest ``r`` such that the Jacobian is positive definite on the open disc ``sqrt(x^2 + y^2) < r``.

    A gradient map whose Jacobian is positive definite on a convex set is one to one there (strict convexity of its
    potential), so this disc can be undistorted without ambiguity. On a ray at angle ``t`` the determinant is a
    polynomial in ``r``; its first positive zero is found for 720 angles and bettered by golden section around the
    smallest. Infinite without distortion.
    """
    if not any(distortion):
        return math.inf
    k1, k2, p1, p2, k3 = distortion

    def first_zero(angle: float) -> float:
        c, s = math.cos(angle), math.sin(angle)
        xx = np.array(
            [k3 * (1 + 6 * c * c), 0, k2 * (1 + 4 * c * c), 0, k1 * (1 + 2 * c * c), 2 * p1 * s + 6 * p2 * c, 1]
        )
        yy = np.array(
            [k3 * (1 + 6 * s * s), 0, k2 * (1 + 4 * s * s), 0, k1 * (1 + 2 * s * s), 6 * p1 * s + 2 * p2 * c, 1]
        )
        xy = np.array([6 * k3 * c * s, 0, 4 * k2 * c * s, 0, 2 * k1 * c * s, 2 * p1 * c + 2 * p2 * s, 0])
        roots = np.roots(np.polysub(np.polymul(xx, yy), np.polymul(xy, xy)))
        real = roots.real[(np.abs(roots.imag) < 1e-6 * np.abs(roots)) & (roots.real > 0)]
        return float(real.min()) if real.size else math.inf

    step = math.pi / 360
    angles = step * np.arange(720)
    radii = [first_zero(float(t)) for t in angles]
    best = float(angles[int(np.argmin(radii))])
    smallest = min(radii)
    if math.isfinite(smallest):
        found = minimize_scalar(first_zero, bounds=(best - step, best + step), method="bounded")
        smallest = min(smallest, float(found.fun))
    # A double zero of the determinant can hide as a slightly complex pair; the margin keeps to the safe side of it.
    return smallest * (1.0 - 1e-9)


def _undistort(camera: Camera, xd: FloatArray, yd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the undistorted coordinates; NaN where no point of the invertible disc is distorted to ``(xd, yd)``."""
    if not any(camera.distortion):
        return xd, yd
    limit = _invertible_radius(camera.distortion)
    k1, k2, _, _, k3 = camera.distortion
    rd = np.hypot(xd, yd)
    # The radial part alone, inverted by a table, is the start: inside the disc and close to the answer.
    largest = float(rd.max(initial=0.0, where=np.isfinite(rd)))
    grid = np.linspace(0.0, min(limit, 4.0 * largest + 1.0), 1025)
    table = np.maximum.accumulate(grid * (1 + grid**2 * (k1 + grid**2 * (k2 + grid**2 * k3))))
    start = np.interp(rd, table, grid)
    factor = np.divide(start, rd, out=np.ones_like(rd), where=rd > 0)
    x, y = xd * factor, yd * factor

    def residual(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        fx, fy = _distort(camera, x, y)
        return fx - xd, fy - yd, np.hypot(fx - xd, fy - yd)

    ex, ey, size = residual(x, y)
    damping = np.ones_like(size)
    for _ in range(80):
        xx, xy, yy = _jacobian(camera, x, y)
        det = xx * yy - xy * xy
        with np.errstate(divide="ignore", invalid="ignore"):
            dx, dy = (yy * ex - xy * ey) / det, (xx * ey - xy * ex) / det
            nx, ny = x - damping * dx, y - damping * dy
            nex, ney, new_size = residual(nx, ny)
            better = (new_size < size) & (np.hypot(nx, ny) <= limit)
        x, y = np.where(better, nx, x), np.where(better, ny, y)
        ex, ey, size = np.where(better, nex, ex), np.where(better, ney, ey), np.where(better, new_size, size)
        damping = np.where(better, np.minimum(1.0, 2 * damping), damping / 2)
        # Rounding leaves 1e-16; a point that no longer gains below 1e-13 is there, one stuck above it has no inverse.
        if not np.any((damping > 1e-6) & ((size > 1e-13) | (better & (size > 4e-16)))):
            break
    good = (size <= 1e-12 * (1 + rd)) & (np.hypot(x, y) < limit)
    return np.where(good, x, np.nan), np.where(good, y, np.nan)


def project(camera: Camera, d_cam: ArrayLike) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the pixel coordinates of directions.

    Parameters
    ----------
    camera : Camera
    d_cam : array_like, shape (..., 3)
        Directions in camera axes, of any length.

    Returns
    -------
    uv : ndarray, shape (..., 2)
        Column and row; NaN where ``in_front`` is False. Not limited to the image.
    in_front : ndarray of bool, shape (...)
        Whether the direction has an image. Pinhole: in front of the camera and where the distortion is one to one
        (see :func:`check_invertible`); beyond that a polynomial folds back and would put far directions into the
        image. Equal-angle: everywhere but for a zero vector.
    """
    d = np.asarray(d_cam, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        if camera.projection == "equal_angle":
            column = np.arctan2(d[..., 0], d[..., 2])
            row = np.arctan2(d[..., 1], np.hypot(d[..., 0], d[..., 2]))
            in_front = np.any(d != 0.0, axis=-1) & np.all(np.isfinite(d), axis=-1)
        else:
            x, y = d[..., 0] / d[..., 2], d[..., 1] / d[..., 2]
            in_front = (d[..., 2] > 0.0) & (np.hypot(x, y) < _invertible_radius(camera.distortion))
            x, y = np.where(in_front, x, 0.0), np.where(in_front, y, 0.0)
            column, row = _distort(camera, x, y)
    uv = np.stack([camera.fx * column + camera.cx, camera.fy * row + camera.cy], axis=-1)
    return np.where(in_front[..., None], uv, np.nan), in_front


def unproject(camera: Camera, uv: ArrayLike) -> FloatArray:
    """Return the unit directions, shape (..., 3), in camera axes, of pixel coordinates, shape (..., 2).

    The inverse of :func:`project` to 1e-12 of normalised coordinates. NaN where no direction has that image: pixels
    that the distortion never reaches without folding, and equal-angle coordinates beyond half a turn in scan or a
    quarter in elevation. Call :func:`check_invertible` once to know that the whole image is free of them.
    """
    pixels = np.asarray(uv, float)
    x, y = (pixels[..., 0] - camera.cx) / camera.fx, (pixels[..., 1] - camera.cy) / camera.fy
    if camera.projection == "equal_angle":
        good = (np.abs(x) <= math.pi) & (np.abs(y) <= math.pi / 2)
        d = np.stack([np.cos(y) * np.sin(x), np.sin(y), np.cos(y) * np.cos(x)], axis=-1)
        return np.where(good[..., None], d, np.nan)
    x, y = _undistort(camera, x, y)
    d = np.stack([x, y, np.ones_like(x)], axis=-1)
    return d / np.sqrt(x * x + y * y + 1.0)[..., None]


def check_invertible(camera: Camera, where: str = "") -> None:
    """Raise if any place in the image has no, or no single, direction.

    The invertible disc and its image are simply connected, so the image lies inside where its border does; the border
    is checked at every half pixel.

    Parameters
    ----------
    camera : Camera
    where : str
        File and key for the message.

    Raises
    ------
    UserError
        If the distortion folds inside the image, or an equal-angle image exceeds the sphere.
    """
    u, v = np.arange(-0.5, camera.width, 0.5), np.arange(-0.5, camera.height, 0.5)
    border = np.concatenate(
        [
            np.stack([u, np.full_like(u, -0.5)], axis=-1),
            np.stack([u, np.full_like(u, camera.height - 0.5)], axis=-1),
            np.stack([np.full_like(v, -0.5), v], axis=-1),
            np.stack([np.full_like(v, camera.width - 0.5), v], axis=-1),
        ]
    )
    bad = ~np.isfinite(unproject(camera, border)).all(axis=-1)
    if not bad.any():
        return
    place = f"({border[bad][0, 0]:g}, {border[bad][0, 1]:g})"
    if camera.projection == "equal_angle":
        raise UserError(
            f"the equal-angle image reaches past the whole sphere at pixel {place}",
            where=where or "camera",
            expected="at most 360 deg of scan and 180 deg of elevation",
            fix="check fx and fy (pixels per radian) or fov_deg",
        )
    raise UserError(
        f"distortion {list(camera.distortion)} folds inside the image: pixel {place} has no single direction",
        where=where or "camera.distortion",
        expected="coefficients k1 k2 p1 p2 k3 whose model is one to one over the image",
        fix="check their order, sign and the focal length they were calibrated with, or crop the image",
    )


def pixel_grid(camera: Camera) -> FloatArray:
    """Return the column and row of every pixel centre, shape (H, W, 2)."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    return np.stack([u, v], axis=-1)


def pixel_solid_angle(camera: Camera) -> FloatArray:
    """Return the solid angle of every pixel [sr], shape (H, W), by the Jacobian at its centre.

    Pinhole: ``1 / (fx fy det J (1 + r^2)^1.5)``; equal-angle: ``cos(elevation) / (fx fy)``. Taking the centre for the
    pixel's mean neglects a relative ``O(pixel angle^2)``: 1e-6 for 0.1 deg pixels. NaN where there is no direction.
    """
    pixels = pixel_grid(camera)
    x, y = (pixels[..., 0] - camera.cx) / camera.fx, (pixels[..., 1] - camera.cy) / camera.fy
    if camera.projection == "equal_angle":
        good = (np.abs(x) <= math.pi) & (np.abs(y) <= math.pi / 2)
        return np.where(good, np.cos(y), np.nan) / (camera.fx * camera.fy)
    x, y = _undistort(camera, x, y)
    xx, xy, yy = _jacobian(camera, x, y)
    return (1.0 + x * x + y * y) ** -1.5 / ((xx * yy - xy * xy) * camera.fx * camera.fy)


def off_axis_angle(camera: Camera) -> FloatArray:
    """Return the angle between every pixel's direction and the boresight [rad], shape (H, W)."""
    d = unproject(camera, pixel_grid(camera))
    return np.arctan2(np.hypot(d[..., 0], d[..., 1]), d[..., 2])
