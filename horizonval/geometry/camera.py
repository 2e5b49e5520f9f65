"""The camera as geometry: directions to pixels and back.

Camera axes: x right, y down, z along the boresight. Pixel ``(0, 0)`` is the *centre* of the upper left pixel, so the
image covers ``[-0.5, W - 0.5] x [-0.5, H - 0.5]``. Every projection maps a direction ``(X, Y, Z)`` to normalised
coordinates, and these to ``u = fx (x' + skew y') + cx, v = fy y' + cy``:

``pinhole``: ``x = X/Z, y = Y/Z``, then distortion (:mod:`horizonval.geometry.brown`).

``fisheye``: ``x' = theta_d cos(phi), y' = theta_d sin(phi)`` with ``theta_d`` a polynomial of the angle ``theta`` from
the boresight (:mod:`horizonval.spec.camera`) and ``phi = atan2(Y, X)``. Directions behind the camera have an
image too, as far as the polynomial grows.

``unified``: ``x = (1 + xi) X/D, y = (1 + xi) Y/D`` (:mod:`horizonval.spec.camera`), then distortion as of a pinhole.
With the factor ``1 + xi``, ``fx`` is in pixels per radian on the axis, as in every projection; files have ``1 + xi``
in ``fx``, and coefficients for coordinates without it (see :func:`camera_from_spec`).

``equal_angle`` is the geostationary fixed grid: the column is proportional to the scan angle ``atan2(X, Z)`` and the
row to the elevation out of the scan plane ``asin(Y)``, with ``fx``, ``fy`` in pixels per radian.

A lens may fill only an image circle. What lies beyond that angle from the boresight has no image, and pixels whose
centre lies beyond it see nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.geometry import brown, fisheye
from horizonval.spec.camera import (
    SHAPE,
    WIDE,
    CameraGeometry,
    Projection,
    image_radius,
    turning_angle,
    unified_radius,
    unified_turning_angle,
)

_POWERS = (2, 4, 1, 1, 6, 2, 4, 6, 1, 3, 1, 3)
"""Power of the normalised coordinates that each coefficient of a distortion is multiplied by."""


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics of one camera. Lengths in pixels; see the module text for the conventions.

    ``distortion``: ``k1 k2 p1 p2 k3`` of a pinhole or unified lens, or twelve with ``k4 k5 k6 s1 s2 s3 s4``;
    ``k1 k2 k3 k4 0`` of a fisheye. ``image_circle_rad``: half-angle of the field that the lens fills; None where it
    fills the image. ``skew``: of the pixel axes, over fx. ``shape``: ``xi alpha beta`` of a unified projection.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    projection: Projection = "pinhole"
    image_circle_rad: float | None = None
    skew: float = 0.0
    shape: tuple[float, float, float] = (0.0, 0.0, 1.0)

    @property
    def wide(self) -> bool:
        """Whether the lens may see 90 deg off the boresight and more, as fisheyes do."""
        return self.projection in WIDE

    @property
    def classic(self) -> bool:
        """Whether image size, fx, fy, cx, cy and five coefficients of a pinhole or fisheye say all of the lens."""
        return self.projection != "unified" and len(self.distortion) <= 5 and self.skew == 0.0


def camera_from_spec(spec: CameraGeometry) -> CameraModel:
    """Return the intrinsics of a camera file with every default filled in.

    The principal point defaults to the image centre ``((W - 1) / 2, (H - 1) / 2)`` and ``fy`` to ``fx``.
    """
    fx = spec.focal_px
    scale = 1.0 + spec.xi
    return CameraModel(
        width=spec.width,
        height=spec.height,
        fx=fx,
        fy=fx if spec.fy is None else spec.fy if scale == 1.0 else spec.fy / scale,
        cx=spec.cx if spec.cx is not None else (spec.width - 1) / 2,
        cy=spec.cy if spec.cy is not None else (spec.height - 1) / 2,
        distortion=_rescaled(spec.distortion, scale),
        projection=spec.projection,
        image_circle_rad=None if spec.image_circle_deg is None else math.radians(spec.image_circle_deg) / 2,
        skew=spec.skew,
        shape=spec.shape,
    )


def camera_table(camera: CameraModel) -> dict[str, Any]:
    """Return the table ``[camera]`` of a file that :func:`camera_from_spec` reads as this camera, without its name."""
    scale = 1.0 + camera.shape[0]
    numbers = {"fisheye": 4, "equal_angle": 0}.get(camera.projection, len(camera.distortion))
    table: dict[str, Any] = {
        "width": camera.width,
        "height": camera.height,
        "projection": camera.projection,
        "fx": float(camera.fx * scale),
        "fy": float(camera.fy * scale),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
        "distortion": [float(k) for k in _rescaled(camera.distortion, 1.0 / scale)[:numbers]],
    }
    if camera.skew:
        table["skew"] = float(camera.skew)
    if camera.projection == "unified":
        table |= dict(zip(SHAPE, camera.shape, strict=True))
    if camera.image_circle_rad is not None:
        table["image_circle_deg"] = math.degrees(2 * camera.image_circle_rad)
    return table


def _rescaled(distortion: Sequence[float], scale: float) -> tuple[float, ...]:
    """Return five coefficients, or twelve, for normalised coordinates that are ``scale`` times as large."""
    k = [*distortion, *[0.0] * (12 - len(distortion))]
    if scale != 1.0:
        k = [x / scale**power for x, power in zip(k, _POWERS, strict=True)]
    return tuple(k if any(k[5:]) else k[:5])


def project(camera: CameraModel, d_cam: ArrayLike) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the pixel coordinates of directions (..., 3) in camera axes, of any length.

    Returns
    -------
    uv : ndarray, shape (..., 2)
        Column and row; NaN where ``has_image`` is False. Not limited to the image.
    has_image : ndarray of bool, shape (...)
        Pinhole: in front of the camera and where the distortion is one to one (see :func:`check_invertible`). Fisheye:
        where its polynomial grows, also behind the camera, never straight behind. Unified: up to its turning angle,
        and where the distortion is one to one. Equal-angle: everywhere but for a zero vector. In all of them not
        beyond the image circle.
    """
    d = np.asarray(d_cam, float)
    with np.errstate(divide="ignore", invalid="ignore"):
        if camera.projection == "equal_angle":
            column = np.arctan2(d[..., 0], d[..., 2])
            row = np.arctan2(d[..., 1], np.hypot(d[..., 0], d[..., 2]))
            has_image = np.any(d != 0.0, axis=-1) & np.all(np.isfinite(d), axis=-1)
        elif camera.projection == "fisheye":
            k = camera.distortion[:4]
            across = np.hypot(d[..., 0], d[..., 1])
            theta = np.arctan2(across, d[..., 2])
            has_image = np.any(d != 0.0, axis=-1) & np.all(np.isfinite(d), axis=-1) & (theta < turning_angle(k))
            stretch = np.where(across > 0.0, image_radius(theta, k) / across, 0.0)
            column, row = stretch * d[..., 0], stretch * d[..., 1]
        else:
            if camera.projection == "unified":
                x, y, has_image = _unified_plane(camera.shape, d)
            else:
                x, y, has_image = d[..., 0] / d[..., 2], d[..., 1] / d[..., 2], d[..., 2] > 0.0
            has_image &= np.hypot(x, y) < brown.invertible_radius(camera.distortion)
            x, y = np.where(has_image, x, 0.0), np.where(has_image, y, 0.0)
            column, row = brown.distort(camera.distortion, x, y)
        if camera.image_circle_rad is not None:
            has_image &= _angle_to_axis(d) <= camera.image_circle_rad
    if camera.skew:
        column = column + camera.skew * row
    uv = np.stack([camera.fx * column + camera.cx, camera.fy * row + camera.cy], axis=-1)
    return np.where(has_image[..., None], uv, np.nan), has_image


def unproject(camera: CameraModel, uv: ArrayLike) -> FloatArray:
    """Return the unit directions, shape (..., 3), in camera axes, of pixel coordinates, shape (..., 2).

    The inverse of :func:`project` to 1e-12 of normalised coordinates. NaN where no direction has that image: beyond the
    image circle, where the distortion never reaches without folding, and equal-angle coordinates beyond half a turn in
    scan or a quarter in elevation. Call :func:`check_invertible` once to know that only the image circle makes them.
    """
    d = _through_lens(camera, *_normalised(camera, uv))
    if camera.image_circle_rad is None:
        return d
    return np.where((_angle_to_axis(d) <= camera.image_circle_rad)[..., None], d, np.nan)


def _normalised(camera: CameraModel, uv: ArrayLike) -> tuple[FloatArray, FloatArray]:
    pixels = np.asarray(uv, float)
    x, y = (pixels[..., 0] - camera.cx) / camera.fx, (pixels[..., 1] - camera.cy) / camera.fy
    return (x - camera.skew * y if camera.skew else x), y


def _unified_plane(
    shape: tuple[float, float, float], d: FloatArray
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the normalised coordinates of directions before distortion, and which directions have them."""
    xi, alpha, beta = shape
    length = np.linalg.norm(d, axis=-1)
    x, y, z = d[..., 0] / length, d[..., 1] / length, d[..., 2] / length
    w = xi + z
    stretch = (1.0 + xi) / (alpha * np.sqrt(beta * (x * x + y * y) + w * w) + (1.0 - alpha) * w)
    return stretch * x, stretch * y, _angle_to_axis(d) < unified_turning_angle(shape)


def _unified_direction(shape: tuple[float, float, float], x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the unit directions of normalised coordinates; NaN where there are none.

    The direction from the point that lies ``xi`` behind the unit sphere's centre is known from ``x`` and ``y``; where
    it leaves the sphere is the direction from the centre.
    """
    xi, alpha, beta = shape
    x, y = x / (1.0 + xi), y / (1.0 + xi)
    r2 = x * x + y * y
    with np.errstate(divide="ignore", invalid="ignore"):
        w = (1.0 - beta * alpha**2 * r2) / (alpha * np.sqrt(1.0 - (2.0 * alpha - 1.0) * beta * r2) + 1.0 - alpha)
        t = (w * xi + np.sqrt(w * w + (1.0 - xi * xi) * r2)) / (r2 + w * w)
        d = np.stack([t * x, t * y, t * w - xi], axis=-1)
        # The unit length is exact but for rounding; the first digits of a direction near the axis are in x and y.
        d /= np.linalg.norm(d, axis=-1, keepdims=True)
        good = _angle_to_axis(d) < unified_turning_angle(shape)
    return np.where(good[..., None], d, np.nan)


def _through_lens(camera: CameraModel, x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the directions of normalised coordinates, whether inside the image circle or not."""
    if camera.projection == "equal_angle":
        good = (np.abs(x) <= math.pi) & (np.abs(y) <= math.pi / 2)
        d = np.stack([np.cos(y) * np.sin(x), np.sin(y), np.cos(y) * np.cos(x)], axis=-1)
        return np.where(good[..., None], d, np.nan)
    if camera.projection == "fisheye":
        k = camera.distortion[:4]
        radius = np.hypot(x, y)
        theta = fisheye.off_axis(radius, k, turning_angle(k))
        stretch = np.divide(np.sin(theta), radius, out=np.ones_like(radius), where=radius > 0.0)
        return np.stack([stretch * x, stretch * y, np.cos(theta)], axis=-1)
    x, y = brown.undistort(camera.distortion, x, y)
    if camera.projection == "unified":
        return _unified_direction(camera.shape, x, y)
    d = np.stack([x, y, np.ones_like(x)], axis=-1)
    return np.asarray(d / np.sqrt(x * x + y * y + 1.0)[..., None])


def _angle_to_axis(d: FloatArray) -> FloatArray:
    return np.asarray(np.arctan2(np.hypot(d[..., 0], d[..., 1]), d[..., 2]))


def widest_angle(camera: CameraModel) -> float:
    """Return the angle from the boresight [rad] up to which a fisheye or a unified lens has an image of its own."""
    if camera.projection == "fisheye":
        return turning_angle(camera.distortion[:4])
    turning, limit = unified_turning_angle(camera.shape), brown.invertible_radius(camera.distortion)
    low, high = 0.0, turning
    if math.isinf(limit):
        return turning
    for _ in range(60):
        middle = 0.5 * (low + high)
        inside = (1.0 + camera.shape[0]) * unified_radius(middle, camera.shape) < limit
        low, high = (middle, high) if inside else (low, middle)
    return low


def check_invertible(camera: CameraModel, where: str = "") -> None:
    """Raise UserError if any point of the image, or of its image circle, has no or no single direction.

    The invertible disc and its image are simply connected, so the image lies inside where its border does; the border
    is checked at every half pixel. A wide lens that fills an image circle is checked at the circle. ``where`` is file
    and key for the message.
    """
    lens = f"the fisheye with distortion {list(camera.distortion[:4])}"
    if camera.projection == "unified":
        numbers = ", ".join(f"{key} = {value:g}" for key, value in zip(SHAPE, camera.shape, strict=True))
        lens = f"the unified lens with {numbers} and distortion {camera_table(camera)['distortion']}"
    if camera.wide and camera.image_circle_rad is not None:
        turning = widest_angle(camera)
        if camera.image_circle_rad > turning:
            raise UserError(
                f"{lens} folds back at {math.degrees(turning):.4g} deg "
                f"from the boresight, inside its image circle of {2 * math.degrees(camera.image_circle_rad):.4g} deg",
                where=where or "camera.image_circle_deg",
                expected="coefficients whose image grows up to the image circle",
            )
        return
    border = _border(camera)
    bad = ~np.isfinite(_through_lens(camera, *_normalised(camera, border))).all(axis=-1)
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
    if camera.wide:
        turning = widest_angle(camera)
        raise UserError(
            f"pixel {place} has no direction: {lens} ends {math.degrees(turning):.4g} deg from the boresight",
            where=where or "camera.distortion",
            expected="coefficients and a scale whose model is one to one over the image",
            fix="set camera.image_circle_deg if the lens does not fill the image; else check order, sign and scale",
        )
    raise UserError(
        f"distortion {list(camera.distortion)} folds inside the image: pixel {place} has no single direction",
        where=where or "camera.distortion",
        expected="coefficients whose model is one to one over the image",
        fix="check their order, sign and the focal length they were calibrated with, or crop the image",
    )


def _border(camera: CameraModel) -> FloatArray:
    u, v = np.arange(-0.5, camera.width, 0.5), np.arange(-0.5, camera.height, 0.5)
    return np.concatenate(
        [
            np.stack([u, np.full_like(u, -0.5)], axis=-1),
            np.stack([u, np.full_like(u, camera.height - 0.5)], axis=-1),
            np.stack([np.full_like(v, -0.5), v], axis=-1),
            np.stack([np.full_like(v, camera.width - 0.5), v], axis=-1),
        ]
    )


def pixel_grid(camera: CameraModel) -> FloatArray:
    """Return the column and row of every pixel centre, shape (H, W, 2)."""
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    return np.stack([u, v], axis=-1)


def in_image_circle(camera: CameraModel) -> NDArray[np.bool_]:
    """Return which pixels see anything, shape (H, W): those whose centre lies inside the image circle."""
    if camera.image_circle_rad is None:
        return np.ones((camera.height, camera.width), dtype=bool)
    return np.asarray(np.isfinite(unproject(camera, pixel_grid(camera))).all(axis=-1))


def pixel_solid_angle(camera: CameraModel) -> FloatArray:
    """Return the solid angle of every pixel [sr], shape (H, W), by the Jacobian at its centre; 0 beyond the circle.

    Pinhole: ``1 / (fx fy det J (1 + r^2)^1.5)``; fisheye: ``sin(theta) / (fx fy theta_d theta_d')``; equal-angle:
    ``cos(elevation) / (fx fy)``; unified: as the fisheye, over det J. Taking the centre for the pixel's mean neglects a
    relative ``O(pixel angle^2)``: 1e-6 for 0.1 deg pixels. NaN where there is no direction for another reason than the
    image circle.
    """
    x, y = _normalised(camera, pixel_grid(camera))
    if camera.projection == "equal_angle":
        good = (np.abs(x) <= math.pi) & (np.abs(y) <= math.pi / 2)
        solid_angle = np.where(good, np.cos(y), np.nan) / (camera.fx * camera.fy)
    elif camera.projection == "fisheye":
        k = camera.distortion[:4]
        theta = fisheye.off_axis(np.hypot(x, y), k, turning_angle(k))
        solid_angle = fisheye.solid_angle_per_area(theta, k) / (camera.fx * camera.fy)
    else:
        x, y = brown.undistort(camera.distortion, x, y)
        xx, xy, yx, yy = brown.jacobian(camera.distortion, x, y)
        plain = (1.0 + x * x + y * y) ** -1.5 if camera.projection == "pinhole" else _unified_area(camera.shape, x, y)
        solid_angle = plain / ((xx * yy - xy * yx) * camera.fx * camera.fy)
    return solid_angle if camera.image_circle_rad is None else np.where(in_image_circle(camera), solid_angle, 0.0)


def _unified_area(shape: tuple[float, float, float], x: FloatArray, y: FloatArray) -> FloatArray:
    """Return ``dOmega / (dx dy)`` of normalised coordinates before distortion: ``sin(theta) / (r dr/dtheta)``."""
    xi, alpha, beta = shape
    theta = _angle_to_axis(_unified_direction(shape, x, y))
    s, w = np.sin(theta), xi + np.cos(theta)
    root = np.sqrt(beta * s * s + w * w)
    d = alpha * root + (1.0 - alpha) * w
    slope = alpha * s * (beta * np.cos(theta) - w) / root - (1.0 - alpha) * s
    # r = (1 + xi) s / d
    return np.asarray(d**3 / ((1.0 + xi) ** 2 * (np.cos(theta) * d - s * slope)))


def field_angles(camera: CameraModel) -> FloatArray:
    """Return the angle between every pixel's direction and the boresight [rad], shape (H, W).

    Pi for pixels beyond the image circle: they look where no light comes from.
    """
    angle = _angle_to_axis(unproject(camera, pixel_grid(camera)))
    return angle if camera.image_circle_rad is None else np.where(in_image_circle(camera), angle, math.pi)
