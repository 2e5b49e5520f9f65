"""The pixels near a limb, as the calibration by edges takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from horizonval.core.arrays import FloatArray
from horizonval.estimation.fit.known import ArcPlaces, LimbKnowledge
from horizonval.estimation.fit.pixels import NearPixels, image_scale, in_view, limb_angle, limb_bend, near_pixels
from horizonval.estimation.fit.pose import LimbPose
from horizonval.estimation.likelihood.sectors import (
    Sectors,
    modes_of,
    oblate_covariance,
    relief_modes,
    relief_nodes,
    sectors_of,
)
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.rotation import tangent_basis

OUTSIDE_PX, INSIDE_PX = 12.0, 8.0
"""Distance of a sharp limb's pixels into space and into the Earth. Separate levels of every sector, from ``w`` pixels
to either side, cost an edge of blur ``s`` the share ``s sqrt(pi) / 2 (1 / w_in + 1 / w_out)`` of its information, 14 %
here. The Earth's brightness is less uniform than space, hence the shorter distance."""
OUTSIDE_SCALES = 4.0
"""Additional distance into space for a soft limb, in scale heights; 2 % of it remain there."""
BLURS = 3.0
"""Additional distance for a blurred limb, in blurs: half the width of the edge."""
SHARP_PX = 1.0
FEWEST_LIMB_PX = 8
"""Smallest limb in view [px]: seven unknowns and a level."""
BEND_PLACES = 400
"""Along the limb: the bend is interpolated between them."""
SHORTEST_RAD = 0.05
"""Correlation length of cloud heights at the Earth's centre: 3 deg."""

MISPLACED_PX = 0.05
"""Standard deviation of the common displacement between real air's limb and an exponential: residuals of 0.01 to 0.05
of the step over a slope of 0.5 of the step per pixel. With equal pixels it acts as a height; with unequal ones it bends
the limb."""


@dataclass(frozen=True)
class LimbPixels:
    """n pixels near the limb, in order of azimuth.

    ``values``: shape (n,), grey levels; ``along``: shape (n,), position in the sector, -1/2 to 1/2; ``neighbours``:
    shape (2, k), pairs of adjacent pixels; ``bend``: shape (n,), :func:`limb_bend`; ``lift_m``: shape (n,), known
    height above the pose's limb; ``modes``: shape (k, n), of the relief, the last a common displacement in pixels [m].
    """

    pixels: NearPixels
    values: FloatArray
    sectors: Sectors
    along: FloatArray
    neighbours: NDArray[np.intp]
    bend: FloatArray
    lift_m: FloatArray
    modes: FloatArray


def limb_pixels(
    image: FloatArray,
    camera: CameraModel,
    pose: LimbPose,
    knowledge: LimbKnowledge,
    blur_px: float,
    scale_m: float,
    fewest_px: int = FEWEST_LIMB_PX,
    whole: float = 0.0,
) -> LimbPixels:
    """Return the pixels near the limb of a pose.

    Pixels whose limb is outside the picture are left out: without an edge they would determine levels alone and
    misplace the limb. ``blur_px``, ``scale_m``: width of the edge; ``fewest_px``: smallest limb in view; ``whole``:
    share of the profile across the limb that must be in the picture. Raises ``LinAlgError``: too little limb in view.
    """
    axes = knowledge.ellipsoid.axes_m + pose.height_m
    to_limb = np.sqrt(max(float(pose.r_itrs @ pose.r_itrs - axes[0] ** 2), 1.0))
    wide = BLURS * max(blur_px - SHARP_PX, 0.0)
    soft = OUTSIDE_SCALES * scale_m / to_limb * max(camera.fx, camera.fy)
    outside, inside = OUTSIDE_PX + wide + soft, INSIDE_PX + wide
    near = near_pixels(camera, pose.cam_from_itrs, pose.r_itrs, axes, outside, inside)
    angle = limb_angle(near.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    near = near.take(in_view(camera, near, angle, (-whole * outside, whole * inside)))
    angle = limb_angle(near.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    scale = image_scale(angle, near.by_column, near.by_row)
    on_limb = np.abs(angle.delta) < 0.5 * scale
    limb_px = int(on_limb.sum())
    if limb_px < fewest_px:
        raise np.linalg.LinAlgError(f"{limb_px} pixels of limb in view; {fewest_px} are needed")
    across = tangent_basis(pose.nadir_cam).T @ near.los_cam
    sectors = sectors_of(np.arctan2(across[1], across[0]), limb_px, float(scale[on_limb].sum()))
    pixels, azimuth = near.take(sectors.order), sectors.azimuth
    some = np.flatnonzero(on_limb[sectors.order])
    some = some[:: max(1, len(some) // BEND_PLACES)]
    uv = np.column_stack([pixels.columns[some], pixels.rows[some]]).astype(float)
    bend = limb_bend(camera, uv, pose.cam_from_itrs, pose.r_itrs, axes)
    seen = np.isfinite(bend)
    rho = float(np.arctan2(axes[0], to_limb))
    pixel_m = (scale / angle.by_height)[sectors.order]
    lift = np.zeros(len(azimuth))
    if knowledge.uneven is None:
        nodes, of_relief = relief_modes(float(azimuth[-1]), knowledge.reliefs, knowledge.flattened_m, rho)
    else:
        nodes = relief_nodes(float(azimuth[-1]), SHORTEST_RAD / float(np.cos(rho)))
        first = float(np.arctan2(*(across[::-1, sectors.order[0]])))
        places = _places(nodes + first, pose, rho, np.interp(nodes, azimuth[some], pixel_m[some]))
        height, covariance = knowledge.uneven.along(places, nodes)
        lift = np.interp(azimuth, nodes, height)
        of_relief = modes_of(covariance + oblate_covariance(nodes + first, knowledge.flattened_m, rho))
    modes = [np.interp(azimuth, nodes, mode) for mode in of_relief]
    if knowledge.reliefs and knowledge.uneven is None:
        # As a height, since a height is what a mode is of.
        modes.append(MISPLACED_PX * pixel_m)
    return LimbPixels(
        pixels=pixels,
        values=np.asarray(image[pixels.rows, pixels.columns], dtype=float),
        sectors=sectors,
        # A linear array crosses the limb in one pixel, which has no place along it.
        along=sectors.along if limb_px > 1 else np.zeros(len(azimuth)),
        neighbours=_neighbours(pixels),
        bend=np.interp(azimuth, azimuth[some][seen], bend[seen]) if seen.any() else np.zeros(len(azimuth)),
        lift_m=lift,
        modes=np.array(modes).reshape(len(modes), len(azimuth)),
    )


def _neighbours(pixels: NearPixels) -> NDArray[np.intp]:
    """Return the numbers of pixels side by side in a row or a column, shape (2, k)."""
    across = int(pixels.columns.max()) + 2
    number = pixels.rows * across + pixels.columns
    order = np.argsort(number)
    ranked = number[order]
    pairs = []
    for step in (1, across):
        at = np.minimum(np.searchsorted(ranked, number + step), len(ranked) - 1)
        found = ranked[at] == number + step
        pairs.append(np.array([np.flatnonzero(found), order[at[found]]]))
    return np.concatenate(pairs, axis=1)


def _places(azimuth: FloatArray, pose: LimbPose, rho_rad: float, pixel_m: FloatArray) -> ArcPlaces:
    """Return places along the limb at azimuths (m,) about the nadir."""
    nadir = pose.nadir_cam
    basis = tangent_basis(nadir)
    outwards = np.cos(azimuth)[:, None] * basis[:, 0] + np.sin(azimuth)[:, None] * basis[:, 1]
    los = np.cos(rho_rad) * nadir + np.sin(rho_rad) * outwards
    up = np.cos(rho_rad) * outwards - np.sin(rho_rad) * nadir
    return ArcPlaces(los, up, pose.cam_from_itrs, pixel_m)
