"""The pixels that see the limb's profile, in sectors between nodes along the limb."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.light import from_widest_gap
from horizonval.estimation.fit.pixels import (
    FEWEST_LIMB_PX,
    Limb,
    LimbPixels,
    NearPixels,
    limb_pixels,
    near_pixels,
    pixel_at_limb_m,
    ray_height,
)
from horizonval.estimation.fit.pose import LimbPose
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.ellipsoid import Ellipsoid
from horizonval.geometry.rotation import cross, tangent_basis


class NoLimbError(np.linalg.LinAlgError):
    """Nothing in the image resembles the predicted limb; other errors of the equations mean divergence."""


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
class ProfilePixels(LimbPixels):
    """n pixels that see the profile, in order of azimuth, in m sectors with nodes at both ends.

    ``height_m``: above the ellipsoid; ``light``: shape (n,), response relative to the axis (solid angle through the
    pupil); ``sector`` (n,); ``starts`` (m + 1,); ``along`` (n,): position in the sector, 0 to 1; ``space``: values of
    pixels above the air.
    """

    light: FloatArray
    sector: NDArray[np.intp]
    starts: NDArray[np.intp]
    along: FloatArray
    nodes: LimbPlaces
    space: FloatArray


def profile_pixels(
    image: FloatArray,
    camera: CameraModel,
    pose: LimbPose,
    lens: FloatArray,
    ellipsoid: Ellipsoid,
    between_m: tuple[float, float],
    space_m: float,
    nodes: LimbPlaces | None = None,
) -> ProfilePixels:
    """Return valid pixels between two heights above a pose's limb, about :data:`MOST_PIXELS` of them, evenly spread.

    ``lens``: shape (4,), errors that ``camera`` has already; ``space_m``: height from which there is no air; ``nodes``:
    of a pose near by, which are reused. Raises ``LinAlgError``: too little limb in view.
    """
    bottom_m, top_m = between_m
    axes = ellipsoid.axes_m + pose.height_m
    # A lens's scale may be so much larger at its border than in the middle.
    per_m = 1.5 / pixel_at_limb_m(camera, pose.r_itrs, axes[0])
    near = near_pixels(camera, pose, axes, top_m * per_m, -bottom_m * per_m, MOST_PIXELS)
    inside = (near.ray.height_m > bottom_m) & (near.ray.height_m < top_m)
    inside &= np.isfinite(image[near.rows, near.columns])
    # At the image's border light from outside, and the change of scale, are unknown.
    for place, size in ((near.columns, camera.width), (near.rows, camera.height)):
        inside &= (place >= 2) & (place < size - 2)
    near = near.take(inside)
    on_limb = np.abs(near.ray.height_m) < 0.5 * near.width_m
    limb_px = int(on_limb.sum())
    if limb_px < FEWEST_LIMB_PX:
        raise NoLimbError(f"{limb_px} pixels of limb in view; {FEWEST_LIMB_PX} are needed")
    basis = tangent_basis(pose.nadir_cam)
    seen = limb_pixels(image, camera, near, pose, lens, axes, basis)
    azimuth = seen.azimuth
    if nodes is None:
        order, turned = from_widest_gap(azimuth)
        at_centre = float(np.sqrt(max(1.0 - axes[0] ** 2 / float(pose.r_itrs @ pose.r_itrs), 0.0)))
        # Nodes are apart by a sixth of the air's correlation length, as seen from the Earth's centre. Linear
        # interpolation leaves 0.4 % of a mode's standard deviation; with half of the length 3 % of one sign would
        # remain, which confuses tilt with height.
        count = int(np.clip(np.ceil(turned[-1] * at_centre / 0.035), 2, min(64, limb_px // 2)))
        borders = turned[np.linspace(0, len(order) - 1, count + 1).astype(np.intp)]
        along_limb = order[on_limb[order]]
        nearest = np.searchsorted(np.mod(azimuth[along_limb] - azimuth[order[0]], 2.0 * np.pi), borders)
        some = along_limb[np.minimum(nearest, len(along_limb) - 1)]
        nodes = _nodes(camera, pose, ellipsoid.axes_m, azimuth[order[0]] + borders, near.take(some))
    else:
        # Pixels may lie a little before the first node and after the last one.
        across = basis.T @ nodes.los_cam.T
        at_nodes = np.arctan2(across[1], across[0])
        borders = np.mod(at_nodes - at_nodes[0], 2.0 * np.pi)
        before = 0.5 * (2.0 * np.pi - borders[-1])
        from_first = np.mod(azimuth - at_nodes[0] + before, 2.0 * np.pi) - before
        order = np.argsort(from_first, kind="stable")
        turned, count = from_first[order], len(borders) - 1
    sector = np.clip(np.searchsorted(borders, turned, side="right") - 1, 0, count - 1)
    arrays = seen.of(order)
    arrays["height_m"] += pose.height_m
    return ProfilePixels(
        pose,
        seen.lens,
        near.every,
        **arrays,
        light=_light(camera, near)[order],
        sector=sector,
        starts=np.searchsorted(sector, np.arange(count + 1)),
        along=np.clip((turned - borders[sector]) / np.maximum(np.diff(borders), 1e-12)[sector], 0.0, 1.0),
        nodes=nodes,
        space=seen.values[near.ray.height_m > space_m],
    )


def _light(camera: CameraModel, near: NearPixels) -> FloatArray:
    """Return the response of pixels relative to the axis, shape (n,)."""
    light = np.abs(np.einsum("ij,ij->j", near.los_cam, np.array(cross(near.by_column, near.by_row))))
    if not camera.wide:
        light = light * np.maximum(near.los_cam[2], 0.0)
    return np.asarray(light * (camera.fx * camera.fy))


def _nodes(camera: CameraModel, pose: LimbPose, axes: FloatArray, turn: FloatArray, near: NearPixels) -> LimbPlaces:
    """Return nodes at azimuths (m + 1,) on the limb of the ellipsoid, by the pixels of the limb next to them."""
    limb = pose.cam_from_itrs, pose.r_itrs, axes
    # Nodes at the ends may lie outside the image: where they are is a matter of geometry alone.
    outwards = tangent_basis(pose.nadir_cam) @ np.array([np.cos(turn), np.sin(turn)])
    sine = float(axes[0] / np.linalg.norm(pose.r_itrs))
    los_cam = sine * outwards + np.sqrt(1.0 - sine**2) * pose.nadir_cam[:, None]
    # From a sphere's limb to the ellipsoid's, up to 21 km lower: a turn leaves 70 m of that, and a second one nothing.
    for _ in range(2):
        ray = ray_height(los_cam, *limb)
        los_cam = los_cam - ray.normal_cam * (ray.height_m / ray.distance_m)
        los_cam = los_cam / np.linalg.norm(los_cam, axis=0)
    uv = np.column_stack([near.columns, near.rows]).astype(float)
    return LimbPlaces(
        width_m=near.width_m,
        boxes_m=np.abs(near.gradient).T.copy(),
        lift_m=Limb(*limb[:2], axes + pose.height_m).bend_m(camera, uv, near.gradient),
        normal_cam=ray_height(los_cam, *limb).normal_cam.T,
        los_cam=los_cam.T,
    )
