"""The pixels that see the limb's profile, and the height of each line of sight at its lowest point, with derivatives.

Divided by the semi-axes ``s`` the ellipsoid is the unit sphere. A ray from ``p = r / s`` along ``e = d / s`` comes
nearest to its centre at ``q = p + l e`` with ``l = -p . e / e . e``, the distance along the ray in metres. There its
height over the ellipsoid is ::

    h = (|q| - 1) / |g|,        g = (q / |q|) / s,        n = g / |g|

with ``n`` the normal beneath. Below 0 the ray ends on the ground, and ``h`` is the depth that it would reach. The
surface ``|q| = const`` is a scaled ellipsoid, which differs from one at constant height by less than ``2 f h^2 / a``, 5
m at 70 km.

With a turn and a shift of the ray its lowest point moves along the normal::

    dh = l n . dd + n . dr

The change of ``g`` is smaller by ``h / a`` and neglected. Errors of the lens change the direction of a pixel at ``(x,
y)`` from the principal point as the pixel's own motion in the image does: by ``-x, -y`` for the logarithm of the focal
length, by ``-1`` in a column or a row for the principal point, and outwards by ``-(rho / rho_corner)^3`` px for the
distortion, ``rho`` the radius without it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.core.errors import UserError
from horizonval.estimation.fit.edge_pixels import FEWEST_LIMB_PX
from horizonval.estimation.fit.light import from_widest_gap
from horizonval.estimation.fit.pixels import NearPixels, near_pixels
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.lens_error import k1_per_px
from horizonval.geometry.camera import CameraModel, unproject
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.rotation import cross, off_axis_angle, tangent_basis
from horizonval.spec.camera import unified_radius

LEAST_ROOT = 0.01
"""Smallest root of a height seen from itself: higher rays pass above the observer."""
AXIS_CAM = np.array([0.0, 0.0, 1.0])


class NoLimbError(np.linalg.LinAlgError):
    """Nothing in the image resembles the predicted limb; other errors of the equations mean divergence."""


@dataclass(frozen=True)
class RayHeight:
    """Lowest points of n lines of sight.

    ``height_m``: shape (n,); ``distance_m``: shape (n,), from the observer; ``normal_cam``: shape (3, n), unit normal
    of the ellipsoid below, in camera axes. Derivatives of the height: ``by_rotation`` (3, n), rotation vector in camera
    axes [m/rad]; ``by_position`` (3, n), Earth-fixed position [1], the normal.
    """

    height_m: FloatArray
    distance_m: FloatArray
    normal_cam: FloatArray
    by_rotation: FloatArray
    by_position: FloatArray

    def take(self, which: NDArray[np.bool_] | NDArray[np.intp]) -> RayHeight:
        """Return some of them, by their numbers or by a mask."""
        return RayHeight(
            self.height_m[which],
            self.distance_m[which],
            self.normal_cam[:, which],
            self.by_rotation[:, which],
            self.by_position[:, which],
        )


def ray_height(los_cam: FloatArray, cam_from_itrs: FloatArray, r_itrs: FloatArray, axes_m: FloatArray) -> RayHeight:
    """Return the heights at which lines of sight pass; arguments as for :func:`.limb_angle.limb_angle`."""
    p = r_itrs / axes_m
    e = (cam_from_itrs / axes_m).T @ los_cam
    distance = -(p @ e) / np.einsum("ij,ij->j", e, e)
    q = p[:, None] + distance * e
    size = np.sqrt(np.einsum("ij,ij->j", q, q))
    g = q / axes_m[:, None]
    steep = np.sqrt(np.einsum("ij,ij->j", g, g))
    normal = g / steep
    normal_cam = cam_from_itrs @ normal
    return RayHeight(
        height_m=(size - 1.0) * size / steep,
        distance_m=distance,
        normal_cam=normal_cam,
        by_rotation=distance * np.array(cross(normal_cam, los_cam)),
        by_position=normal,
    )


def level_distance(height_m: FloatArray, curve: float) -> tuple[FloatArray, FloatArray]:
    r"""Return the distances across a limb that belong to heights, and their derivative.

    Seen at the distance ``l``, a ray that is turned outwards by the angle ``b`` passes higher by ``y - curve y^2`` with
    ``y = l b``, ``curve = R / (2 l^2)``: pixels are even in ``y``, and not in height, by 3 % a pixel of 30 km.
    ``curve``: [1/m].
    """
    root = np.sqrt(np.maximum(1.0 - 4.0 * curve * height_m, LEAST_ROOT))
    return 2.0 * height_m / (1.0 + root), 1.0 / root


NODE_RAD = 0.035
"""Node spacing at the Earth's centre: a sixth of the air's correlation length. Linear interpolation leaves 0.4 % of a
mode's standard deviation; with half of the length 3 % of one sign would remain, which confuses tilt with height."""
MOST_SECTORS = 64
BORDER_PX = 2
"""Width of the image's border that is left out: light from outside, and the change of scale, are unknown there."""
LEVELLINGS = 2
"""Iterations for nodes: each squares a height over the Earth's radius, so that 21 km become 70 m, then nothing."""
WIDER = 1.5
"""Widening of the window in pixels: a lens's scale may be so much larger at its border than in the middle."""
MOST_PIXELS = 3000
"""Number of pixels near a limb: one to two times as many are used, evenly spread. More determine nothing that the air
leaves open."""


@dataclass(frozen=True)
class LimbPlaces:
    """Nodes along the limb, m + 1.

    ``width_m`` (m + 1,): a pixel across the limb; ``boxes_m`` (m + 1, 2): its parts along column and row, of equal
    square sum; ``lift_m`` (m + 1,): displacement across the limb by a blur of one pixel's variance; ``normal_cam`` (m +
    1, 3): of the ellipsoid below; ``los_cam`` (m + 1, 3).
    """

    width_m: FloatArray
    boxes_m: FloatArray
    lift_m: FloatArray
    normal_cam: FloatArray
    los_cam: FloatArray


@dataclass(frozen=True)
class ProfilePixels:
    """n pixels that see the profile, in order of azimuth, in m sectors with nodes at both ends.

    ``columns``, ``rows``, ``values`` (grey levels), ``light`` (response relative to the axis: solid angle through the
    pupil), ``height_m``, ``distance_m`` (from the observer): shape (n,); ``across_m`` (n,): distance across the limb;
    ``by_pose`` (7, n), ``by_lens`` (4, n): its derivatives; ``sector`` (n,); ``starts`` (m + 1,); ``along`` (n,):
    position in the sector, 0 to 1; ``every``: number of pixels of the image of which each is one; ``space``: values of
    pixels above the air.
    """

    columns: FloatArray
    rows: FloatArray
    values: FloatArray
    light: FloatArray
    height_m: FloatArray
    distance_m: FloatArray
    across_m: FloatArray
    by_pose: FloatArray
    by_lens: FloatArray
    sector: NDArray[np.intp]
    starts: NDArray[np.intp]
    along: FloatArray
    every: int
    nodes: LimbPlaces
    space: FloatArray


def profile_pixels(
    image: FloatArray,
    camera: CameraModel,
    pose: LimbPose,
    ellipsoid: Ellipsoid,
    between_m: tuple[float, float],
    space_m: float,
    curve: float,
    nodes: LimbPlaces | None = None,
) -> ProfilePixels:
    """Return valid pixels between two heights at a pose, about :data:`MOST_PIXELS` of them, evenly spread.

    ``space_m``: height from which there is no air; ``nodes``: of a pose near by, to be kept. Raises ``LinAlgError``:
    too little limb in view.
    """
    bottom_m, top_m = between_m
    axes = ellipsoid.axes_m
    to_limb = np.sqrt(max(float(pose.r_itrs @ pose.r_itrs - axes[0] ** 2), 1.0))
    per_m = WIDER * max(camera.fx, camera.fy) / to_limb
    reach = top_m * per_m, -bottom_m * per_m, MOST_PIXELS
    near = near_pixels(camera, pose.cam_from_itrs, pose.r_itrs, axes, *reach)
    ray = ray_height(near.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    inside = (ray.height_m > bottom_m) & (ray.height_m < top_m) & (ray.distance_m > 0.0)
    inside &= np.isfinite(image[near.rows, near.columns])
    for place, size in ((near.columns, camera.width), (near.rows, camera.height)):
        inside &= (place >= BORDER_PX) & (place < size - BORDER_PX)
    near, ray = near.take(inside), ray.take(inside)
    across_m, by_height = level_distance(ray.height_m - pose.height_m, curve)
    to_distance = ray.distance_m * by_height
    by_column = to_distance * np.einsum("ij,ij->j", ray.normal_cam, near.by_column)
    by_row = to_distance * np.einsum("ij,ij->j", ray.normal_cam, near.by_row)
    width = np.hypot(by_column, by_row)
    on_limb = np.abs(ray.height_m) < 0.5 * width
    limb_px = int(on_limb.sum())
    if limb_px < FEWEST_LIMB_PX:
        raise NoLimbError(f"{limb_px} pixels of limb in view; {FEWEST_LIMB_PX} are needed")
    basis = tangent_basis(pose.nadir_cam)
    azimuth = _azimuth(basis, near.los_cam)
    if nodes is None:
        order, turned = from_widest_gap(azimuth)
        at_centre = float(np.sqrt(max(1.0 - axes[0] ** 2 / float(pose.r_itrs @ pose.r_itrs), 0.0)))
        count = int(np.clip(np.ceil(turned[-1] * at_centre / NODE_RAD), 2, min(MOST_SECTORS, limb_px // 2)))
        borders = turned[np.linspace(0, len(order) - 1, count + 1).astype(np.intp)]
        along_limb = order[on_limb[order]]
        nearest = np.searchsorted(np.mod(azimuth[along_limb] - azimuth[order[0]], 2.0 * np.pi), borders)
        some = along_limb[np.minimum(nearest, len(along_limb) - 1)]
        parts = np.abs([width[some], by_column[some], by_row[some]])
        nodes = _limb_places(camera, pose, axes, curve, azimuth[order[0]] + borders, near.take(some), parts)
    else:
        # Pixels may lie a little before the first node and after the last one.
        at_nodes = _azimuth(basis, nodes.los_cam.T)
        borders = np.mod(at_nodes - at_nodes[0], 2.0 * np.pi)
        before = 0.5 * (2.0 * np.pi - borders[-1])
        from_first = np.mod(azimuth - at_nodes[0] + before, 2.0 * np.pi) - before
        order = np.argsort(from_first, kind="stable")
        turned, count = from_first[order], len(borders) - 1
    sector = np.clip(np.searchsorted(borders, turned, side="right") - 1, 0, count - 1)
    starts = np.searchsorted(sector, np.arange(count + 1))
    along = np.clip((turned - borders[sector]) / np.maximum(np.diff(borders), 1e-12)[sector], 0.0, 1.0)
    values = np.asarray(image[near.rows, near.columns], dtype=np.float64)
    of_each = np.concatenate(
        [
            np.array([near.columns, near.rows, values, _light(camera, near), ray.height_m, ray.distance_m, across_m]),
            ray.by_rotation * by_height,
            ray.by_position * by_height,
            -by_height[None],
            _by_lens(camera, near, by_column, by_row),
        ]
    )[:, order]
    space = values[ray.height_m > space_m]
    columns, rows, values, light, height_m, distance_m, across_m = of_each[:7]
    return ProfilePixels(
        columns=columns,
        rows=rows,
        values=values,
        light=light,
        height_m=height_m,
        distance_m=distance_m,
        across_m=across_m,
        by_pose=of_each[7:14],
        by_lens=of_each[14:],
        sector=sector,
        starts=starts,
        along=along,
        every=near.every,
        nodes=nodes,
        space=space,
    )


def _light(camera: CameraModel, near: NearPixels) -> FloatArray:
    """Return the response of pixels relative to the axis, shape (n,)."""
    light = np.abs(np.einsum("ij,ij->j", near.los_cam, np.array(cross(near.by_column, near.by_row))))
    if not camera.wide:
        light = light * np.maximum(near.los_cam[2], 0.0)
    return np.asarray(light * (camera.fx * camera.fy))


def _by_lens(camera: CameraModel, near: NearPixels, by_column: FloatArray, by_row: FloatArray) -> FloatArray:
    """Return the derivatives of distances across the limb by errors of the lens, shape (4, n)."""
    x, y = near.columns - camera.cx, near.rows - camera.cy
    by_lens = np.array([-(x * by_column + y * by_row), -by_column, -by_row, np.zeros(len(x))])
    try:
        per_px = k1_per_px(camera)
    except UserError:
        return by_lens
    if camera.projection == "pinhole":
        radius = np.hypot(near.los_cam[0], near.los_cam[1]) / np.maximum(near.los_cam[2], 1e-3)
    else:
        radius = off_axis_angle(near.los_cam.T, AXIS_CAM)
        if camera.projection == "unified":
            radius = (1.0 + camera.shape[0]) * unified_radius(radius, camera.shape)
    outwards_px = per_px * np.sqrt(camera.fx * camera.fy) * radius**3
    by_lens[3] = by_lens[0] * outwards_px / np.maximum(np.hypot(x, y), 1.0)
    return by_lens


def _azimuth(basis: FloatArray, los_cam: FloatArray) -> FloatArray:
    """Return the azimuths of lines of sight (3, n) about the nadir, by its tangents (3, 2)."""
    across = basis.T @ los_cam
    return np.asarray(np.arctan2(across[1], across[0]))


def _limb_places(
    camera: CameraModel,
    pose: LimbPose,
    axes: FloatArray,
    curve: float,
    turn: FloatArray,
    near: NearPixels,
    parts: FloatArray,
) -> LimbPlaces:
    """Return nodes at azimuths (m + 1,), by the pixels of the limb next to them.

    ``parts``: shape (3, m + 1), width of these pixels across the limb [m], whole and along columns and rows.
    """
    uv = np.column_stack([near.columns, near.rows]).astype(float)
    # Nodes at the ends may lie outside the image: where they are is a matter of geometry alone.
    outwards = tangent_basis(pose.nadir_cam) @ np.array([np.cos(turn), np.sin(turn)])
    sine = float(axes[0] / np.linalg.norm(pose.r_itrs))
    los_cam = _level_los(sine * outwards + np.sqrt(1.0 - sine**2) * pose.nadir_cam[:, None], pose, axes)
    return LimbPlaces(
        width_m=parts[0],
        boxes_m=parts[1:].T.copy(),
        lift_m=0.5 * np.nan_to_num(_laplacian(camera, uv, pose, axes, curve)),
        normal_cam=ray_height(los_cam, pose.cam_from_itrs, pose.r_itrs, axes).normal_cam.T,
        los_cam=los_cam.T,
    )


def _level_los(los_cam: FloatArray, pose: LimbPose, axes: FloatArray) -> FloatArray:
    """Return lines of sight (3, n) to a sphere's limb turned to touch the ellipsoid, up to 21 km lower."""
    for _ in range(LEVELLINGS):
        ray = ray_height(los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
        los_cam = los_cam - ray.normal_cam * (ray.height_m / ray.distance_m)
        los_cam = los_cam / np.linalg.norm(los_cam, axis=0)
    return los_cam


def _laplacian(camera: CameraModel, uv: FloatArray, pose: LimbPose, axes: FloatArray, curve: float) -> FloatArray:
    """Return the Laplacian [m/px^2], shape (n,), of the distance across the limb at positions (n, 2).

    A blur of variance ``s^2`` displaces the limb by ``s^2 / 2`` times it: limbs are curved and the scale varies.
    """

    steps = np.array([[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    with np.errstate(invalid="ignore"):
        los = unproject(camera, (uv[None] + steps[:, None]).reshape(-1, 2)).T
        height = ray_height(los, pose.cam_from_itrs, pose.r_itrs, axes).height_m
        across = level_distance(height, curve)[0].reshape(len(steps), -1)
    return np.asarray(across[1:].sum(axis=0) - 4.0 * across[0])
