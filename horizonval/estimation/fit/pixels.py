"""The pixels near a limb: their selection, and the distance of each line of sight from the limb, with derivatives.

**Height of a line of sight.** Divided by the semi-axes ``s`` the ellipsoid is the unit sphere. A ray from ``p = r / s``
along ``e = d / s`` comes nearest to its centre at ``q = p + l e`` with ``l = -p . e / e . e``, the distance along the
ray in metres. There its height over the ellipsoid is ::

    h = (|q| - 1) / |g|,        g = (q / |q|) / s,        n = g / |g|

with ``n`` the normal beneath. Below 0 the ray ends on the ground, and ``h`` is the depth that it would reach. The
surface ``|q| = const`` is a scaled ellipsoid, which differs from one at constant height by less than ``2 f h^2 / a``, 5
m at 70 km. A turn of the ray by ``dd`` and a shift by ``dr`` move its lowest point along the normal::

    dh = l n . dd + n . dr

The change of ``g`` is smaller by ``h / a`` and neglected.

**Distance from the limb.** A ray that is turned outwards by the angle ``b`` at the distance ``l`` passes higher by ``y
- c y^2`` with ``y = l b`` and ``c = R / (2 l^2)``: pixels are even in ``y``, the distance across the limb, and not in
height, by 3 % a pixel of 30 km. From the pose of a choice of pixels ``y`` is linear in turn, position and errors of the
lens. A displacement of ``u`` neglects ``u^2 / 2 l``, 0.004 px for a pixel of 19 km.

A blur of variance ``s^2`` moves the image of a bent limb by ``s^2 / 2`` times its curvature, 5e-4 px on a disc of 1000
px: the second difference of ``y`` along the limb.

**Selection.** Squares of 8 x 8 pixels are tested by their centres, and only those near the limb are tested pixel by
pixel. A distance in the image is ``y`` over its gradient by column and row.

**Cells.** Where more pixels are near the limb than a fit needs, pixels at one distance from it and near each other are
replaced by their mean. Cells are half a pixel deep at the edge and wider beside it; the variance of the distances in a
cell is a part of its blur.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.light import from_widest_gap
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.lens_error import miscalibrated
from horizonval.estimation.limb.picture import pixel_directions
from horizonval.geometry.camera import CameraModel, project, unproject
from horizonval.geometry.rotation import cross

SQUARE_PX = 8
"""Side of the squares that the search for near pixels starts with."""
FEWEST_LIMB_PX = 8
"""Smallest limb in view [px]: seven unknowns and a level."""


@dataclass(frozen=True)
class RayHeight:
    """Lowest points of n lines of sight.

    ``height_m``: shape (n,); ``distance_m``: shape (n,), from the observer; ``normal_cam``: shape (3, n), unit normal
    of the ellipsoid below, in camera axes; ``by_position``: shape (3, n), the same in Earth-fixed axes.
    """

    height_m: FloatArray
    distance_m: FloatArray
    normal_cam: FloatArray
    by_position: FloatArray

    def by_rotation(self, los_cam: FloatArray) -> FloatArray:
        """Return the derivative of the height, shape (3, n), by a rotation vector in camera axes [m/rad]."""
        return np.asarray(self.distance_m * np.array(cross(self.normal_cam, los_cam)))


def ray_height(los_cam: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray) -> RayHeight:
    """Return the heights at which lines of sight pass.

    ``los_cam``: shape (3, n), unit vectors; ``cam_from_itrs``: shape (3, 3); ``r_itrs``: shape (3,), observer [m];
    ``axes_m``: shape (3,), semi-axes.
    """
    p = r_itrs / axes_m
    e = (cam_from_itrs / axes_m).T @ los_cam
    distance = -(p @ e) / np.einsum("ij,ij->j", e, e)
    q = p[:, None] + distance * e
    size = np.sqrt(np.einsum("ij,ij->j", q, q))
    g = q / axes_m[:, None]
    steep = np.sqrt(np.einsum("ij,ij->j", g, g))
    normal = g / steep
    return RayHeight((size - 1.0) * size / steep, distance, cam_from_itrs @ normal, normal)


def level_distance(height_m: FloatArray, curve: float) -> tuple[FloatArray, FloatArray]:
    """Return the distances across a limb that belong to heights above it, and their derivative.

    Rays higher than the root's least value pass above the observer.
    """
    root = np.sqrt(np.maximum(1.0 - 4.0 * curve * height_m, 0.01))
    return 2.0 * height_m / (1.0 + root), 1.0 / root


def pixel_at_limb_m(camera: CameraModel, r_itrs: FloatArray, radius_m: float) -> float:
    """Return what a pixel on the axis sees at the distance of the limb."""
    to_limb_2 = float(r_itrs @ r_itrs) - radius_m**2
    return float(np.sqrt(max(to_limb_2, 1.0))) / max(camera.fx, camera.fy)


def with_errors(camera: CameraModel, lens: FloatArray) -> CameraModel:
    """Return a camera with errors of its lens, shape (4,)."""
    if not lens.any():
        return camera
    return miscalibrated(camera, float(np.expm1(lens[0])), (float(lens[1]), float(lens[2])), float(lens[3]))


class Limb:
    """The limb of an ellipsoid: pose of the camera, and semi-axes (3,) including the limb's height.

    Raises ``LinAlgError``: observer on or below the limb.
    """

    def __init__(self, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray) -> None:
        self._limb = cam_from_itrs, r_itrs, axes_m
        to_limb_2 = float(r_itrs @ r_itrs) - axes_m[0] ** 2
        if not to_limb_2 > 0.0:
            raise np.linalg.LinAlgError("the position lies below the limb")
        self.curve = 0.5 * axes_m[0] / to_limb_2

    def seen(self, los_cam: FloatArray) -> tuple[RayHeight, FloatArray, FloatArray]:
        """Return lowest points of lines of sight (3, n), distances outside the limb and their derivative by height."""
        ray = ray_height(los_cam, *self._limb)
        return ray, *level_distance(ray.height_m, self.curve)

    def bend_m(self, camera: CameraModel, uv: FloatArray, gradient: FloatArray) -> FloatArray:
        """Return by how much a blur of one pixel's variance adds to distances outside the limb [m/px^2], shape (n,).

        ``uv``: shape (n, 2); ``gradient``: shape (2, n), of the distance there. 0 where a neighbour has no direction.
        """
        along = np.array([-gradient[1], gradient[0]]).T / np.hypot(*gradient)[:, None]
        with np.errstate(invalid="ignore"):
            los = unproject(camera, np.concatenate([uv, uv + along, uv - along]))
            here, there, back = self.seen(np.ascontiguousarray(los.T))[1].reshape(3, -1)
        return np.nan_to_num(0.5 * (there + back) - here)


@dataclass(frozen=True)
class NearPixels:
    """n pixels near a limb.

    ``columns``, ``rows``: shape (n,); ``los_cam``: shape (3, n), unit lines of sight; ``by_column``, ``by_row``: shape
    (3, n), their change over one pixel; ``ray``: their lowest points; ``across_m``, ``rise``: shape (n,), distance
    outside the limb and its derivative by height; ``every``: number of pixels of the image of which each is one, where
    they are thinned out.
    """

    columns: NDArray[np.intp]
    rows: NDArray[np.intp]
    los_cam: FloatArray
    by_column: FloatArray
    by_row: FloatArray
    ray: RayHeight
    across_m: FloatArray
    rise: FloatArray
    every: int = 1

    @cached_property
    def gradient(self) -> FloatArray:
        """Change of the distance across the limb by column and row [m/px], shape (2, n)."""
        sides = self.by_column, self.by_row
        along = np.array([np.einsum("ij,ij->j", self.ray.normal_cam, side) for side in sides])
        return np.asarray(self.ray.distance_m * self.rise * along)

    @cached_property
    def width_m(self) -> FloatArray:
        """What a pixel sees across the limb, shape (n,)."""
        return np.hypot(*self.gradient)

    @property
    def x_px(self) -> FloatArray:
        """Distance inside the limb, shape (n,)."""
        return -self.across_m / self.width_m

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> NearPixels:
        """Return some of them, by their numbers or by a mask."""
        ray = RayHeight(*(one[..., which] for one in vars(self.ray).values()))
        names = "columns", "rows", "los_cam", "by_column", "by_row", "across_m", "rise"
        return NearPixels(**{name: getattr(self, name)[..., which] for name in names}, ray=ray, every=self.every)

    def in_view(self, camera: CameraModel, across_px: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.bool_]:
        """Return pixels, shape (n,), with the nearest limb in view from ``across_px[0]`` (outside, < 0) to [1]."""
        inwards, x = -self.gradient / self.width_m, self.x_px
        seen = np.ones(len(x), dtype=bool)
        for end in set(across_px):
            column, row = np.array([self.columns, self.rows]) + (end - x) * inwards
            seen &= (column >= -0.5) & (column <= camera.width - 0.5) & (row >= -0.5) & (row <= camera.height - 0.5)
        return seen


def near_pixels(
    camera: CameraModel,
    pose: LimbPose,
    axes_m: FloatArray,
    outside_px: float,
    inside_px: float,
    most: int | None = None,
) -> NearPixels:
    """Return the pixels within a distance of the limb, except where they or a neighbour have no direction.

    In an image of one row, distances are along the row. ``axes_m``: semi-axes including the limb's height;
    ``outside_px``, ``inside_px``: distances towards space and towards the Earth; ``most``: thin out evenly to one to
    two times so many squares of pixels. Raises ``LinAlgError``: observer on or below the limb.
    """
    directions, limb = pixel_directions(camera), Limb(pose.cam_from_itrs, pose.r_itrs, axes_m)
    # Half a square's diagonal, plus the effect of the lens's changing scale up to the limb.
    reach = SQUARE_PX / np.sqrt(2.0) + 2.0
    squares = _squares(camera)
    with np.errstate(invalid="ignore", divide="ignore"):
        middle = NearPixels(*squares, *limb.seen(squares[2]))
        far = np.where(middle.ray.distance_m <= 0.0, -np.inf, middle.x_px)
        # A square whose centre sees nothing may still hold pixels at the edge of the image circle.
        some = np.flatnonzero(~((far > inside_px + reach) | (far < -outside_px - reach)))
    width = np.nan_to_num(middle.width_m[some], nan=pixel_at_limb_m(camera, pose.r_itrs, axes_m[0]))
    # The same pixels for every pose near by: of all by a power of two, on oblique lines through the image, apart by the
    # golden section's smaller part, the most even; odd, so that no column stays empty.
    count = len(some) * SQUARE_PX**2
    every = 1 if most is None or count <= most else 1 << int(np.log2(count / most))
    line = round(0.382 * every) | 1
    in_row, in_column = np.divmod(np.arange(SQUARE_PX**2), SQUARE_PX)
    chosen = (in_column + in_row * line) % min(every, SQUARE_PX) == 0
    corners = np.divmod(some, -(-directions.shape[1] // SQUARE_PX))
    rows, columns = (
        (corner[:, None] * SQUARE_PX + offset[chosen]).ravel()
        for corner, offset in zip(corners, (in_row, in_column), strict=True)
    )
    width = width.repeat(np.count_nonzero(chosen))
    chosen = (columns < directions.shape[1]) & (rows < directions.shape[0]) & ((columns + rows * line) % every == 0)
    columns, rows, width = columns[chosen], rows[chosen], width[chosen]
    los_cam = np.ascontiguousarray(directions[rows, columns].T)
    with np.errstate(invalid="ignore"):
        ray, across, rise = limb.seen(los_cam)
        near = np.flatnonzero((across <= outside_px * width) & (across >= -inside_px * width) & (ray.distance_m > 0.0))
    none = np.zeros((3, len(columns)))
    pixels = NearPixels(columns, rows, los_cam, none, none, ray, across, rise, every).take(near)
    by_column, by_row = _sides(directions, pixels.columns, pixels.rows)
    pixels = replace(pixels, by_column=by_column, by_row=by_row)
    # A neighbour outside the image circle has no direction.
    whole = np.isfinite(pixels.by_column.sum(axis=0) + pixels.by_row.sum(axis=0))
    return pixels if whole.all() else pixels.take(whole)


def _sides(directions: FloatArray, columns: NDArray[np.intp], rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
    """Return the change of the directions (H, W, 3) over one pixel, by column and by row, shape (3, n) each."""
    height, width = directions.shape[:2]
    right, left = np.minimum(columns + 1, width - 1), np.maximum(columns - 1, 0)
    below, above = np.minimum(rows + 1, height - 1), np.maximum(rows - 1, 0)
    by_column = (directions[rows, right] - directions[rows, left]) / np.maximum(right - left, 1)[:, None]
    by_row = (directions[below, columns] - directions[above, columns]) / np.maximum(below - above, 1)[:, None]
    return by_column.T.copy(), by_row.T.copy()


@lru_cache(maxsize=2)
def _squares(camera: CameraModel) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray, FloatArray, FloatArray]:
    """Return column, row, line of sight of the middle of all squares, and its change over one pixel."""
    directions = pixel_directions(camera)
    height, width = directions.shape[:2]
    middle = SQUARE_PX // 2
    column = np.minimum(np.arange(0, width, SQUARE_PX) + middle, width - 1)
    row = np.minimum(np.arange(0, height, SQUARE_PX) + middle, height - 1)
    rows, columns = (one.ravel() for one in np.meshgrid(row, column, indexing="ij"))
    with np.errstate(invalid="ignore"):
        sides = _sides(directions, columns, rows)
    return columns, rows, np.ascontiguousarray(directions[rows, columns].T), *sides


@dataclass(frozen=True)
class LimbPixels:
    """n pixels near a limb, or means of some, as fits use them.

    ``pose``, ``lens``: for which they are chosen; ``every``: number of pixels of the image of which each is one.

    ``columns``, ``rows``, ``values`` (grey levels), ``counts`` (pixels of which each is the mean), ``spread_px2``
    (variance of their distances from the limb): shape (n,). ``height_m``, ``distance_m``: shape (n,), of the lowest
    points, from the observer; ``across_m``: shape (n,), distance outside the limb; ``gradient``: shape (2, n), its
    change by column and row [m/px]; ``by_pose`` (7, n), ``by_lens`` (4, n): its derivatives; ``azimuth``: shape (n,),
    about the nadir [rad].
    """

    pose: LimbPose
    lens: FloatArray
    every: int
    columns: FloatArray
    rows: FloatArray
    values: FloatArray
    counts: FloatArray
    spread_px2: FloatArray
    height_m: FloatArray
    distance_m: FloatArray
    across_m: FloatArray
    gradient: FloatArray
    by_pose: FloatArray
    by_lens: FloatArray
    azimuth: FloatArray

    @cached_property
    def width_m(self) -> FloatArray:
        """What a pixel sees across the limb, shape (n,)."""
        return np.hypot(*self.gradient)

    def of(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> dict[str, FloatArray]:
        """Return the arrays of some pixels, by their numbers or by a mask."""
        arrays = {name: one for name, one in vars(self).items() if isinstance(one, np.ndarray) and name != "lens"}
        return {name: np.ascontiguousarray(one[..., which]) for name, one in arrays.items() if name != "width_m"}

    def moved(self, pose: LimbPose, lens: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances across the limb from another pose, and their derivatives by a turn from there (3, n).

        The way is a tilt after a turn about the nadir, which moves the limb little, however far it is.
        """
        away, nadir = self.pose.way_to(pose), self.pose.nadir_cam
        across = self.across_m + away @ self.by_pose
        if (lens != self.lens).any():
            across = across + (lens - self.lens) @ self.by_lens
        # A turn after the tilt t so far, t + d - t x d / 2 - (t x n) (n . d) / 2: rotations of both kinds commute less.
        tilt = away[:3] - nadir * (nadir @ away[:3])
        after = np.eye(3) + 0.5 * np.cross(tilt, np.eye(3)) - 0.5 * np.outer(np.cross(tilt, nadir), nadir)
        return across, after.T @ self.by_pose[:3]


def limb_pixels(
    image: FloatArray,
    camera: CameraModel,
    near: NearPixels,
    pose: LimbPose,
    lens: FloatArray,
    axes_m: FloatArray,
    basis: FloatArray,
    most: int | None = None,
) -> LimbPixels:
    """Return pixels as fits use them, or cells where they are more than ``most``.

    ``camera``: with the errors ``lens``; ``near``: about the limb of ``pose``, with the semi-axes ``axes_m``;
    ``basis``: shape (3, 2), tangents of the azimuth in camera axes.
    """
    across = basis.T @ near.los_cam
    azimuth = np.mod(np.arctan2(across[1], across[0]), 2.0 * np.pi)
    values = np.asarray(image[near.rows, near.columns], dtype=np.float64)
    columns, rows = near.columns.astype(float), near.rows.astype(float)
    counts, spread = np.ones(len(values)), np.zeros(len(values))
    if most is not None and len(values) > most:
        cells = _Cells(near.x_px, azimuth, most)
        values, columns, rows, x = (cells.mean(one) for one in (values, columns, rows, near.x_px))
        counts, azimuth, spread = cells.counts, cells.azimuth, np.maximum(cells.mean(near.x_px**2) - x**2, 0.0)
        los, by_column, by_row = (cells.mean(one) for one in (near.los_cam, near.by_column, near.by_row))
        ray, _, rise = Limb(pose.cam_from_itrs, pose.r_itrs, axes_m).seen(los)
        distance = cells.mean(near.across_m)
        near = NearPixels(near.columns, near.rows, los, by_column, by_row, ray, distance, rise, near.every)
    by_pose = np.concatenate([near.ray.by_rotation(near.los_cam), near.ray.by_position, -np.ones((1, len(values)))])
    bent = np.zeros((len(values), 2))
    if camera.projection != "equal_angle":
        # Linear in its coefficient: one of a whole pixel at the corner is as good as a small one.
        there, _ = project(miscalibrated(camera, distortion_px=1.0), near.los_cam.T)
        bent = np.nan_to_num(there - np.column_stack([columns, rows]))
    none, one = np.zeros(len(values)), np.ones(len(values))
    to_column = np.array([columns - camera.cx, one, none, bent[:, 0]])
    to_row = np.array([rows - camera.cy, none, one, bent[:, 1]])
    return LimbPixels(
        pose=pose,
        lens=lens.copy(),
        every=near.every,
        columns=columns,
        rows=rows,
        values=values,
        counts=counts,
        spread_px2=spread,
        height_m=near.ray.height_m,
        distance_m=near.ray.distance_m,
        across_m=near.across_m,
        gradient=near.gradient,
        by_pose=near.rise * by_pose,
        # A direction is seen at another position: the pixel, which stays, sees what is as far to the other side.
        by_lens=-(near.gradient[0] * to_column + near.gradient[1] * to_row),
        azimuth=azimuth,
    )


class _Cells:
    """Pixels gathered in cells of azimuth and distance, about ``most`` in number.

    ``x``, ``azimuth``: shape (n,), distance inside the limb [px]; ``counts``, ``azimuth``: shape (m,), of the cells.
    """

    def __init__(self, x: FloatArray, azimuth: FloatArray, most: int) -> None:
        # Half a pixel adds 0.02 px^2 to the blur's 0.6; its fourth moment changes the edge by 1e-4 of the step.
        deep, wide, end = 0.5, 2.0, 4.0
        edges = np.arange(-end, end + 0.5 * deep, deep)
        beside = np.arange(-end, x.min(), -wide)[:0:-1], np.arange(end, x.max(), wide)[1:]
        depth = np.searchsorted(np.concatenate([beside[0], edges, beside[1]]), x)
        layers = int(depth.max()) + 1
        order, along = from_widest_gap(azimuth)
        count = max(most // layers, 1)
        turned = np.empty(len(order))
        turned[order] = along
        arc = np.minimum((turned * (count / max(along[-1], 1e-300))).astype(np.intp), count - 1)
        self._number = arc * layers + depth
        every = np.bincount(self._number, minlength=count * layers)
        self._used = np.flatnonzero(every)
        self.counts = every[self._used].astype(np.float64)
        self.azimuth = np.mod(self.mean(turned) + azimuth[order[0]], 2.0 * np.pi)

    def mean(self, values: FloatArray) -> FloatArray:
        """Return the means of values (..., n) in the cells, shape (..., m)."""
        rows = [np.bincount(self._number, row)[self._used] / self.counts for row in np.atleast_2d(values)]
        return np.array(rows).reshape(*values.shape[:-1], -1)
