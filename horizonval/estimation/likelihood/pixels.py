r"""The pixels near a limb that is known roughly: where they look, and how an angle there becomes pixels.

Of a megapixel a limb needs some ten thousand pixels. Squares of 8 x 8 pixels are looked at first, by their centres,
and only those that the limb may come near are taken apart.

A distance in the image is an angle over its gradient by column and row, taken at the pixel itself. A blur of variance
``s^2`` moves the image of a bent limb by ``s^2 / 2`` times its bend, the divergence of the distance's gradient: by
5e-4 px on a disc of 1000 px. It changes so slowly along the limb that some places stand for all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.limb_angle import LimbAngle, limb_angle
from horizonval.estimation.limb.pixel_directions import PIXEL_DIRECTIONS
from horizonval.geometry.camera import CameraModel, unproject

SQUARE_PX = 8
"""Side of the squares that the search for near pixels starts with."""
REACH_PX = SQUARE_PX / np.sqrt(2.0) + 2.0
"""From the centre of a square to its corner, and what a lens's changing scale may add on the way to the limb."""
OBLIQUE = 0.382
"""Of the lines on which thinned pixels stand, in their distance: the golden section's smaller part, the most even."""


@dataclass(frozen=True)
class NearPixels:
    """Pixels near the limb, n of them.

    Attributes
    ----------
    columns, rows : ndarray of int, shape (n,)
    los_cam : ndarray, shape (3, n)
        Unit lines of sight.
    by_column, by_row : ndarray, shape (3, n)
        Their change over one pixel.
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    los_cam: FloatArray
    by_column: FloatArray
    by_row: FloatArray

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> NearPixels:
        """Return some of them, by their numbers or by a mask."""
        return NearPixels(
            self.columns[which],
            self.rows[which],
            self.los_cam[:, which],
            self.by_column[:, which],
            self.by_row[:, which],
        )

    def seen_by(self, camera: CameraModel) -> NearPixels:
        """Return the same pixels with the lines of sight of another camera."""
        return _of_camera(PIXEL_DIRECTIONS.of(camera), self.columns, self.rows)


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
    return np.hypot(*_gradient(angle, by_column, by_row))


def near_pixels(
    camera: CameraModel,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    axes_m: FloatArray,
    outside_px: float,
    inside_px: float,
    most: int | None = None,
) -> NearPixels:
    """Return the pixels within a distance of the limb; those that see nothing, or have such neighbours, are left out.

    An image of one row has no change from row to row: a distance in it is one along the row.

    Parameters
    ----------
    camera : CameraModel
    cam_from_itrs, r_itrs, axes_m : ndarray
        As for :func:`.limb_angle.limb_angle`.
    outside_px, inside_px : float
        How far from the limb pixels are taken, towards space and towards the Earth.
    most : int, optional
        One to two times so many squares' pixels, evenly spread, where there are more.
    """
    directions = PIXEL_DIRECTIONS.of(camera)
    columns, rows = _squares(directions, cam_from_itrs, r_itrs, axes_m, outside_px + REACH_PX, inside_px + REACH_PX)
    if most is not None and len(columns) > most:
        # The same pixels for every pose near by: of all by a power of two, on oblique lines through the image.
        every = 1 << int(np.log2(len(columns) / most))
        chosen = (columns + rows * round(OBLIQUE * every)) % every == 0
        columns, rows = columns[chosen], rows[chosen]
    pixels = _of_camera(directions, columns, rows)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = limb_angle(pixels.los_cam, cam_from_itrs, r_itrs, axes_m)
        x = angle.delta / image_scale(angle, pixels.by_column, pixels.by_row)
        return pixels.take((x >= -outside_px) & (x <= inside_px))


def in_view(
    camera: CameraModel, pixels: NearPixels, angle: LimbAngle, across_px: tuple[float, float]
) -> NDArray[np.bool_]:
    """Return beside which pixels the limb lies in the picture, with what is so far from it across, shape (n,).

    Parameters
    ----------
    camera : CameraModel
    pixels : NearPixels
    angle : LimbAngle
        Of the pixels.
    across_px : tuple of two floats
        Outside (negative) and inside.
    """
    by_column, by_row = _gradient(angle, pixels.by_column, pixels.by_row)
    size = np.hypot(by_column, by_row)
    seen = np.ones(len(size), dtype=bool)
    for end in across_px:
        way = (end - angle.delta / size) / size
        column, row = pixels.columns + way * by_column, pixels.rows + way * by_row
        seen &= (column >= -0.5) & (column <= camera.width - 0.5) & (row >= -0.5) & (row <= camera.height - 0.5)
    return seen


def _squares(
    directions: FloatArray,
    cam_from_itrs: FloatArray,
    r_itrs: FloatArray,
    axes_m: FloatArray,
    outside_px: float,
    inside_px: float,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return columns and rows of the pixels of all squares whose middle lies within a distance of the limb."""
    height, width = directions.shape[:2]
    middle, before = SQUARE_PX // 2, SQUARE_PX // 2 - 1
    column = np.minimum(np.arange(0, width, SQUARE_PX) + middle, width - 1)
    row = np.minimum(np.arange(0, height, SQUARE_PX) + middle, height - 1)
    centre = directions[row[:, None], column[None, :]].reshape(-1, 3).T
    right = directions[row[:, None], np.maximum(column - before, 0)[None, :]].reshape(-1, 3).T
    below = directions[np.maximum(row - before, 0)[:, None], column[None, :]].reshape(-1, 3).T
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = limb_angle(np.ascontiguousarray(centre), cam_from_itrs, r_itrs, axes_m)
        far = angle.delta / image_scale(angle, (centre - right) / before, (centre - below) / before)
        # A square whose centre sees nothing may still hold pixels at the edge of the image circle.
        some = np.flatnonzero(~((far > inside_px) | (far < -outside_px)))
    offset = np.arange(SQUARE_PX, dtype=np.intp)
    corner_row, corner_column = np.divmod(some, len(column))
    rows = (corner_row[:, None, None] * SQUARE_PX + offset[None, :, None]).repeat(SQUARE_PX, axis=2).ravel()
    columns = (corner_column[:, None, None] * SQUARE_PX + offset[None, None, :]).repeat(SQUARE_PX, axis=1).ravel()
    in_image = (columns < width) & (rows < height)
    return columns[in_image], rows[in_image]


def limb_bend(
    camera: CameraModel, uv: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray
) -> FloatArray:
    """Return the divergence of the gradient of the distance inside the limb [1/px]: ``-1 / radius`` inside a disc.

    Parameters
    ----------
    camera : CameraModel
    uv : ndarray, shape (n, 2)
        Places (column, row) [px].
    cam_from_itrs, r_itrs, axes_m : ndarray
        As for :func:`.limb_angle.limb_angle`.

    Returns
    -------
    ndarray, shape (n,)
        NaN where a neighbour sees nothing.
    """

    steps = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    middle = uv + steps[:, None]
    around = middle + np.concatenate([np.zeros((1, 2)), steps])[:, None, None]
    los, right, left, below, above = np.moveaxis(unproject(camera, around).reshape(5, -1, 3), -1, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = limb_angle(np.ascontiguousarray(los), cam_from_itrs, r_itrs, axes_m)
        by_column, by_row = _gradient(angle, right - left, below - above)
        size = np.hypot(by_column, by_row)
        (to_right, to_left, _, _), (_, _, to_below, to_above) = np.array([by_column / size, by_row / size]).reshape(
            2, 4, -1
        )
        return np.asarray(to_right - to_left + to_below - to_above)


def _gradient(angle: LimbAngle, by_column: FloatArray, by_row: FloatArray) -> tuple[FloatArray, FloatArray]:
    return (
        np.einsum("ij,ij->j", angle.by_direction, by_column),
        np.einsum("ij,ij->j", angle.by_direction, by_row),
    )
