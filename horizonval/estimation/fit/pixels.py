"""The pixels near a limb: their selection, and the distance of each line of sight from the limb.

**Distance from the limb of an ellipsoid, with exact derivatives.** Divided by the semi-axes ``s = (a + h, a + h, b +
h)`` the ellipsoid, raised by the height ``h`` of the limb, is the unit sphere, the observer is at ``p = r / s`` and a
line of sight runs along ``e ~ d / s``. With ``n = -p / |p|``::

    delta = asin(1 / |p|) - angle(e, n)

is positive inside the limb and zero on it. For a sphere it is the angle from the limb; for the Earth it differs by the
flattening times itself, and a true distance is ``delta`` over its gradient. With ``t`` the unit vector from ``e``
towards ``n``, ``q`` the one from ``n`` towards ``e``, and ``k = sqrt(|p|^2 - 1)``::

    d delta / d d = t / (|d / s| s)                       by the line of sight (it has no part along d)
    d delta / d p = (n / k - q) / |p|                     by the scaled position

A rotation of the camera by the small vector ``theta`` in camera axes turns lines of sight by ``-theta``; ``h`` changes
``s`` and so both ``p`` and ``d / s``. The raised ellipsoid differs from the surface at height ``h`` by less than ``h
f^2 / 2``, 0.2 m at 40 km.

**Selection.** Squares of 8 x 8 pixels are tested by their centres, and only those near the limb are tested pixel by
pixel. A distance in the image is an angle over its gradient by column and row at the pixel. A blur of variance ``s^2``
moves the image of a bent limb by ``s^2 / 2`` times the divergence of the distance's gradient: 5e-4 px on a disc of 1000
px. It changes slowly along the limb and is evaluated at some positions only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.limb.picture import pixel_directions
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.rotation import cross


@dataclass(frozen=True)
class LimbAngle:
    """Angle inside the limb, of n lines of sight, and its derivatives, each computed when it is first needed.

    ``delta``: shape (n,) [rad], positive inside. Of the symbols above, shape (3, n): ``los`` the lines of sight in
    camera axes, ``scaled`` = ``d / s``, ``t``, ``q``; ``length``: shape (n,), of ``d / s``; ``p``, ``n``, ``axes``:
    shape (3,); ``axes_cam``: shape (3, 3), the scaling and turn of camera axes.
    """

    delta: FloatArray
    los: FloatArray
    scaled: FloatArray
    length: FloatArray
    t: FloatArray
    q: FloatArray
    p: FloatArray
    axes_cam: FloatArray
    axes: FloatArray

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> LimbAngle:
        """Return those of some lines of sight."""
        rows = self.delta, self.los, self.scaled, self.length, self.t, self.q
        delta, los, scaled, length, t, q = (one[..., which] for one in rows)
        return LimbAngle(delta, los, scaled, length, t, q, self.p, self.axes_cam, self.axes)

    @cached_property
    def by_direction(self) -> FloatArray:
        """Derivative by the line of sight in camera axes, shape (3, n)."""
        return self.axes_cam @ (self.t / self.length)

    @cached_property
    def by_rotation(self) -> FloatArray:
        """Derivative by the turn ``theta`` in camera axes, ``exp([theta x]) cam_from_itrs``, shape (3, n)."""
        return np.array(cross(self.by_direction, self.los))

    @cached_property
    def by_position(self) -> FloatArray:
        """Derivative by the Earth-fixed position [rad/m], shape (3, n)."""
        return self._by_scaled / self.axes[:, None]

    @cached_property
    def by_height(self) -> FloatArray:
        """Derivative by the limb's height [rad/m], shape (n,)."""
        along = np.einsum("ij,ij->j", self.scaled / self.axes[:, None], self.t) / self.length
        return -((self.p / self.axes) @ self._by_scaled) - along

    @cached_property
    def _by_scaled(self) -> FloatArray:
        size_2 = float(self.p @ self.p)
        outwards = -self.p / (size_2 * np.sqrt(size_2 - 1.0))
        return np.asarray(outwards[:, None] - self.q / np.sqrt(size_2))


def limb_angle(los_cam: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray) -> LimbAngle:
    """Return how far inside the limb lines of sight pass.

    ``los_cam``: shape (3, n), unit vectors; ``cam_from_itrs``: shape (3, 3); ``r_itrs``: shape (3,), observer [m];
    ``axes_m``: shape (3,), semi-axes including the limb's height. Raises ``LinAlgError``: observer on or below the
    limb.
    """
    p = r_itrs / axes_m
    size = float(np.sqrt(p @ p))
    if not size > 1.0:
        raise np.linalg.LinAlgError("the position lies below the limb")
    n = -p[:, None] / size
    axes_cam = cam_from_itrs / axes_m
    scaled = axes_cam.T @ los_cam
    length = np.sqrt(np.einsum("ij,ij->j", scaled, scaled))
    e = scaled / length
    cosine = n[:, 0] @ e
    t = n - cosine * e
    sine = np.maximum(np.sqrt(np.einsum("ij,ij->j", t, t)), 1e-300)
    t /= sine
    delta = np.arctan2(1.0, np.sqrt((size - 1.0) * (size + 1.0))) - np.arctan2(sine, cosine)
    return LimbAngle(delta, los_cam, scaled, length, t, (e - cosine * n) / sine, p, axes_cam, axes_m)


SQUARE_PX = 8
"""Side of the squares that the search for near pixels starts with."""
REACH_PX = SQUARE_PX / np.sqrt(2.0) + 2.0
"""Half a square's diagonal, plus the effect of the lens's changing scale up to the limb."""
OBLIQUE = 0.382
"""Relative offset between lines of thinned pixels: the golden section's smaller part, the most even."""


@dataclass(frozen=True)
class NearPixels:
    """n pixels near the limb: unit lines of sight ``los_cam``, and their change over one pixel, shape (3, n) each.

    ``every``: number of pixels of the image of which each is one, where they are thinned out.
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    los_cam: FloatArray
    by_column: FloatArray
    by_row: FloatArray
    every: int = 1

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> NearPixels:
        """Return some of them, by their numbers or by a mask."""
        return NearPixels(
            self.columns[which],
            self.rows[which],
            self.los_cam[:, which],
            self.by_column[:, which],
            self.by_row[:, which],
            self.every,
        )

    def seen_by(self, camera: CameraModel) -> NearPixels:
        """Return the same pixels with the lines of sight of another camera."""
        return _of_camera(pixel_directions(camera), self.columns, self.rows)


def _of_camera(directions: FloatArray, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> NearPixels:
    """Return pixels by their numbers, of a camera's directions, shape (H, W, 3)."""
    height, width = directions.shape[:2]
    right, left = np.minimum(columns + 1, width - 1), np.maximum(columns - 1, 0)
    below, above = np.minimum(rows + 1, height - 1), np.maximum(rows - 1, 0)
    return NearPixels(
        columns,
        rows,
        np.ascontiguousarray(directions[rows, columns].T),
        ((directions[rows, right] - directions[rows, left]) / np.maximum(right - left, 1)[:, None]).T.copy(),
        ((directions[below, columns] - directions[above, columns]) / np.maximum(below - above, 1)[:, None]).T.copy(),
    )


def pixel_at_limb_m(camera: CameraModel, r_itrs: FloatArray, radius_m: float) -> float:
    """Return what a pixel on the axis sees at the distance of the limb."""
    to_limb_2 = float(r_itrs @ r_itrs) - radius_m**2
    return float(np.sqrt(max(to_limb_2, 0.0))) / max(camera.fx, camera.fy)


def image_scale(angle: LimbAngle, by_column: FloatArray, by_row: FloatArray) -> FloatArray:
    """Return how fast the angle from the limb grows across it in the image [rad/px], shape (n,)."""
    return np.hypot(*gradient(angle, by_column, by_row))


def near_pixels(
    camera: CameraModel,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    axes_m: FloatArray,
    outside_px: float,
    inside_px: float,
    most: int | None = None,
) -> NearPixels:
    """Return the pixels within a distance of the limb, except where they or a neighbour have no direction.

    In an image of one row, distances are along the row. ``outside_px``, ``inside_px``: distances towards space and
    towards the Earth; ``most``: thin out evenly to one to two times so many squares of pixels; others as for
    :func:`limb_angle`.
    """
    directions = pixel_directions(camera)
    limb = cam_from_itrs, r_itrs, axes_m
    columns, rows, scale, every = _squares(camera, *limb, outside_px + REACH_PX, inside_px + REACH_PX, most)
    with np.errstate(invalid="ignore"):
        x = limb_angle(directions[rows, columns].T, *limb).delta / scale
        near = np.flatnonzero((x >= -outside_px) & (x <= inside_px))
    pixels = replace(_of_camera(directions, columns[near], rows[near]), every=every)
    # A neighbour outside the image circle has no direction.
    whole = np.isfinite(pixels.by_column.sum(axis=0) + pixels.by_row.sum(axis=0))
    return pixels if whole.all() else pixels.take(whole)


def in_view(
    camera: CameraModel, pixels: NearPixels, angle: LimbAngle, across_px: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return pixels, shape (n,), with the limb beside them in view from ``across_px[0]`` (outside, < 0) to ``[1]``."""
    by_column, by_row = gradient(angle, pixels.by_column, pixels.by_row)
    size = np.hypot(by_column, by_row)
    seen = np.ones(len(size), dtype=bool)
    for end in across_px:
        way = (end - angle.delta / size) / size
        column, row = pixels.columns + way * by_column, pixels.rows + way * by_row
        seen &= (column >= -0.5) & (column <= camera.width - 0.5) & (row >= -0.5) & (row <= camera.height - 0.5)
    return seen


def _squares(
    camera: CameraModel,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    axes_m: FloatArray,
    outside_px: float,
    inside_px: float,
    most: int | None,
) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, int]:
    """Return columns, rows and image scale [rad/px] of the pixels of all squares whose middle is near the limb.

    Of more than ``most`` pixels there is one in a number, which is the last that is returned.
    """
    directions = pixel_directions(camera)
    height, width = directions.shape[:2]
    middle, before = SQUARE_PX // 2, SQUARE_PX // 2 - 1
    column = np.minimum(np.arange(0, width, SQUARE_PX) + middle, width - 1)
    row = np.minimum(np.arange(0, height, SQUARE_PX) + middle, height - 1)
    centre = directions[row[:, None], column[None, :]].reshape(-1, 3).T
    right = directions[row[:, None], np.maximum(column - before, 0)[None, :]].reshape(-1, 3).T
    below = directions[np.maximum(row - before, 0)[:, None], column[None, :]].reshape(-1, 3).T
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = limb_angle(np.ascontiguousarray(centre), cam_from_itrs, r_itrs, axes_m)
        scale = image_scale(angle, (centre - right) / before, (centre - below) / before)
        far = angle.delta / scale
        # A square whose centre sees nothing may still hold pixels at the edge of the image circle.
        some = np.flatnonzero(~((far > inside_px) | (far < -outside_px)))
    scale = np.nan_to_num(scale[some], nan=1.0 / max(camera.fx, camera.fy))
    # The same pixels for every pose near by: of all by a power of two, on oblique lines through the image.
    pixels = len(some) * SQUARE_PX**2
    every = 1 if most is None or pixels <= most else 1 << int(np.log2(pixels / most))
    # Odd, so that no column stays empty.
    line = round(OBLIQUE * every) | 1
    in_row, in_column = np.divmod(np.arange(SQUARE_PX**2), SQUARE_PX)
    chosen = (in_column + in_row * line) % min(every, SQUARE_PX) == 0
    rows, columns = (
        (corner[:, None] * SQUARE_PX + offset[chosen]).ravel()
        for corner, offset in zip(np.divmod(some, len(column)), (in_row, in_column), strict=True)
    )
    scale = scale.repeat(np.count_nonzero(chosen))
    chosen = (columns < width) & (rows < height) & ((columns + rows * line) % every == 0)
    return columns[chosen], rows[chosen], scale[chosen], every


def limb_bend(
    camera: CameraModel, uv: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray
) -> FloatArray:
    """Return the divergence of the gradient of the distance inside the limb [1/px], ``-1 / radius`` inside a disc.

    ``uv``: shape (n, 2), (column, row) [px]; others as for :func:`limb_angle`. NaN where a neighbour has no direction.
    """

    steps = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    middle = uv + steps[:, None]
    around = middle + np.concatenate([np.zeros((1, 2)), steps])[:, None, None]
    los, right, left, below, above = np.moveaxis(unproject(camera, around).reshape(5, -1, 3), -1, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = limb_angle(np.ascontiguousarray(los), cam_from_itrs, r_itrs, axes_m)
        by_column, by_row = gradient(angle, right - left, below - above)
        size = np.hypot(by_column, by_row)
        (to_right, to_left, _, _), (_, _, to_below, to_above) = np.array([by_column / size, by_row / size]).reshape(
            2, 4, -1
        )
        return np.asarray(to_right - to_left + to_below - to_above)


def gradient(angle: LimbAngle, by_column: FloatArray, by_row: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the change of the angle inside the limb by column and by row [rad/px], shape (n,) each."""
    return (
        np.einsum("ij,ij->j", angle.by_direction, by_column),
        np.einsum("ij,ij->j", angle.by_direction, by_row),
    )
