"""The pixels of one image near the limb of one pose: in order of azimuth, with all that no step of a fit changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from horizonval.core.arrays import FloatArray
from horizonval.estimation.likelihood.knowledge import LimbKnowledge, LimbPose
from horizonval.estimation.likelihood.limb_angle import limb_angle
from horizonval.estimation.likelihood.pixels import NearPixels, image_scale, limb_bend, near_pixels
from horizonval.estimation.likelihood.relief_modes import relief_modes
from horizonval.estimation.likelihood.sectors import Sectors, sectors_of
from horizonval.geometry.camera import CameraModel
from horizonval.geometry.directions import tangent_basis

OUTSIDE_PX, INSIDE_PX = 12.0, 8.0
"""Of a sharp limb, from it into space and into the Earth. Where every sector has levels of its own, known from ``w``
pixels to either side, they cost the place of an edge of blur ``s`` the share ``s sqrt(pi) / 2 (1 / w_in + 1 / w_out)``
of its information, 14 % here; the Earth's brightness is less even than space, and is taken from nearer."""
OUTSIDE_SCALES = 4.0
"""Of a soft limb, more of space in scale heights: what is left of it there is 2 %."""
BLURS = 3.0
"""Of the blur beyond that of a sharp limb: pixels across which the edge lasts, to either side."""
SHARP_PX = 1.0
FEWEST_LIMB_PX = 8
"""Of limb in view: seven unknowns and a level."""
BEND_PLACES = 400
"""Along the limb: the bend is interpolated between them."""


@dataclass(frozen=True)
class LimbPixels:
    """Pixels near the limb, n of them in order of azimuth.

    Attributes
    ----------
    pixels : NearPixels
    values : ndarray, shape (n,)
        The image's levels.
    sectors : Sectors
    along : ndarray, shape (n,)
        Place in the sector, from -1/2 to 1/2.
    bend : ndarray, shape (n,)
        Of the limb beside each of them, as :func:`.pixels.limb_bend` says.
    modes : ndarray, shape (k, n)
        Of the relief [m].
    """

    pixels: NearPixels
    values: FloatArray
    sectors: Sectors
    along: FloatArray
    bend: FloatArray
    modes: FloatArray


def limb_pixels(
    image: FloatArray,
    camera: CameraModel,
    pose: LimbPose,
    knowledge: LimbKnowledge,
    blur_px: float,
    scale_m: float,
    fewest_px: int = FEWEST_LIMB_PX,
) -> LimbPixels:
    """Return the pixels near the limb of a pose.

    Parameters
    ----------
    image : ndarray, shape (H, W)
    camera : CameraModel
    pose : LimbPose
    knowledge : LimbKnowledge
        The planet and the relief are used.
    blur_px, scale_m : float
        Width of the edge: blur of lens and pixel, scale height.
    fewest_px : int
        Of limb in view.

    Raises
    ------
    numpy.linalg.LinAlgError
        Too little limb in view.
    """
    axes = knowledge.ellipsoid.axes_m + pose.height_m
    to_limb = np.sqrt(max(float(pose.r_itrs @ pose.r_itrs - axes[0] ** 2), 1.0))
    wide = BLURS * max(blur_px - SHARP_PX, 0.0)
    soft = OUTSIDE_SCALES * scale_m / to_limb * max(camera.fx, camera.fy)
    near = near_pixels(camera, pose.cam_from_itrs, pose.r_itrs, axes, OUTSIDE_PX + wide + soft, INSIDE_PX + wide)
    angle = limb_angle(near.los_cam, pose.cam_from_itrs, pose.r_itrs, axes)
    on_limb = np.abs(angle.delta) < 0.5 * image_scale(angle, near.by_column, near.by_row)
    limb_px = int(on_limb.sum())
    if limb_px < fewest_px:
        raise np.linalg.LinAlgError(f"{limb_px} pixels of limb in view; {fewest_px} are needed")
    across = tangent_basis(pose.nadir_cam).T @ near.los_cam
    sectors = sectors_of(np.arctan2(across[1], across[0]), limb_px)
    pixels, azimuth = near.take(sectors.order), sectors.azimuth
    some = np.flatnonzero(on_limb[sectors.order])
    some = some[:: max(1, len(some) // BEND_PLACES)]
    uv = np.column_stack([pixels.columns[some], pixels.rows[some]]).astype(float)
    bend = limb_bend(camera, uv, pose.cam_from_itrs, pose.r_itrs, axes)
    seen = np.isfinite(bend)
    rho = float(np.arctan2(axes[0], to_limb))
    nodes, modes = relief_modes(float(azimuth[-1]), knowledge.reliefs, knowledge.flattened_m, rho)
    return LimbPixels(
        pixels=pixels,
        values=np.asarray(image[pixels.rows, pixels.columns], dtype=float),
        sectors=sectors,
        along=sectors.along,
        bend=np.interp(azimuth, azimuth[some][seen], bend[seen]) if seen.any() else np.zeros(len(azimuth)),
        modes=np.array([np.interp(azimuth, nodes, mode) for mode in modes]).reshape(len(modes), len(azimuth)),
    )
